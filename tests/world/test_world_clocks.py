"""The World node, event by event: both clocks, who is waited for, whose commands count."""

import pytest

from protocol.messages import Observation
from protocol.node import Alive, Gone, Started, Stop, Timer
from protocol.observer_messages import Truth
from tests.world.stage import POSES, command, config, feed, hello, of_kind, started
from world.world import World

# ---------------------------------------------------------------- lockstep


def test_lockstep_waits_for_the_command_of_every_live_agent() -> None:
    world, _ = started(config())
    assert feed(world, command("s1", 0)) == []
    assert world.deadline() == 5.0
    effects = feed(world, command("s2", 0, (0.0, -2.0), turn_rate=1.0), now=1.0)
    assert [(one.recipient, one.tick, one.time, one.pose) for one in of_kind(Observation, effects)] == [
        ("s1", 1, 0.5, (10.5, 10.0, 0.0)),
        ("s2", 1, 0.5, (30.0, 29.0, 1.5)),
    ]
    assert of_kind(Truth, effects)[0].tick == 1
    assert world.deadline() == 6.0
    assert world.ticks_without_command == 0


def test_lockstep_goes_on_without_a_silent_agent_and_its_body_stands_still() -> None:
    world, _ = started(config())
    feed(world, command("s1", 0), command("s2", 0))
    effects = feed(world, command("s1", 1), now=0.0) + feed(world, Timer(), now=5.0)
    assert [one.pose for one in of_kind(Observation, effects)] == [(11.0, 10.0, 0.0), (30.5, 30.0, 1.0)]
    assert world.ticks_without_command == 1


def test_a_paced_lockstep_holds_a_tick_back_until_its_time_and_changes_nothing_else() -> None:
    world, _ = started(config(max_rate=0.25), now=10.0)  # 0.5 s of the world in 2 s
    assert feed(world, command("s1", 0), command("s2", 0), now=10.1) == []
    assert world.deadline() == 12.0
    assert feed(world, Timer(), now=11.9) == []
    paced = feed(world, Timer(), now=12.0)
    free, _ = started(config())
    assert [one.detections_bytes for one in of_kind(Observation, paced)] == [
        one.detections_bytes for one in of_kind(Observation, feed(free, command("s1", 0), command("s2", 0)))
    ]
    assert of_kind(Truth, paced)[0].tick == 1
    assert world.bodies.poses == free.bodies.poses
    assert world.ticks_without_command == 0


def test_a_paced_lockstep_waits_for_the_slow_as_ever_and_makes_up_for_less_than_one_tick() -> None:
    world, _ = started(config(max_rate=0.25))
    assert world.deadline() == 5.0  # the patience
    feed(world, command("s1", 0))
    assert of_kind(Truth, feed(world, command("s2", 0), now=3.0))[0].tick == 1  # 1 s late
    feed(world, command("s1", 1), command("s2", 1), now=3.1)
    assert world.deadline() == 4.0
    feed(world, Timer(), now=4.0)
    feed(world, command("s1", 2))
    feed(world, command("s2", 2), now=8.9)  # 2.9 s late: a whole tick is given up
    feed(world, command("s1", 3), command("s2", 3), now=9.0)
    assert world.tick == 4
    feed(world, command("s1", 4), command("s2", 4), now=9.1)
    assert world.deadline() == 10.9


def test_a_timer_before_its_time_does_nothing() -> None:
    world, _ = started(config())
    assert feed(world, Timer(), now=4.9) == []


def test_lockstep_does_not_wait_for_the_dead() -> None:
    world, _ = started(config())
    feed(world, command("s1", 0))
    effects = feed(world, Gone("agent", "s2", 1))
    assert [(one.recipient, one.tick) for one in of_kind(Observation, effects)] == [("s1", 1)]
    assert of_kind(Truth, effects)[0].bodies == ("s1", "s2")
    assert world.ticks_without_command == 0


