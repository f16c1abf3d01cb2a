"""An agent that was late itself trusts its own time-outs less: it neither counts silence nor takes many lost tokens for deaths."""

import math

import pytest

from agents.agent import Agent
from agents.membership.local_health import BEAT_PERIOD, STALL_THRESHOLD, SUSPICION_SECONDS, LocalHealth
from protocol.node import Alive, Gone, Timer
from tests.agents.test_agent import hello, met, see, word


def test_a_beat_that_comes_late_is_a_stall_and_one_in_time_is_none() -> None:
    health = LocalHealth(measured=True)
    health.start(10.0)
    health.note_event(10.0 + BEAT_PERIOD + STALL_THRESHOLD)
    assert health.stalled == 0.0 and not health.has_just_stalled(11.0)
    health.note_event(20.0)
    assert (
        health.stalled == pytest.approx(10.0 - 2 * BEAT_PERIOD - STALL_THRESHOLD)
        and health.has_just_stalled(20.0)
        and health.has_stalled_since(12.0)
    )
    assert health.has_just_stalled(20.0 + SUSPICION_SECONDS) and not health.has_just_stalled(20.1 + SUSPICION_SECONDS)


def test_a_clock_that_jumps_back_goes_on_measuring() -> None:
    health = LocalHealth(measured=True)
    health.start(1000.0)
    health.note_event(500.0)
    assert health.due == 500.0 + BEAT_PERIOD
    health.note_event(503.0)
    assert health.stalled > 2.0


def test_in_lockstep_nothing_is_measured() -> None:
    health = LocalHealth(measured=False)
    health.start(0.0)
    health.note_event(100.0)
    assert health.due is None and health.stalled == 0.0


def swarm_of(others: int) -> tuple[Agent, list[str]]:
    agent, names = met(), [f"s{number}" for number in range(2, 2 + others)]
    for name in names:
        agent.handle(Alive("agent", name, 1), 0.0)
        agent.handle(hello(name), 0.0)
    for tick in range(2):
        agent.handle(see(tick), 0.5 * tick)
        for name in names:
            agent.handle(word(tick, name), 0.5 * tick + 0.01)
    return agent, names


@pytest.mark.parametrize(("asleep", "generators"), [(0.1, {"s1"}), (3.0, {"s1", "s2", "s3", "s4", "s5"})])
def test_tokens_that_all_vanish_are_deaths_unless_the_agent_was_late(asleep: float, generators: set[str]) -> None:
    agent, names = swarm_of(4)
    now = 0.51 + asleep
    for name in names:
        agent.handle(Gone("agent", name, 1), now)
    agent.handle(see(2), now)
    assert agent.outcome.belief.generator_names == generators


def test_a_single_token_that_vanishes_while_the_agent_is_late_counts_after_the_next_round() -> None:
    agent, names = swarm_of(4)
    agent.handle(Gone("agent", "s2", 1), 4.0)
    for tick, everyone in ((2, 5), (3, 4)):
        agent.handle(see(tick), 3.6 + 0.25 * tick)
        for name in names[1:]:
            agent.handle(word(tick, name), 3.61 + 0.25 * tick)
        assert len(agent.outcome.belief.generator_names) == everyone


@pytest.mark.parametrize(("now", "awaited"), [(1.0, 3), (4.0, 4)])
def test_a_token_that_vanishes_ends_the_wait_for_its_peer_unless_the_agent_was_late(now: float, awaited: int) -> None:
    agent, _ = swarm_of(4)
    agent.handle(see(2), now)
    agent.handle(Gone("agent", "s2", 1), now + 0.01)
    assert agent.wake_up_count == awaited


def test_silence_counts_only_in_rounds_in_which_the_agent_was_served() -> None:
    agent, _ = swarm_of(1)
    for tick in range(2, 40):  # an agent that is late in every round: its timer comes when the next observation is there
        agent.handle(see(tick), 5.0 * tick)
        agent.handle(Timer(), 5.0 * tick + 4.0)
    assert "s2" in agent.outcome.belief.generator_names and agent.peer_table.silence_timeouts == 0
    for tick in range(40, 90):
        agent.handle(see(tick), 200.0 + 0.5 * tick)
        while (due := agent.deadline() or math.inf) < 200.5 + 0.5 * tick:
            agent.handle(Timer(), due)
    assert "s2" not in agent.outcome.belief.generator_names and agent.peer_table.silence_timeouts == 1


def test_a_gossip_ends_the_suspicion() -> None:
    agent, names = swarm_of(4)
    for name in names:
        agent.handle(Gone("agent", name, 1), 4.0)
    agent.handle(word(2), 4.0)
    assert not agent.peer_table.peers["s2"].suspected and agent.peer_table.peers["s3"].suspected


@pytest.mark.parametrize("older_goes_late", [False, True])
def test_an_agent_that_was_restarted_with_its_body_is_waited_for_again(older_goes_late: bool) -> None:
    """The tokens of the older processes go after those of the younger agent have come, and before its body comes."""
    agent, _ = swarm_of(4)
    agent.handle(Alive("body", "s2", 1), 0.6)
    agent.handle(Alive("agent", "s2", 2), 0.7)
    agent.handle(Gone("body", "s2", 1), 0.8)
    assert not agent.peer_table.peers["s2"].token
    for event in [Gone("agent", "s2", 1)] * older_goes_late:
        agent.handle(event, 0.8)
    agent.handle(Alive("body", "s2", 2), 0.9)
    assert agent.peer_table.peers["s2"].token


@pytest.mark.parametrize(("now", "is_gone"), [(1.0, True), (4.0, False)])
def test_a_lost_body_is_suspected_as_a_lost_agent_is(now: float, is_gone: bool) -> None:
    agent, _ = swarm_of(4)
    agent.handle(Alive("body", "s2", 1), 0.6)
    agent.handle(Gone("body", "s2", 1), now)
    peer = agent.peer_table.peers["s2"]
    assert (peer.is_gone, peer.suspected) == (is_gone, not is_gone)
