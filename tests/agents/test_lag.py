"""The lag of an agent follows how late gossips come, by its own observations alone."""

import pytest

from agents.backend import PLAIN
from agents.config import AgentConfig, TimingSettings
from agents.lag import Lag
from agents.open_rounds import OpenRounds
from agents.round import context_of
from protocol.settings import RunSettings

PERIOD, TIMEOUT = 0.5, 0.25


def play(lag: Lag, ticks: range, delay: float, needs: tuple[int, ...] = (), late: int = 4) -> list[int]:
    """The lag after each tick; in every tick four gossips are sent, the first `late` of which come `delay` s later."""
    arrivals = sorted((tick * PERIOD + (delay if number < late else 0.0), tick) for tick in ticks for number in range(4))
    kept = []
    for tick in ticks:
        lag.observe(tick, tick * PERIOD)
        while arrivals and arrivals[0][0] <= tick * PERIOD + TIMEOUT:
            arrived, of = arrivals.pop(0)
            lag.hear(of, max(arrived, of * PERIOD))
        lag.close(needs, tick * PERIOD + TIMEOUT)
        kept.append(lag.current)
    return kept


def fresh(longest: float = 2.5, measured: bool = True) -> Lag:
    return Lag(PERIOD, TIMEOUT, longest, measured=measured)


@pytest.mark.parametrize(("delay", "ticks"), [(0.0, 0), (0.25, 0), (0.3, 1), (0.75, 1), (0.8, 2), (2.0, 4)])
def test_a_gossip_is_late_by_the_ticks_after_whose_end_it_comes(delay: float, ticks: int) -> None:
    assert play(fresh(), range(20), delay)[-1] == ticks


def test_gossips_that_are_later_than_the_setting_are_not_waited_for() -> None:
    assert fresh().most == 5 and fresh(0.0).most == 0 and fresh(measured=False).most == 0
    assert play(fresh(), range(20), 4.0)[-1] == 0


def test_a_late_peer_of_four_is_waited_for_but_not_one_late_gossip_of_many() -> None:
    assert play(fresh(), range(20), 1.0, late=1)[-1] == 2
    lag = fresh()
    play(lag, range(20), 0.0)
    for _ in range(30):
        lag.hear(19, 19 * PERIOD)
    lag.hear(18, 18 * PERIOD + 1.0)
    lag.close([], 10.0)
    assert lag.need == 0


def test_the_largest_need_of_the_peers_is_kept_but_not_stated() -> None:
    lag = fresh()
    assert play(lag, range(4), 0.0, needs=(1, 3))[-1] == 3 and lag.need == 0
    assert play(lag, range(4, 8), 0.0)[-1] == 0


def test_the_lag_falls_two_seconds_after_the_last_late_gossip() -> None:
    lag = fresh()
    play(lag, range(20), 0.5)
    after = play(lag, range(20, 40), 0.0)
    fall = after.index(0)
    assert set(after[:fall]) == {1} and set(after[fall:]) == {0} and fall == 3  # the last late one is that of tick 18, in tick 19


def test_at_a_slower_pace_no_lag_is_kept() -> None:
    config = AgentConfig(run=RunSettings(dt=PERIOD), members={"s1": "A"}, timing=TimingSettings(look_ahead=2.5))
    rounds = OpenRounds(context_of(config, "s1", "A", PLAIN))
    play(rounds.lag, range(20), 1.0)
    for pace, lag in ((1, 2), (2, 0)):
        rounds.end_tick(19, pace, 19 * PERIOD)
        assert (rounds.lag.need, rounds.lag.current) == (lag, lag)


def test_a_round_is_postponed_only_when_nearly_nothing_has_come_and_not_for_ever() -> None:
    lag = fresh()
    assert lag.postpones(10, 9, 0) and lag.postpones(3, 3, 4)
    assert not lag.postpones(10, 8, 0) and not lag.postpones(2, 2, 0) and not lag.postpones(10, 10, 5)


def test_what_was_measured_before_a_stall_is_forgotten() -> None:
    lag = fresh()
    play(lag, range(8), 1.0)
    lag.forget()
    lag.close([], 4.0)
    assert lag.need == 0 and lag.current == 0


def test_a_gossip_of_a_tick_far_ahead_is_not_noted() -> None:
    lag = fresh()
    play(lag, range(5), 0.0)
    for tick in range(1000, 1100):
        lag.hear(tick, 2.0)
    assert max(lag._late) <= 4
