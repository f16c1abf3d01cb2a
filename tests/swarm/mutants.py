"""Planted mutants: rules of the swarm left out one at a time, to see that the fuzzer notices.

`MUTANTS` names with each seeds that notice it quickly, found by trying 1 to 100.
"""

from collections.abc import Callable
from functools import partial

import msgspec
import numpy as np
import pytest

from agents import speech
from agents.agent import Agent
from agents.arithmetic import PLAIN, Arithmetic, in_steps
from agents.config import AgentConfig
from agents.neighbours import Neighbours, Peer
from agents.particles import Particles, select
from agents.round import Outcome, Self
from deploy.verify import fuzz
from deploy.verify.fuzz import Case
from protocol.messages import Gossip, Observation
from protocol.streams import key, scramble

Mutant = Callable[[Case, pytest.MonkeyPatch], str | None]  # plays a case with the rule left out


def in_its_steps(changed: Arithmetic) -> Arithmetic:
    """An arithmetic whose rounds take its own steps."""
    return changed._replace(refresh=partial(in_steps, changed))


def sorted_only(particles: Particles) -> Particles:
    return select(particles, np.argsort(particles.ids, kind="stable"))


def no_dedupe_by_id(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    """Acts in cases with `timing.overlap` alone: else one of two claims counts where they meet, and no id is told twice."""
    for module in ("agents.belief", "agents.arithmetic", "agents.phd"):
        patch.setattr(f"{module}.canonical", sorted_only)
    return fuzz.play(case, arithmetic=PLAIN)


def no_keyed_noise(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    calls = iter(range(10**9))

    def gather(particles, births, polygon, eye, reach, step):  # type: ignore[no-untyped-def]
        filters = msgspec.structs.replace(step.config.filter, seed=next(calls))
        config = msgspec.structs.replace(step.config, filter=filters)
        return PLAIN.gather(particles, births, polygon, eye, reach, step._replace(config=config))

    return fuzz.play(case, arithmetic=in_its_steps(PLAIN._replace(gather=gather)))


def births_by_the_owner_only(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    def build(config: AgentConfig, name: str, incarnation: int, arithmetic: Arithmetic, sensor_class: str) -> Agent:
        def update(particles, words, polygon, step):  # type: ignore[no-untyped-def]
            updated = PLAIN.update(particles, words, polygon, step)
            salt = key(config.filter.seed, "birth", step.tick, key("sensor", name))
            mine = scramble(np.arange(10000, dtype=np.uint64), salt)
            return select(updated, np.isin(updated.ids, particles.ids) | np.isin(updated.ids, mine))

        return Agent(config, name, incarnation, in_its_steps(PLAIN._replace(update=update)), sensor_class)

    return fuzz.play(case, build=build)


def timing(case: Case, **changes: int) -> Case:
    scenario = msgspec.structs.replace(case.scenario, timing=msgspec.structs.replace(case.scenario.timing, **changes))
    return case._replace(scenario=scenario)


def no_listening_rule(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    return fuzz.play(timing(case, listening_rounds=0))


def generator_dropped_after_one_silent_round(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    return fuzz.play(timing(case, silent_rounds=1))


def latest_heard_view(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    patch.setattr(Neighbours, "missing", lambda self, tick, *, newcomer=False: set())
    return fuzz.play(case)


def nan_let_through(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    for check in ("check_rows", "check_vector", "check_number"):
        patch.setattr(f"protocol.messages.{check}", lambda *values, **limits: None)
    patch.setattr("agents.peers.plausible", lambda gossip, outfit: True)
    return fuzz.play(case)


def old_incarnation_kept(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    right = Neighbours._peer

    def lenient(self: Neighbours, name: str, incarnation: int, *, token: bool = False) -> Peer | None:
        return right(self, name, incarnation, token=token) or self.peers.get(name)

    patch.setattr(Neighbours, "_peer", lenient)
    return fuzz.play(case)


def no_overlap_rule(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    def undisputed(points, *claims):  # type: ignore[no-untyped-def]
        return np.ones(len(points), dtype=bool)

    return fuzz.play(case, arithmetic=in_its_steps(PLAIN._replace(undisputed=undisputed)))


def stale_claim_wins(case: Case, patch: pytest.MonkeyPatch) -> str | None:
    right = speech.gossip

    def gossip(me: Self, incarnation: int, outcome: Outcome, observation: Observation, *, listening: bool) -> Gossip:
        outcome.belief.stamp = observation.tick - 1
        return right(me, incarnation, outcome, observation, listening=listening)

    patch.setattr(speech, "gossip", gossip)
    return fuzz.play(case)


MUTANTS: dict[Mutant, tuple[int, ...]] = {
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
}
