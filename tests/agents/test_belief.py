"""What an agent holds: who is the authority for a particle, what an overlap leaves, and how a sleeper catches up."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agents.backend import PLAIN
from agents.config import AgentConfig, FilterSettings, TimingSettings
from agents.gossip.table import GossipTable, as_particles
from agents.tracking.belief import MOST_COPIES, Copies, CopyInputs, ParticlePhd, owned_by_sender, worth_keeping
from agents.tracking.claims import NO_CLAIM, make_claim
from agents.tracking.gaussian_belief import MixturePhd
from agents.tracking.particles import NO_PARTICLES, Particles, canonical, join, unlabelled
from agents.tracking.phd import predict
from agents.tracking.step import Step
from agents.tracking.tracker import Belief, OwnedState, belief_without_claim
from protocol.fields import pack
from protocol.keys import order
from protocol.messages import Gossip
from protocol.settings import ArenaSettings
from tests.agents.gossip_table import table

ARENA = ArenaSettings(width=100.0, height=100.0)
CONFIG = AgentConfig(arena=ARENA, timing=TimingSettings(overlap=3.0))
CLOSED = AgentConfig(arena=ARENA, filter=FilterSettings(border="reflect"))
TRACKER = ParticlePhd(PLAIN)
HALVES = {"s1": (30.0, 50.0, 0.0), "s2": (70.0, 50.0, 0.0)}  # two generators, cut at x = 50


def particles(*rows: tuple[int, float, float]) -> Particles:
    """Particles of rows id, x, weight, at y = 50."""
    table = np.array(rows, dtype=float).reshape(-1, 3)
    states = np.column_stack([table[:, 1], np.full(len(table), 50.0), np.full(len(table), 2.0), np.zeros(len(table))])
    return unlabelled(states, table[:, 2], table[:, 0].astype(np.uint64))


def owned_state(
    owner: str, held: Particles, generators: dict[str, tuple[float, float, float]] = HALVES, diagram_hash: int = 7
) -> OwnedState:
    """What `owner` owns in the diagram of some generators."""
    names = (owner, *(name for name in generators if name != owner))
    table = np.array([generators[name] for name in names])
    return OwnedState(owner, make_claim(names, table), held, diagram_hash)


def words(belief: Belief, others: list[OwnedState], tick: int = 5) -> GossipTable:
    """What all say in a tick whose claims and particles these are."""
    said = []
    for held in sorted([belief.mine, *others], key=lambda held: order(held.owner)):
        gossip = Gossip(
            sender=held.owner,
            incarnation=1,
            tick=tick,
            pose=(50.0, 50.0, 0.0),
            cod=(50.0, 50.0),
            power_radius=0.0,
            unused=0.0,
            claim_tick=tick - 1,
            claim_names=held.claim.names,
            claim_bytes=pack(held.claim.generators, "<f8"),
            diagram_hash=held.diagram_hash,
            weight=float(held.targets.weights[0]) if len(held.targets.weights) else 0.0,
            states_bytes=pack(held.targets.states, "<f4"),
            ids_bytes=pack(held.targets.ids, "<u8"),
        )
        said.append(gossip)
    return table(said, config=CONFIG)


def merged(belief: Belief, others: list[OwnedState]) -> list[int]:
    """Ids of everything that counts, ascending."""
    return canonical(as_particles(TRACKER.merge(belief, words(belief, others), Step(CONFIG, 5)))).ids.tolist()


def test_fresh_claims_replace_the_copies_that_lie_in_them() -> None:
    """A copy in a claimed cell is dropped even where the owner has nothing there: the owner is the authority."""
    belief = Belief(
        4, owned_state("s1", particles((1, 20.0, 0.1))), Copies(particles((2, 80.0, 0.1), (3, 10.0, 0.1))), frozenset({"s1", "s2"})
    )
    assert merged(belief, [owned_state("s2", particles((4, 60.0, 0.1)))]) == [1, 4]


def test_copies_stand_in_for_an_owner_that_is_silent() -> None:
    belief = Belief(4, owned_state("s1", particles((1, 20.0, 0.1))), Copies(particles((2, 80.0, 0.1))), frozenset({"s1", "s2"}))
    assert merged(belief, []) == [1, 2]


def test_a_particle_that_two_hold_counts_once() -> None:
    belief = Belief(4, owned_state("s1", particles((1, 20.0, 0.1))), Copies(NO_PARTICLES), frozenset({"s1", "s2"}))
    assert merged(belief, [owned_state("s2", particles((1, 20.0, 0.1), (4, 60.0, 0.1)))]) == [1, 4]


def test_where_views_differ_both_count_near_the_border_and_deeper_the_nearer_owner_does() -> None:
    """s1 saw s2 at 90 m and so claims up to 60 m, s2 itself from 50 m on: of s1's particles at 49, 52 and 58 m the last goes,
    8 m deep in the claim of s2 and nearer to it than to s1."""
    mine = owned_state(
        "s1", particles((1, 49.0, 0.1), (2, 52.0, 0.1), (3, 58.0, 0.1)), {"s1": (30.0, 50.0, 0.0), "s2": (90.0, 50.0, 0.0)}, diagram_hash=1
    )
    belief = Belief(4, mine, Copies(NO_PARTICLES), frozenset({"s1", "s2"}))
    assert merged(belief, [owned_state("s2", particles((4, 59.0, 0.1)), diagram_hash=2)]) == [1, 2, 4]


def test_in_a_hole_between_claims_the_copies_live_on() -> None:
    """s2 saw s1 farther east and claims from 60 m on; s1 claims up to 50 m; a copy at 55 m is nobody's and stays."""
    theirs = owned_state("s2", NO_PARTICLES, {"s1": (50.0, 50.0, 0.0), "s2": (70.0, 50.0, 0.0)}, diagram_hash=2)
    belief = Belief(
        4, owned_state("s1", NO_PARTICLES, diagram_hash=1), Copies(particles((5, 55.0, 0.1), (6, 65.0, 0.1))), frozenset({"s1", "s2"})
    )
    assert merged(belief, [theirs]) == [5]


