"""The pace of an agent follows the time that a round takes it, in powers of two, and falls when the load has gone."""

import pytest

from agents.pace import Pace
from protocol.messages import Gossip
from protocol.node import Alive, Gone, Timer
from tests.agents.test_agent import met, see

PERIOD = 0.125


def play(pace: Pace, ticks: range, busy: float, needs: list[int] | None = None, lag: float = 0.0) -> list[int]:
    """The paces after each round, when every round keeps the driver busy for some seconds; the world ticks in time."""
    kept, free = [], 0.0
    for tick in ticks:
        now = max(tick * PERIOD + lag, free)
        if now >= (tick + 1) * PERIOD + lag and pace.current == 1:
            continue  # an agent that plays every tick takes the newest observation only
        pace.observe(tick, now)
        if not pace.is_shared(tick):
            continue
        pace.open(tick, now)
        pace.note_busy(busy)
        free = now + busy
        pace.close(tick, needs or [])
        kept.append(pace.current)
    return kept


def test_an_agent_with_time_plays_every_tick() -> None:
    assert set(play(Pace(PERIOD, measured=True), range(40), 0.08)) == {1}


def test_a_round_of_two_and_a_half_ticks_is_played_every_fourth() -> None:
    assert play(Pace(PERIOD, measured=True), range(80), 2.5 * PERIOD)[-6:] == [4] * 6


def test_the_pace_falls_within_a_few_rounds_after_the_load_has_gone() -> None:
    pace = Pace(PERIOD, measured=True)
    play(pace, range(80), 2.5 * PERIOD)
    assert play(pace, range(80, 80 + 2 * 4), 0.01)[-1] == 1


def test_the_need_falls_by_the_two_last_rounds_where_none_is_so_short_that_it_is_enough() -> None:
    pace = Pace(PERIOD, measured=True)
    play(pace, range(80), 2.5 * PERIOD)
    needs = []
    for tick in (80, 84):
        play(pace, range(tick, tick + 1), 0.45 * PERIOD)
        needs.append(pace.need)
    assert needs == [2, 1]


def test_an_agent_keeps_the_slowest_need_of_its_peers_but_does_not_state_it() -> None:
    pace = Pace(PERIOD, measured=True)
    assert play(pace, range(8), 0.01, [1, 4, 2])[-1] == 4 and pace.need == 1
    assert play(pace, range(8, 16), 0.01, [1, 1])[-1] == 1


def test_one_hiccup_is_no_reason_to_slow_down() -> None:
    pace = Pace(PERIOD, measured=True)
    play(pace, range(10), 0.01)
    play(pace, range(10, 11), 0.5)
    assert set(play(pace, range(15, 40), 0.01)) == {1}


def test_an_agent_keeps_the_pace_that_it_has_stated_until_its_next_gossip_states_less() -> None:
    pace = Pace(PERIOD, measured=True)
    play(pace, range(80), 2.5 * PERIOD)
    assert pace.current == 4
    assert play(pace, range(80, 81), 0.01) == [4] and pace.need == 1  # the peers have read 4
    assert play(pace, range(84, 85), 0.01) == [1]


def test_a_need_of_more_than_a_second_counts_once_it_has_been_stated() -> None:
    pace, seen = Pace(0.5, measured=True), []
    for tick in (0, 1, 2, 4, 8):
        pace.observe(tick, tick * 0.5)
        pace.open(tick, tick * 0.5)
        stated = pace.need
        pace.note_busy(1.25 if tick < 4 else 0.0)
        pace.close(tick, [])
        seen.append((stated, pace.need, pace.current))
    assert seen[1:3] == [(1, 4, 2), (4, 4, 4)]  # two ticks are a second: that much is kept at once


def test_an_agent_whose_rounds_are_stalls_slows_down_as_well() -> None:
    pace, free, kept = Pace(0.5, measured=True), 0.0, 1
    for tick in range(40):
        now = max(tick * 0.5, free)
        if now >= (tick + 1) * 0.5 and kept == 1:
            continue
        pace.observe(tick, now)
        if pace.is_shared(tick):
            pace.open(tick, now)
            free = now + 1.25
            pace.note_busy(1.25)
            pace.forget()  # as `LocalHealth` tells it after each of these rounds
            pace.close(tick, [])
            kept = pace.current
    assert kept == 4


def test_stops_of_the_process_are_no_reason_to_slow_down() -> None:
    pace = Pace(PERIOD, measured=True)
    play(pace, range(10), 0.01)
    for tick in (40, 70, 100):  # a stop in the middle of a round, so that ticks are missed as well
        now = tick * PERIOD
        pace.observe(tick, now)
        pace.open(tick, now)
        pace.note_busy(20.0 * PERIOD)
        pace.forget()
        pace.close(tick, [])
    assert pace.need == 1
    assert set(play(pace, range(120, 140), 0.01)) == {1}


@pytest.mark.parametrize(("period", "most"), [(0.05, 16), (0.125, 8), (0.25, 8), (0.5, 8)])
def test_the_longest_pace_is_a_second_or_eight_ticks(period: float, most: int) -> None:
    pace = Pace(period, measured=True)
    pace.close(0, [64])
    assert pace.current == most


def test_a_peer_that_states_no_power_of_two_gets_the_next_slower_pace() -> None:
    """One wrong bit makes 3 of 1. Agents of paces 3 and 4 would share one tick in twelve."""
    pace = Pace(PERIOD, measured=True)
    pace.close(0, [3])
    assert pace.current == 4


def test_after_a_tick_between_that_took_too_long_there_is_no_time_until_the_next_round_has_ended() -> None:
    pace, seen = Pace(PERIOD, measured=True), []
    pace.open(0, 0.0)
    pace.note_busy(3 * PERIOD)  # a round may take longer than a tick
    pace.close(0, [8])
    for seconds in (2 * PERIOD, 0.5 * PERIOD, 2 * PERIOD, 0.1 * PERIOD):  # the end of the round, and three ticks between
        pace.note_busy(seconds)
        seen.append(pace.has_time)
    pace.open(8, 8 * PERIOD)
    pace.close(8, [8])
    seen.append(pace.has_time)
    pace.note_busy(2 * PERIOD)
    assert [*seen, pace.has_time] == [True, True, False, False, False, True]


def test_no_pace_is_kept_in_lockstep() -> None:
    assert set(play(Pace(PERIOD, measured=False), range(40), 0.3, [8])) == {1}


@pytest.mark.parametrize("is_away", [True, False])
def test_ticks_for_which_the_body_is_away_are_no_reason_to_slow_down(is_away: bool) -> None:
    """Odometry that comes too rarely takes the body out of the run between two of its messages."""
    agent, said = met(), list[Gossip]()
    for number in range(80):
        now = 0.25 * number  # half a tick
        agent.handle(Timer(), now)
        if number % 8 == 0:
            agent.handle(Alive("body", "s1", 1), now)
            said += [effect for effect in agent.handle(see(number // 2), now) if isinstance(effect, Gossip)]
        elif is_away:
            agent.handle(Gone("body", "s1", 1), now)
        agent.handle(Timer(), now)  # it has taken no time
    assert (max(gossip.pace for gossip in said) == 1) == is_away


def test_at_the_end_of_a_round_the_peers_are_judged_by_its_pace() -> None:
    agent = met()
    agent._pace.close = lambda tick, needs: setattr(agent._pace, "current", 4)  # type: ignore[method-assign]
    agent.handle(see(0), 0.0)
    agent.handle(Timer(), 10.0)
    assert agent.peer_table.pace == 4
