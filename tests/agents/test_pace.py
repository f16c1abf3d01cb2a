"""The pace of an agent follows the time that a round takes it, in powers of two, and falls when the load has gone."""

from agents.pace import Pace

PERIOD = 0.125


def play(pace: Pace, ticks: range, busy: float, needs: list[int] | None = None, lag: float = 0.0) -> list[int]:
    """The paces after each round, when every round keeps the driver busy for some seconds; the world ticks in time."""
    kept, free = [], 0.0
    for tick in ticks:
        now = max(tick * PERIOD + lag, free)
        if now >= (tick + 1) * PERIOD + lag and pace.current == 1:
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
