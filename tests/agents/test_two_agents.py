"""One agent that hears another: how long it waits for the other and counts with it, by what is said."""

from typing import Any

import msgspec
import pytest

from agents.agent import Agent
from agents.config import AgentConfig, TimingSettings
from agents.gossip.round_inbox import WINDOW_TICKS
from agents.gossip.table import GossipTable
from agents.look_ahead import look_ahead
from agents.tracking.belief import ParticlePhd
from agents.tracking.particles import Particles
from agents.tracking.step import Step
from agents.tracking.tracker import Belief
from protocol.messages import Gossip, Hello, Observation
from protocol.node import Alive, Effect, Started, Timer, received
from protocol.observer_messages import Estimate
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import ArenaSettings, RunSettings


def met(others: int = 1, clock: Any = "lockstep", **timing: Any) -> Agent:
    """s1, which knows s2 and perhaps more, and has heard nothing but their greetings."""
    names = [f"s{number}" for number in range(1, 2 + others)]
    config = AgentConfig(
        run=RunSettings(dt=0.5, rate=2.0, clock=clock, patience=4.0),
        arena=ArenaSettings(width=40.0, height=40.0),
        members=dict.fromkeys(names, "A"),
        timing=TimingSettings(**timing),
    )
    agent = Agent(config, "s1")
    agent.handle(Started(), 0.0)
    for name in names[1:]:
        agent.handle(Alive("agent", name, 1), 0.0)
        agent.handle(received(Hello(sender=name, incarnation=1, sensor_class="A", sensor=SENSOR_CLASSES["A"])), 0.0)
    return agent


def see(agent: Agent, tick: int, now: float) -> list[Effect]:
    observation = Observation(sender="world", incarnation=1, recipient="s1", tick=tick, time=0.5 * tick, pose=(10.0, 20.0, 0.0))
    return agent.handle(received(observation), now)


def hear(agent: Agent, tick: int, now: float, **fields: Any) -> list[Effect]:
    usual: dict[str, Any] = {"pose": (30.0, 20.0, 0.0), "cod": (32.0, 20.0), "power_radius": 2.0, "unused": 20.0}
    return agent.handle(received(Gossip(**{"sender": "s2", "incarnation": 1, "tick": tick, **usual, **fields})), now)


def of_kind(effects: list[Effect], kind: type) -> Any:
    return next((effect for effect in effects if isinstance(effect, kind)), None)


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_a_round_waits_for_a_late_word_as_long_as_the_setting_says(share: float) -> None:
    """In real time a share of the period, 0.25 s of the wall; in lockstep a share of the world's patience, 4 s."""
    for clock, period in (("realtime", 0.25), ("lockstep", 4.0)):
        agent = met(clock=clock, deadline=share)
        see(agent, 0, 100.0)
        hear(agent, 0, 100.0)
        see(agent, 1, 101.0)
        agent.handle(Timer(), 101.0)  # it asks to be called back at once
        agent.membership.announcements.due = agent._health.due = None  # what else it would wake up for
        assert agent.deadline() == pytest.approx(101.0 + share * period)


@pytest.mark.parametrize("rounds", [1, 2, 4])
def test_a_silent_peer_stays_a_generator_for_as_many_rounds_as_the_setting_says(rounds: int) -> None:
    agent, bounds = met(silent_rounds=rounds), []
    for tick in range(8):
        effects = see(agent, tick, 100.0 * tick)
        effects += hear(agent, tick, 100.0 * tick) if tick == 0 else agent.handle(Timer(), 100.0 * tick + 50.0)
        bounds.append(of_kind(effects, Estimate).neighbours)
    assert bounds == [("s2",)] * (1 + rounds) + [()] * (7 - rounds)


@pytest.mark.parametrize("rounds", [0, 1, 3])
def test_a_newcomer_listens_for_at_most_as_many_rounds_as_the_setting_says(rounds: int) -> None:
    """s2 speaks, s3 does not: the newcomer never hears everybody."""
    agent, listening = met(others=2, listening_rounds=rounds), []
    for tick in range(5, 12):
        effects = see(agent, tick, 100.0 * tick)
        listening.append(of_kind(effects, Gossip).listening)
        hear(agent, tick, 100.0 * tick)
        agent.handle(Timer(), 100.0 * tick + 50.0)
    assert listening == [True] * rounds + [False] * (7 - rounds)


def test_who_listens_is_no_generator_and_neither_is_who_has_no_token() -> None:
    agent = met()
    see(agent, 0, 0.0)
    assert of_kind(hear(agent, 0, 0.0, listening=True), Estimate).neighbours == ()
    see(agent, 1, 1.0)
    assert of_kind(hear(agent, 1, 1.0), Estimate).neighbours == ("s2",)


def test_the_look_ahead_over_a_long_pause_replays_as_many_ticks_as_gossips_are_kept_of() -> None:
    agent, merged = met(clock="realtime", look_ahead=2.0), list[int]()

    class Counting(ParticlePhd):
        def merge(self, belief: Belief, table: GossipTable, step: Step) -> GossipTable | Particles:
            merged.append(step.tick)
            return super().merge(belief, table, step)

    own = of_kind(see(agent, 0, 0.0), Gossip)
    hear(agent, 0, 0.0)
    context, late = agent.context._replace(tracker=Counting(agent.context.backend)), msgspec.structs.replace(own, tick=5000)
    found = look_ahead(agent._rounds.recent, context, agent.outcome, late, 0)
    assert merged == [*range(5000 - agent._rounds.recent.ticks_ahead, 5001)] and len(merged) > WINDOW_TICKS + 8  # and 2 s of 0.25 s each
    assert found.belief is agent.outcome.belief
    assert agent._rounds.recent.blurred_config(5000) is agent._rounds.recent.blurred_config(6000)