def test_a_gossip_says_what_its_sender_owns() -> None:
    held = particles((4, 60.0, 0.25), (9, 70.5, 0.25))
    gossip = Gossip(
        sender="s2",
        incarnation=1,
        tick=5,
        pose=(70.0, 50.0, 0.0),
        cod=(70.0, 50.0),
        power_radius=0.0,
        unused=0.0,
        claim_tick=4,
        claim_names=("s2", "s1"),
        claim_bytes=pack(np.array([HALVES["s2"], HALVES["s1"]]), "<f8"),
        diagram_hash=7,
        weight=0.25,
        states_bytes=pack(held.states, "<f4"),
        ids_bytes=pack(held.ids, "<u8"),
    )
    said = owned_by_sender(gossip)
    assert (said.owner, said.claim.names, said.diagram_hash) == ("s2", ("s2", "s1"), 7)
    assert said.claim.wins_ties.tolist() == [False, True]
    assert all((ours == theirs).all() for ours, theirs in zip(said.targets, held))


def test_a_gossip_without_a_claim_owns_nothing() -> None:
    gossip = Gossip(sender="s2", incarnation=1, tick=5, pose=(0.0, 0.0, 0.0), cod=(0.0, 0.0), power_radius=0.0, unused=0.0)
    assert owned_by_sender(gossip).claim.names == () and len(owned_by_sender(gossip).targets.ids) == 0


