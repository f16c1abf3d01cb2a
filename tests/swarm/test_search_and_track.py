"""A swarm that searches and tracks: what it announces, and what deaths, loss and other laws do to that."""

from typing import Any

import msgspec
import numpy as np
import pytest

from agents.agent import Agent
from agents.backend import PLAIN
from agents.coverage.control import ControlInput, Situation
from agents.coverage.search_and_track import SearchAndTrack
from deploy.scenario import Scenario, resolve
from deploy.simulation import Simulation, compiled
from protocol.messages import Gossip
from protocol.node import Event, messages_of
from tests.swarm.scene import fault

SMALL: dict[str, Any] = {"team.composition": "A2,B3", "targets.count": 4, "arena.width": 30.0, "arena.height": 26.0, "run.dt": 0.25}


def scenario(mode: str = "search-and-track", seconds: float = 6.0, faults: tuple[Any, ...] = (), **options: Any) -> Scenario:
    found = resolve("efficacy", {**SMALL, "control.mode": mode, "run.seconds": seconds, **options})
    return msgspec.structs.replace(found, faults=faults)


def gossips(simulation: Simulation) -> list[Gossip]:
    """All gossips of a run."""
    found: list[Gossip] = []

    def hear(event: Event, now: float) -> None:
        found.extend(message for message in messages_of(event) if isinstance(message, Gossip))

    simulation.scorer.on_event = hear
    simulation.run()
    return found


def test_every_agent_announces_a_goal_in_the_arena_within_the_way_of_a_horizon() -> None:
    said = gossips(Simulation(scenario()))
    assert {gossip.sender for gossip in said} == {"s1", "s2", "s3", "s4", "s5"}
    assert all(gossip.goal is None for gossip in said if gossip.tick == 0)
    for gossip in said:
        if gossip.goal is not None:
            x, y = gossip.goal
            assert 0.0 <= x <= 30.0 and 0.0 <= y <= 26.0
    assert sum(gossip.goal is not None for gossip in said) == 5 * 23


def test_agents_of_another_law_announce_nothing() -> None:
    assert {(gossip.goal, gossip.goal_utilisation) for gossip in gossips(Simulation(scenario("lloyd", 2.0)))} == {(None, 0.0)}


def test_a_dead_agent_is_no_partner_from_its_round_on(monkeypatch: pytest.MonkeyPatch) -> None:
    partners: dict[int, set[int]] = {}
    command = SearchAndTrack.command

    def counted(law: SearchAndTrack, situation: Situation) -> ControlInput:
        assert situation.surroundings is not None
        partners.setdefault(situation.tick, set()).add(len(situation.surroundings.partners))
        return command(law, situation)

    monkeypatch.setattr(SearchAndTrack, "command", counted)
    Simulation(scenario(seconds=5.0, faults=(fault(2.0, "kill", "s2"),))).run()
    # it had said its gossip of tick 8 when it died
    assert {tick: found for tick, found in partners.items() if found != {4}} == {tick: {3} for tick in range(9, 20)}


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_plain_and_compiled_arithmetic_agree_when_messages_are_lost_and_agents_die(seed: int) -> None:
    faults = (fault(0.0, "drop", value=0.3), fault(2.0, "kill", "1"), fault(3.0, "partition", "2", seconds=1.0))
    runs = [
        Simulation(scenario(faults=faults, **{"run.seed": seed}), backend=backend, clock="realtime").run()
        for backend in (PLAIN, compiled())
    ]
    assert runs[0].transcript == runs[1].transcript


@pytest.mark.slow
@pytest.mark.nightly
def test_a_team_of_other_sensors_searches_too() -> None:
    """Sensors that are no wedges take the plain way under both backends."""
    options = {"run.seconds": 1.5, "run.dt": 0.25, "control.mode": "search-and-track"}
    runs = [Simulation(resolve("anisotropic", options), backend=backend) for backend in (PLAIN, compiled())]
    assert runs[0].run().transcript == runs[1].run().transcript
    goals = [agent.context.law.intent.goal for agent in runs[0].agents.values() if isinstance(agent, Agent)]  # type: ignore[attr-defined]
    assert np.isfinite(goals).all() and len(set(goals)) == len(goals)
