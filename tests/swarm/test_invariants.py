"""The invariants themselves: each notices what it is for, in a swarm of two that is played for some ticks."""

from dataclasses import replace
from typing import Any

import msgspec
import pytest

from agents.agent import Agent
from agents.gossip.round_inbox import WINDOW_TICKS
from deploy.scenario import resolve
from deploy.simulation import Simulation
from deploy.verify.invariants import (
    LEAST_COMPARISONS,
    SILENT_ROUNDS,
    InvariantBroken,
    InvariantChecker,
    check_diagram,
    check_round,
    fingerprint,
)

TICKS = 12
SETTINGS = {"team.composition": "A2", "targets.count": 0, "run.seconds": 0.5 * TICKS, "run.dt": 0.5, "filter.particles_per_target": 10}


def watched(settled: float, *kinds: str, **changes: Any) -> tuple[Simulation, InvariantChecker]:
    """A swarm of two that must be one from `settled` s on, in whose case such kinds of faults strike."""
    simulation = Simulation(resolve("quick", SETTINGS | changes), clock="realtime")
    return simulation, InvariantChecker(simulation, settled, False, kinds)


@pytest.mark.parametrize("kind", ["particles", "gaussian-mixture"])
def test_a_case_that_is_hardly_compared_with_the_central_filter_is_none_that_holds(kind: str) -> None:
    for ticks, holds in (
        (LEAST_COMPARISONS + 3, True),
        (LEAST_COMPARISONS + 2, False),
    ):  # it starts in the first, and the last two are not compared
        simulation, checker = watched(0.5 * (TICKS - ticks), **{"filter.kind": kind})
        simulation.run()
        if holds:
            checker.finish()
            continue
        with pytest.raises(InvariantBroken, match=f"{LEAST_COMPARISONS - 1} comparisons"):
            checker.finish()


def test_a_case_that_is_spoilt_may_end_without_a_comparison() -> None:
    simulation, checker = watched(0.5 * (TICKS - 2), "spoilt")
    simulation.run()
    checker.finish()


def test_the_older_of_two_processes_of_a_name_must_have_stopped() -> None:
    simulation, checker = watched(4.5)
    simulation.bus.run(2.0)
    simulation.injector.start("s1", twin=True)
    with pytest.raises(InvariantBroken, match=r"\['s1'\] live twice"):
        checker._check_unity(3, checker._collector.estimates[3])
    simulation.bus.run(5.0)
    checker._check_unity(9, checker._collector.estimates[9])


@pytest.mark.parametrize("kind", ["particles", "gaussian-mixture"])
def test_after_a_tick_in_which_a_spoilt_swarm_owns_something_twice_the_central_filter_starts_anew(kind: str) -> None:
    simulation, checker = watched(1.0, "spoilt", **{"filter.kind": kind})
    simulation.bus.run(3.0)
    before = checker._central_filter or checker._central_mixture
    assert before is not None
    gossips = checker._collector.gossips
    tick = max(gossips) - 1
    right = dict(gossips[tick + 1])
    gossips[tick + 1]["s2"] = msgspec.structs.replace(right["s1"], sender="s2")
    checker._compare(tick)
    assert checker._central_filter is None and checker._central_mixture is None
    gossips[tick + 1] = right
    checker._compare(tick)
    after = checker._central_filter or checker._central_mixture
    assert after is not None and after.tick == tick


def agent_of(simulation: Simulation, seconds: float = 2.0) -> Agent:
    simulation.bus.run(seconds)
    return simulation.agents["s1"]


@pytest.mark.parametrize("pace", [1, 4])
def test_a_peer_that_was_heard_some_rounds_ago_has_a_generator_and_a_round_is_as_many_ticks_as_the_pace(pace: int) -> None:
    simulation, checker = watched(100.0)
    agent = agent_of(simulation)
    heard = agent.peer_table.inbox.newest_closed["s2"].tick
    agent.outcome.belief.generator_names = frozenset({"s1"})
    for rounds in range(SILENT_ROUNDS + 1):
        agent.outcome.belief.tick, agent.counters["rounds"] = heard + rounds * pace, 100 + rounds
        since = checker._silent_since(agent)
    with pytest.raises(InvariantBroken, match="s2 is alive, was heard"):
        check_diagram(agent, since)
    agent.outcome.belief.tick, agent.counters["rounds"] = heard + rounds * pace + 1, 101 + rounds
    check_diagram(agent, checker._silent_since(agent))


def test_a_queue_of_more_ticks_than_an_inbox_keeps_is_noticed() -> None:
    simulation, _ = watched(100.0)
    agent = agent_of(simulation)
    inbox = agent.peer_table.inbox
    gossip = inbox.newest_closed["s2"]
    inbox.put([msgspec.structs.replace(gossip, tick=tick) for tick in range(100, 200)])
    check_round(agent, is_first=False)
    inbox.rounds |= {tick: {"s2": gossip} for tick in range(300, 301 + WINDOW_TICKS)}
    assert len(inbox.rounds) == 2 * WINDOW_TICKS + 1
    with pytest.raises(InvariantBroken, match="a queue of 33 ticks of a peer"):
        check_round(agent, is_first=False)


def test_a_print_shows_every_change_of_what_is_known_of_a_peer_and_nothing_else() -> None:
    simulation, _ = watched(100.0)
    agent = agent_of(simulation)
    peer, before = agent.peer_table.peers["s2"], fingerprint(agent)
    assert fingerprint(agent) == before
    sensor = msgspec.structs.replace(peer.announced.sensor, radius=1.0)  # type: ignore[union-attr]
    for field, value in (("announced", peer.announced._replace(sensor=sensor)), ("suspected", True), ("differs", ("run.dt",))):  # type: ignore
        known = getattr(peer, field)
        setattr(peer, field, value)
        assert fingerprint(agent).of("s2") != before.of("s2"), field
        setattr(peer, field, known)
    assert fingerprint(agent) == before


def test_a_print_does_not_take_a_new_outcome_for_an_old_one_at_the_same_address() -> None:
    simulation, _ = watched(100.0)
    agent = agent_of(simulation)
    outcome = agent.outcome
    agent.outcome = replace(outcome)
    before = fingerprint(agent)
    agent.outcome = outcome
    agent.outcome = replace(outcome)
    assert fingerprint(agent) != before