def test_the_dead_do_not_move_even_if_their_command_had_come() -> None:
    world, _ = started(config())
    feed(world, command("s2", 0), Gone("agent", "s2", 1), command("s1", 0))
    assert world.bodies.poses == {"s1": (10.5, 10.0, 0.0), "s2": POSES["s2"]}


def test_a_command_of_another_tick_or_incarnation_is_ignored_and_counted() -> None:
    world, _ = started(config())
    feed(world, command("s1", 0), command("s2", 0))
    stale, early, old, stranger = command("s1", 0), command("s1", 2), command("s1", 1, incarnation=0), command("nobody", 1)
    assert feed(world, stale, early, old, stranger) == []
    assert world.ignored_commands == 4
    feed(world, command("s1", 1, (0.0, 1.0)), command("s1", 1, (1.0, 0.0)), command("s2", 1))
    assert world.ignored_commands == 5, "the second word on a tick does not count"
    assert world.bodies.poses["s1"] == (10.5, 10.5, 0.0)


def test_commands_before_the_start_and_after_death_are_ignored() -> None:
    world = World(config(), incarnation=1)
    feed(world, Started(), Alive("agent", "s1", 1), command("s1", 0))
    assert world.ignored_commands == 1
    world, _ = started(config())
    feed(world, Gone("agent", "s2", 1), command("s2", 0))
    assert world.ignored_commands == 1


def test_speed_and_turn_rate_are_clipped() -> None:
    world, _ = started(config())
    feed(world, command("s1", 0, (30.0, 40.0), turn_rate=-1000.0), command("s2", 0))
    x, y, heading = world.bodies.poses["s1"]
    assert (x, y) == (pytest.approx(10.6), pytest.approx(10.8))  # 2 m/s for half a second
    assert heading == pytest.approx(-2.5)  # 5 rad/s


def test_lockstep_ends_with_the_commands_of_the_last_tick() -> None:
    world, _ = started(config(seconds=1.0))
    feed(world, command("s1", 0), command("s2", 0), command("s1", 1))
    assert feed(world, command("s2", 1)) == [Stop(0, "done")]
    assert world.deadline() is None
    assert feed(world, Timer(), Alive("agent", "s3", 1), hello("s1"), command("s1", 1), now=99.0) == []
    assert world.bodies.poses["s1"] == (11.0, 10.0, 0.0)


def test_without_any_agent_lockstep_runs_at_the_pace_of_the_world() -> None:
    world, _ = started(config())
    feed(world, Gone("agent", "s1", 1))
    effects = feed(world, Gone("agent", "s2", 1), now=3.0)
    assert [truth.tick for truth in of_kind(Truth, effects)] == [1]
    assert world.deadline() == 3.5
    assert [truth.tick for truth in of_kind(Truth, feed(world, Timer(), now=3.5))] == [2]


def test_nobody_is_waited_for_before_it_has_spoken() -> None:
    world, _ = started(config())
    feed(world, Gone("agent", "s2", 1), Alive("agent", "s2", 2))
    effects = feed(world, command("s1", 0))
    assert {one.recipient for one in of_kind(Observation, effects)} == {"s1", "s2"}
    assert [truth.tick for truth in of_kind(Truth, feed(world, command("s1", 1)))] == [2]
    feed(world, hello("s2", incarnation=2), command("s1", 2))
    assert feed(world, command("s1", 3)) == [], "now it has"


# ---------------------------------------------------------------- real time


def test_real_time_ticks_on_the_clock_and_rate_divides_the_period() -> None:
    world, effects = started(config("realtime", rate=2.0), now=100.0)
    assert of_kind(Truth, effects)[0].tick == 0
    assert world.deadline() == 100.25
    assert feed(world, command("s1", 0), command("s2", 0), now=100.1) == []
    (truth,) = of_kind(Truth, feed(world, Timer(), now=100.26))
    assert (truth.tick, truth.time) == (1, 0.5)
    assert world.bodies.poses["s1"] == (10.5, 10.0, 0.0)
    assert world.deadline() == 100.5, "a late timer does not shift the clock"


