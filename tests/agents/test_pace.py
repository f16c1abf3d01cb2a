"""The pace of an agent follows the time that a round takes it, in powers of two, and falls when the load has gone."""

import pytest

from agents.pace import Pace, TickTimes

PERIOD = 0.125


def play(pace: Pace, ticks: range, busy: float, needs: list[int] | None = None, lag: float = 0.0, period: float = PERIOD) -> list[int]:
    """The paces after each round, when every round keeps the driver busy for some seconds; the world ticks every `period` s."""
    kept, free = [], 0.0
    for tick in ticks:
        now = max(tick * period + lag, free)
        if now >= (tick + 1) * period + lag and pace.current == 1:
            continue  # an agent that plays every tick takes the newest observation only
        pace.observe(tick, now)
        if not pace.plays(tick):
            continue
        pace.open(tick, now)
        pace.spend(busy)
        free = now + busy
        pace.close(needs or [])
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


def test_an_agent_keeps_the_slowest_need_of_its_peers_but_does_not_state_it() -> None:
    pace = Pace(PERIOD, measured=True)
    assert play(pace, range(8), 0.01, [1, 4, 2])[-1] == 4 and pace.need == 1
    assert play(pace, range(8, 16), 0.01, [1, 1])[-1] == 1


def test_one_hiccup_is_no_reason_to_slow_down() -> None:
    pace = Pace(PERIOD, measured=True)
    play(pace, range(10), 0.01)
    play(pace, range(10, 11), 0.5)
    assert set(play(pace, range(15, 40), 0.01)) == {1}


def test_no_pace_is_longer_than_a_second_and_none_is_kept_in_lockstep() -> None:
    assert set(play(Pace(PERIOD, measured=True), range(200), 3.0)[4:]) == {8}
    assert set(play(Pace(PERIOD, measured=False), range(40), 0.3, [8])) == {1}


def test_a_world_that_ticks_more_slowly_than_it_should_makes_no_agent_slower() -> None:
    for slow in (1.2, 3.0, 8.0):
        assert set(play(Pace(PERIOD, measured=True), range(80), 0.08, period=slow * PERIOD)) == {1}


def test_the_pace_follows_the_ticks_that_come_and_not_those_that_should() -> None:
    assert play(Pace(PERIOD, measured=True), range(80), 2.3 * PERIOD, period=2.0 * PERIOD)[-6:] == [2] * 6
    assert play(Pace(PERIOD, measured=True), range(120), 5.0 * PERIOD, period=2.0 * PERIOD)[-6:] == [4] * 6


def test_a_pace_of_eight_falls_to_four_when_a_round_needs_two_and_a_half_ticks() -> None:
    pace = Pace(PERIOD, measured=True)
    assert play(pace, range(80), 4.5 * PERIOD)[-1] == 8
    assert play(pace, range(80, 200), 2.5 * PERIOD)[-6:] == [4] * 6


def test_a_round_may_open_before_an_observation_comes() -> None:
    pace = Pace(PERIOD, measured=True)
    play(pace, range(10), 0.01)
    pace.forget()
    pace.open(10, 2.0)
    pace.spend(0.01)
    pace.close([])
    assert pace.need == 1


def test_ticks_begin_on_the_line_below_their_observations() -> None:
    late = [0.0, 0.3, 0.1, 0.2, 0.0, 0.4, 0.1, 0.25]
    times = TickTimes(0.1)
    for tick, seconds in enumerate(late):
        times.observe(tick, 0.2 * tick + seconds)
    began, period = times.newest()
    assert period == pytest.approx(0.2) and began == pytest.approx(1.4)


def test_ticks_never_begin_faster_than_they_should() -> None:
    times = TickTimes(0.1)
    for tick in range(4):  # all of them were waiting
        times.observe(tick, 1.0)
    began, period = times.newest()
    assert period == 0.1 and began == pytest.approx(1.0)


def test_one_observation_shows_when_its_tick_begins() -> None:
    times = TickTimes(0.1)
    times.observe(7, 3.0)
    assert times.newest() == (3.0, 0.1)
    times.observe(8, 3.0 + 5.0)  # the first one is forgotten
    assert times.newest() == (8.0, 0.1)
