"""The clock of a body: the tick by synchronised time, and its correction to the majority of the neighbours, worked out by hand."""

from world.clock import TickClock, TickCount, neighbours

FIVE = ("s1", "s2", "s3", "s4", "s5")
DT = 0.25


def clock(offsets: dict[str, float], now: float = 100.0, own: float = 0.0) -> TickClock:
    """A clock at `own` s behind the anchor 0, and neighbours so many s ahead of that anchor, heard at tick 400."""
    found = TickClock(DT, own)
    for name, ahead in offsets.items():
        found.hear(name, 400 + round(ahead / DT), now + (round(ahead / DT) * DT - ahead))
    return found


def test_a_tick_begins_exactly_when_it_is_due() -> None:
    found = TickClock(0.1, 1.7e9)
    for tick in (0, 1, 3, 7, 12_345, 999_999):
        due = found.due(tick)
        assert found.tick(due) == tick
        assert found.tick(due - 1e-6) == tick - 1


def test_clocks_within_half_a_period_are_left_alone() -> None:
    found = clock({name: 0.05 * (-1) ** place for place, name in enumerate(FIVE)})
    assert not found.listen(FIVE, 100.0)
    assert found.anchor == 0.0 and found.corrections == 0


def test_who_is_behind_the_majority_jumps_forward() -> None:
    found = clock(dict.fromkeys(FIVE, 1.0))
    assert found.listen(FIVE, 100.0)
    assert found.anchor == -1.0 and found.tick(100.0) == 404


def test_who_is_ahead_of_the_majority_stands_until_it_comes() -> None:
    found = clock(dict.fromkeys(FIVE, -1.0))
    assert found.listen(FIVE, 100.0)
    assert found.anchor == 1.0 and found.tick(100.0) == 396


def test_a_clock_jumps_forward_for_less_than_it_stands_for() -> None:
    assert clock(dict.fromkeys(FIVE, 0.3)).listen(FIVE, 100.0)
    assert not clock(dict.fromkeys(FIVE, -0.3)).listen(FIVE, 100.0)


def test_two_wrong_clocks_of_five_move_nobody_and_nobody_waits_for_one() -> None:
    for wrong in (3600.0, -3600.0):
        found = clock({**dict.fromkeys(FIVE, 0.0), "s1": wrong, "s2": wrong})
        assert not found.listen(FIVE, 100.0)


def test_the_word_of_half_the_neighbours_is_not_enough() -> None:
    found = clock({"s1": 1.0, "s2": 1.0})
    assert not found.listen(("s1", "s2", "s3", "s4"), 100.0)
    assert found.listen(("s1", "s2", "s3"), 100.0)


def test_of_two_the_one_behind_follows_and_the_one_ahead_does_not_wait() -> None:
    assert clock({"s1": 1.0}).listen(("s1",), 100.0)
    assert not clock({"s1": -1.0}).listen(("s1",), 100.0)


def test_an_old_word_does_not_count() -> None:
    found = clock(dict.fromkeys(FIVE, 1.0))
    assert not found.listen(FIVE, 103.0)


def test_what_former_neighbours_have_said_is_forgotten() -> None:
    found, count = clock(dict.fromkeys(FIVE, 1.0)), TickCount()
    for name in FIVE:
        count.hear(name, 7)
    assert not found.listen(("s8", "s9"), 100.0) and count.majority(("s8", "s9")) == -1
    assert not found.listen(FIVE, 100.0) and count.majority(FIVE) == -1


def test_before_the_run_has_begun_the_majority_says_when_it_began() -> None:
    found = TickClock(DT)
    for name in FIVE[:2]:
        found.hear(name, 8, 102.0)
    assert not found.listen(FIVE, 102.0)
    found.hear("s3", 8, 102.05)
    assert found.listen(FIVE, 102.05)
    assert found.anchor == 100.0


def test_neighbours_are_the_next_five_in_the_ring_of_names() -> None:
    everybody = [f"s{number}" for number in range(1, 9)]
    assert neighbours("s3", everybody) == ("s4", "s5", "s6", "s7", "s8")
    assert neighbours("s7", everybody) == ("s8", "s1", "s2", "s3", "s4")
    assert neighbours("s1", ["s1"]) == ()


def test_the_tick_that_most_have_reached_in_lockstep() -> None:
    count = TickCount()
    assert count.majority(FIVE) == -1
    for name, tick in zip(FIVE, (7, 7, 7, 9, 90)):
        count.hear(name, tick)
    assert count.majority(FIVE) == 7
    assert count.majority(("s4", "s5")) == 90