def test_real_time_holds_the_newest_command_for_two_seconds_of_world_time() -> None:
    world, _ = started(config("realtime"))
    feed(world, command("s1", 0, (2.0, 0.0)))
    xs = []
    for tick in range(1, 9):
        feed(world, Timer(), now=tick * 0.5)
        xs.append(world.bodies.poses["s1"][0])
    assert xs == [11.0, 12.0, 13.0, 14.0, 14.0, 14.0, 14.0, 14.0]


def test_in_ticks_of_two_seconds_and_more_real_time_takes_a_command_that_is_a_tick_late() -> None:
    world, _ = started(config("realtime", dt=2.5))
    feed(world, Timer(), now=2.5)
    feed(world, command("s1", 0), now=2.6)
    feed(world, Timer(), now=5.0)
    assert world.bodies.poses["s1"] == (12.5, 10.0, 0.0)


def test_real_time_takes_a_late_command_if_it_is_the_newest() -> None:
    world, _ = started(config("realtime"))
    feed(world, Timer(), now=0.5)
    feed(world, command("s1", 0, (0.0, 1.0)), now=0.6)
    feed(world, Timer(), now=1.0)
    assert world.bodies.poses["s1"] == (10.0, 10.5, 0.0)
    feed(world, command("s1", 2, (1.0, 0.0)), command("s1", 1, (0.0, 1.0)), now=1.1)
    feed(world, Timer(), now=1.5)
    assert world.bodies.poses["s1"] == (10.5, 10.5, 0.0)
    assert world.ignored_commands == 1


def test_real_time_counts_the_ticks_that_ended_before_their_commands_came() -> None:
    world, _ = started(config("realtime"))
    feed(world, command("s1", 0), command("s2", 0), now=0.4)
    feed(world, Timer(), now=0.5)
    assert world.ticks_without_command == 0
    feed(world, command("s1", 1), now=0.6)
    feed(world, Timer(), now=1.0)
    feed(world, command("s2", 1), command("s1", 2), now=1.1)
    feed(world, Timer(), now=1.5)
    assert world.ticks_without_command == 2
    feed(world, Gone("agent", "s2", 1), command("s1", 3), now=1.6)
    feed(world, Timer(), now=2.0)
    assert world.ticks_without_command == 2 and world.tick == 4


def test_real_time_stops_a_body_at_once_when_its_agent_is_gone() -> None:
    world, _ = started(config("realtime"))
    feed(world, command("s1", 0), command("s2", 0), Gone("agent", "s1", 1))
    effects = feed(world, Timer(), now=0.5)
    assert world.bodies.poses == {"s1": POSES["s1"], "s2": (30.5, 30.0, 1.0)}
    assert [one.recipient for one in of_kind(Observation, effects)] == ["s2"]


def test_a_new_incarnation_does_not_drive_on_by_the_command_of_the_old_one() -> None:
    world, _ = started(config("realtime"))
    feed(world, command("s1", 0), Alive("agent", "s1", 2), Gone("agent", "s1", 1))
    feed(world, Timer(), now=0.5)
    assert world.bodies.poses["s1"] == POSES["s1"]


def test_real_time_catches_up_tick_by_tick_when_it_is_a_little_late() -> None:
    world, _ = started(config("realtime"))
    ticks = [truth.tick for _ in range(5) for truth in of_kind(Truth, feed(world, Timer(), now=1.6))]
    assert ticks == [1, 2, 3], "those of 0.5, 1.0 and 1.5 s, and no more"
    assert world.deadline() == 2.0
    assert world.re_anchored == 0


def test_real_time_gives_up_catching_up_when_it_is_very_late() -> None:
    world, _ = started(config("realtime"))
    assert [truth.tick for truth in of_kind(Truth, feed(world, Timer(), now=4.0))] == [1]
    assert world.re_anchored == 1
    assert world.deadline() == 4.5


def test_real_time_ends_when_the_last_tick_has_had_its_time() -> None:
    world, _ = started(config("realtime", seconds=1.0))
    feed(world, Timer(), now=0.5)
    assert feed(world, Timer(), now=1.0) == [Stop(0, "done")]