def test_copies_of_what_was_told_are_moved_on_but_for_those_that_were_corrected() -> None:
    """Told at tick 3 and one step on; what lies within 6 m of the own cell is in `near` already."""
    step = Step(CONFIG, 4)
    cell = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 100.0], [0.0, 100.0]])
    told = particles((2, 80.0, 0.1), (3, 52.0, 0.1), (4, 90.0, 0.0))
    copies = Copies(particles((3, 53.0, 0.2)), CopyInputs(step, PLAIN, told, cell, NO_CLAIM))
    held = copies.compute()
    assert held.ids.tolist() == [3, 2]
    assert held.states[1, 0] == predict(told, step).states[0, 0]
    assert copies.compute() is held


def crowd(number: int, weight: float) -> Particles:
    return unlabelled(np.full((number, 4), 50.0), np.full(number, weight), np.arange(number, dtype=np.uint64))


def test_copies_are_not_given_up_because_there_are_many_targets() -> None:
    """A hundred targets are drawn with 7500 particles, 75 each."""
    held = worth_keeping(crowd(7500, 1.0 / 75.0), 75)
    assert len(held.ids) == 7500


def test_of_too_many_copies_the_lightest_are_given_up() -> None:
    light = crowd(4 * MOST_COPIES, 1e-9)
    heavy = unlabelled(light.states[:3], np.full(3, 0.5), np.arange(3, dtype=np.uint64) + np.uint64(10**6))
    held = worth_keeping(join([light, heavy]), 75)
    assert len(held.ids) == MOST_COPIES and held.ids[-3:].tolist() == heavy.ids.tolist()


def test_a_sleeper_replays_the_motion_that_it_missed_and_claims_nothing() -> None:
    own, copies = particles((1, 20.0, 0.1)), particles((2, 80.0, 0.2))
    asleep = Belief(4, owned_state("s1", own), Copies(copies), frozenset({"s1"}))
    awake = TRACKER.catch_up(asleep, Step(CONFIG, 8))
    expected = canonical(join([own, copies]))
    for tick in (5, 6, 7):
        expected = predict(expected, Step(CONFIG, tick))
    assert awake.tick == 7 and awake.mine.claim.names == ()
    assert (awake.copies.compute().states == expected.states).all() and (awake.copies.compute().weights == expected.weights).all()


@pytest.mark.parametrize("tracker", [TRACKER, MixturePhd(PLAIN)])
def test_of_a_long_sleep_only_the_last_ticks_are_replayed(tracker: ParticlePhd | MixturePhd, monkeypatch: pytest.MonkeyPatch) -> None:
    """An agent may join days after the first tick: its prior is one of tick -1."""
    most = 8  # in place of 256, which take seconds
    monkeypatch.setattr("agents.tracking.tracker.MOST_MISSED", most)
    asleep, day = tracker.start("s1", CLOSED, (40.0, 40.0, 60.0, 60.0)), 400_000
    fields = [field for field in ("weights", "states", "means") if hasattr(copies_of(asleep), field)]
    short, long, too_long = [
        copies_of(tracker.catch_up(replace(asleep, tick=tick), Step(CLOSED, day))) for tick in (day - most, day - most - 1, day - 10 * most)
    ]
    assert all((getattr(long, field) == getattr(too_long, field)).all() for field in fields)
    assert len(long.weights) and (len(short.weights) != len(long.weights) or (short[0] != long[0]).any())


def copies_of(belief: Belief) -> Any:
    return belief.copies.compute() if isinstance(belief.copies, Copies) else belief.copies


def test_who_missed_nothing_is_not_woken() -> None:
    belief = Belief(4, owned_state("s1", NO_PARTICLES), Copies(NO_PARTICLES), frozenset({"s1"}))
    assert TRACKER.catch_up(belief, Step(CONFIG, 5)) is belief


def test_at_the_start_everybody_holds_the_prior_and_nobody_owns_anything() -> None:
    belief = belief_without_claim("s1", -1, NO_PARTICLES, Copies(particles((1, 20.0, 0.1), (2, 80.0, 0.1))))
    assert belief.mine.claim is NO_CLAIM and merged(belief, []) == [1, 2]
    assert belief.copies.compute().weights.sum() == pytest.approx(0.2)
