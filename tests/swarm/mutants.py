"""Planted mutants: rules of the swarm left out one at a time, to see that the fuzzer notices.

`MUTANTS` names with each seeds that notice it quickly, found by trying 1 to 100.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest

from agents import round as rounds
from agents.backend import PLAIN
from agents.gossip import message_builders
from agents.gossip.round_inbox import RoundInbox
from agents.gossip.table import WEIGHT, GossipTable
from agents.membership.membership import Membership
from agents.membership.peer_table import Peer, PeerTable
from agents.round import AgentContext, RoundResult
from agents.tracking import regions
from agents.tracking.particles import Particles, select
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput, RegionUpdate
from deploy.verify import fuzz
from deploy.verify.fuzz import Case
from protocol.messages import Gossip, Observation
from protocol.random_streams import random_key, scramble

Mutant = Callable[[Case, pytest.MonkeyPatch], str | None]  # plays a case with the rule left out


def sorted_only(particles: Particles) -> Particles:
    return select(particles, np.argsort(particles.ids, kind="stable"))


def no_dedupe_by_id(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    """Acts in cases with `timing.overlap` alone: else one of two claims counts where they meet, and no id is told twice."""
    for module in ("agents.tracking.belief", "agents.tracking.merge", "agents.tracking.regions", "agents.tracking.phd"):
        patch.setattr(f"{module}.canonical", sorted_only)
    return fuzz.play(case, backend=PLAIN)


def no_keyed_noise(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    calls, right = iter(range(10**9)), regions.predict

    def predict(particles: Particles, step: Step) -> Particles:
        filters = msgspec.structs.replace(step.config.filter, seed=next(calls))
        return right(particles, step._replace(config=msgspec.structs.replace(step.config, filter=filters)))

    patch.setattr(regions, "predict", predict)
    return fuzz.play(case, backend=PLAIN)


def births_by_the_owner_only(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    right, owners = regions.correct, [""]

    def correct(particles: Particles, table: GossipTable, polygon: np.ndarray, step: Step) -> Particles:
        updated = right(particles, table, polygon, step)
        salt = random_key(step.config.filter.seed, "birth", step.tick, random_key("sensor", owners[-1]))
        mine = scramble(np.arange(10000, dtype=np.uint64), salt)
        return select(updated, np.isin(updated.ids, particles.ids) | np.isin(updated.ids, mine))

    def update_regions(table: GossipTable, density: Any, births: Particles, each: Sequence[RegionInput], step: Step) -> list[RegionUpdate]:
        found = []
        for region in each:
            owners.append(region.owner)
            found += PLAIN.update_regions(table, density, births, [region], step)
        return found

    patch.setattr(regions, "correct", correct)
    return fuzz.play(case, backend=PLAIN._replace(update_regions=update_regions))


def timing(case: Case, **changes: int) -> Case:
    scenario = msgspec.structs.replace(case.scenario, timing=msgspec.structs.replace(case.scenario.timing, **changes))
    return case._replace(scenario=scenario)


def no_listening_rule(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    return fuzz.play(timing(case, listening_rounds=0))


def generator_dropped_after_one_silent_round(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    return fuzz.play(timing(case, silent_rounds=1))


def latest_heard_view(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    patch.setattr(PeerTable, "missing", lambda self, tick, *, newcomer=False: set())
    return fuzz.play(case)


def nan_let_through(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    patch.setattr("protocol.messages.check_rows", lambda rows, data: rows.count(data))
    patch.setattr("protocol.codec.are_contents_valid", lambda gossips: True)
    for user in ("peer", "peer_table"):
        patch.setattr(f"agents.membership.{user}.plausible", lambda gossip, announced, arena: True)
    return fuzz.play(case)


def old_incarnation_kept(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    right = PeerTable._get_or_create

    def lenient(self: PeerTable, name: str, incarnation: int, *, token: bool = False) -> Peer | None:
        return right(self, name, incarnation, token=token) or self.peers.get(name)

    patch.setattr(PeerTable, "_get_or_create", lenient)
    return fuzz.play(case)


def no_overlap_rule(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    def resolve_conflicts(points: np.ndarray, *others: Any) -> np.ndarray:
        return np.ones(len(points), dtype=bool)

    return fuzz.play(case, backend=PLAIN._replace(resolve_conflicts=resolve_conflicts))


def stale_claim_wins(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    right = message_builders.gossip

    def gossip(me: AgentContext, outcome: RoundResult, observation: Observation, **words: Any) -> Gossip:
        outcome.belief.tick = observation.tick - 1
        return right(me, outcome, observation, **words)

    patch.setattr(message_builders, "gossip", gossip)
    return fuzz.play(case)


def row_of_another_sender(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    """A gossip is kept under the name of somebody else who has spoken of the tick."""

    def put(self: RoundInbox, gossips: Iterable[Gossip]) -> None:
        for gossip in gossips:
            kept = self.rounds.setdefault(gossip.tick, {})
            kept[next(iter(kept), gossip.sender) if gossip.tick % 7 == 3 else gossip.sender] = gossip

    patch.setattr(RoundInbox, "put", put)
    return fuzz.play(case)


def stale_tick_accepted(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    right = PeerTable._judge

    def judge(self: PeerTable, gossip: Gossip) -> str:
        reason = right(self, gossip)
        return "" if reason == "closed" else reason

    patch.setattr(PeerTable, "_judge", judge)
    return fuzz.play(case)


def incarnation_not_compared(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    right = PeerTable._judge

    def judge(self: PeerTable, gossip: Gossip) -> str:
        peer = self.interest_set.get(gossip.sender)
        changed = gossip if peer is None else msgspec.structs.replace(gossip, incarnation=peer.incarnation)
        return right(self, changed)

    patch.setattr(PeerTable, "_judge", judge)
    return fuzz.play(case)


def mask_off_by_one(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    """The last row of every three or more that are accepted together is dropped, though it counts as heard."""
    right = RoundInbox.put

    def put(self: RoundInbox, gossips: Iterable[Gossip]) -> None:
        rows = [*gossips]
        right(self, rows[:-1] if len(rows) >= 3 else rows)

    patch.setattr(RoundInbox, "put", put)
    return fuzz.play(case)


def listener_changes_the_shared_table(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    right = rounds.gossip_table

    def gossip_table(*arguments: Any) -> GossipTable:
        words = right(*arguments)
        words.table[:, WEIGHT] *= 0.99
        return words

    patch.setattr(rounds, "gossip_table", gossip_table)
    return fuzz.play(case)


def older_twin_stays(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    patch.setattr(Membership, "fence", lambda self, incarnation: [])
    return fuzz.play(case)


MUTANTS: dict[Mutant, tuple[int, ...]] = {
    row_of_another_sender: (1, 2),
    stale_tick_accepted: (8, 9),
    incarnation_not_compared: (1, 9),
    mask_off_by_one: (1, 2),
    listener_changes_the_shared_table: (1, 2),
    no_dedupe_by_id: (10, 13, 15),
    no_keyed_noise: (3, 1),
    births_by_the_owner_only: (1, 5),
    no_listening_rule: (2, 7),
    generator_dropped_after_one_silent_round: (1, 2),
    latest_heard_view: (1, 2),
    nan_let_through: (2, 7),
    old_incarnation_kept: (14, 1),
    no_overlap_rule: (85, 40),
    stale_claim_wins: (10, 14),
    older_twin_stays: (2, 25),
}
