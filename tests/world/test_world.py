"""The World node, event by event: the start line, both clocks, who is waited for, whose commands count."""

import math
from typing import TypeVar

import msgspec
import numpy as np
import pytest

from protocol.messages import Command, Hello, Message, Observation, Truth
from protocol.node import Alive, Effect, Event, Gone, Received, Rejected, Reopen, Started, Stop, Subscribe, Timer
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import ArenaSettings, BadSetting, DetectionSettings, RunSettings
from protocol.virtual import VirtualBus
from world.config import BodySettings, TargetSettings, WorldConfig
from world.world import HELLO_PERIOD, World

T = TypeVar("T")
POSES = {"s1": (10.0, 10.0, 0.0), "s2": (30.0, 30.0, 1.0)}


def config(clock: str = "lockstep", **run: object) -> WorldConfig:
    settings = {"seconds": 10.0, "dt": 0.5, "clock": clock, "patience": 5.0, "start_timeout": 60.0, **run}
    return WorldConfig(
        run=msgspec.convert(settings, RunSettings),
        arena=ArenaSettings(width=40.0, height=40.0),
        detection=DetectionSettings(clutter=0.5),
        members={"s1": "A", "s2": "B"},
        targets=TargetSettings(count=60, border="reflect"),
        bodies=BodySettings(start="given", poses=POSES),
    )


def hello(name: str, incarnation: int = 1, heard: tuple[str, ...] = ("s1", "s2", "world")) -> Received:
    return Received(Hello(sender=name, incarnation=incarnation, heard=heard))


def command(name: str, tick: int, velocity: tuple[float, float] = (1.0, 0.0), incarnation: int = 1, turn_rate: float = 0.0) -> Received:
    return Received(Command(sender=name, incarnation=incarnation, tick=tick, velocity=velocity, turn_rate=turn_rate))


def feed(world: World, *events: Event, now: float = 0.0) -> list[Effect]:
    return [effect for event in events for effect in world.handle(event, now)]


def of_kind(kind: type[T], effects: list[Effect]) -> list[T]:
    return [effect for effect in effects if isinstance(effect, kind)]


def started(settings: WorldConfig, now: float = 0.0) -> tuple[World, list[Effect]]:
    """A world with both members ready, and what it did at the start line."""
    world = World(settings, incarnation=1)
    feed(world, Started(), Alive("agent", "s1", 1), Alive("agent", "s2", 1), hello("s1"), now=now)
    return world, feed(world, hello("s2"), now=now)


# ---------------------------------------------------------------- the start line


def test_the_world_listens_to_hellos_and_commands_and_says_hello() -> None:
    world = World(config(), incarnation=3)
    effects = feed(world, Started())
    assert [effect.expression for effect in of_kind(Subscribe, effects)] == ["covey/covey/hello/*", "covey/covey/command/*"]
    assert of_kind(Hello, effects) == [Hello(sender="world", incarnation=3, role="world")]
    assert world.deadline() == HELLO_PERIOD


def test_it_repeats_its_hello_with_the_names_that_it_has_heard() -> None:
    world = World(config(), incarnation=1)
    feed(world, Started(), Alive("agent", "s2", 1), hello("s2", heard=()), now=7.0)
    assert feed(world, Timer(), now=7.1) == []
    (again,) = of_kind(Hello, feed(world, Timer(), now=7.25))
    assert again.heard == ("s2",)
    assert world.deadline() == 7.5


def test_it_asks_for_a_new_session_when_the_agents_hear_one_whom_it_does_not() -> None:
    world = World(config(start_timeout=1000.0), incarnation=1)
    feed(world, Started(), Alive("agent", "s1", 1))
    found = [(now, effect) for now in range(0, 20, 2) for effect in feed(world, hello("s1", heard=("s2", "world")), now=float(now))]
    assert [effect for _, effect in found if isinstance(effect, Reopen)] == [Reopen("the others hear s2, world does not")]
    feed(world, hello("s2"), now=20.0)
    feed(world, Gone("agent", "s1", 1), now=20.0)
    (again,) = of_kind(Hello, feed(world, Timer(), now=21.0))
    assert again.heard == ("s2",)


def test_it_starts_when_everybody_hears_everybody() -> None:
    world = World(config(), incarnation=1)
    feed(world, Started(), Alive("agent", "s1", 1), Alive("agent", "s2", 1), hello("s1"))
    assert of_kind(Observation, feed(world, hello("s2", heard=("world",)))) == []
    effects = feed(world, hello("s2"))
    assert [(one.recipient, one.tick, one.time, one.pose) for one in of_kind(Observation, effects)] == [
        ("s1", 0, 0.0, POSES["s1"]),
        ("s2", 0, 0.0, POSES["s2"]),
    ]
    assert of_kind(Hello, effects)[0].heard == ("s1", "s2")


def test_a_token_may_come_after_the_hello() -> None:
    world = World(config(), incarnation=1)
    feed(world, Started(), hello("s1"), hello("s2"), Alive("agent", "s1", 1))
    assert not world.started
    assert len(of_kind(Observation, feed(world, Alive("agent", "s2", 1)))) == 2


def test_it_goes_on_with_who_is_there_when_the_time_is_up() -> None:
    world = World(config(start_timeout=2.0), incarnation=1)
    feed(world, Started(), Alive("agent", "s2", 1), hello("s2"), now=100.0)
    assert of_kind(Observation, feed(world, Timer(), now=101.9)) == []
    assert [one.recipient for one in of_kind(Observation, feed(world, Timer(), now=102.2))] == ["s2"]


def test_it_does_not_start_alone() -> None:
    world = World(config(start_timeout=2.0), incarnation=1)
    feed(world, Started())
    assert of_kind(Observation, feed(world, Timer(), now=50.0)) == []
    assert [one.recipient for one in of_kind(Observation, feed(world, Alive("agent", "s1", 1), now=50.1))] == ["s1"]


def test_truth_tells_watchers_what_the_agents_must_not_know() -> None:
    world, effects = started(config())
    (truth,) = of_kind(Truth, effects)
    truth.check()
    assert truth.targets.tobytes() == world.targets.positions.tobytes()
    assert truth.ids.tolist() == list(range(1, 61))
    assert truth.bodies == truth.alive == ("s1", "s2")
    np.testing.assert_array_equal(truth.poses, [POSES["s1"], POSES["s2"]])


def test_truth_counts_the_targets_in_view_of_live_agents_only() -> None:
    world, effects = started(config())
    (truth,) = of_kind(Truth, effects)
    seen = [SENSOR_CLASSES[letter].probability(truth.targets, POSES[name]) > 0 for letter, name in (("A", "s1"), ("B", "s2"))]
    assert truth.in_view == np.sum(seen[0] | seen[1]) > 0
    (later,) = of_kind(Truth, feed(world, Gone("agent", "s1", 1), command("s2", 0, (0.0, 0.0))))
    assert later.alive == ("s2",)
    assert later.bodies == ("s1", "s2")
    assert later.in_view == np.sum(SENSOR_CLASSES["B"].probability(later.targets, POSES["s2"]) > 0)


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
    assert world.late_commands == 0


def test_lockstep_goes_on_without_a_silent_agent_and_its_body_stands_still() -> None:
    world, _ = started(config())
    feed(world, command("s1", 0), command("s2", 0))
    effects = feed(world, command("s1", 1), now=0.0) + feed(world, Timer(), now=5.0)
    assert [one.pose for one in of_kind(Observation, effects)] == [(11.0, 10.0, 0.0), (30.5, 30.0, 1.0)]
    assert world.late_commands == 1


def test_a_timer_before_its_time_does_nothing() -> None:
    world, _ = started(config())
    assert feed(world, Timer(), now=4.9) == []


def test_lockstep_does_not_wait_for_the_dead() -> None:
    world, _ = started(config())
    feed(world, command("s1", 0))
    effects = feed(world, Gone("agent", "s2", 1))
    assert [(one.recipient, one.tick) for one in of_kind(Observation, effects)] == [("s1", 1)]
    assert of_kind(Truth, effects)[0].bodies == ("s1", "s2")
    assert world.late_commands == 0


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


# ---------------------------------------------------------------- restarts and guests


def test_a_restarted_agent_finds_its_body_where_it_stood() -> None:
    world, _ = started(config())
    feed(world, command("s1", 0), command("s2", 0), Gone("agent", "s1", 1), command("s2", 1))
    effects = feed(world, Alive("agent", "s1", 9), hello("s1", incarnation=9), command("s2", 2))
    assert [one.pose for one in of_kind(Observation, effects) if one.recipient == "s1"] == [(10.5, 10.0, 0.0)]
    feed(world, command("s1", 3, incarnation=1))
    assert world.ignored_commands == 1
    feed(world, command("s1", 3, incarnation=9), command("s2", 3))
    assert world.bodies.poses["s1"] == (11.0, 10.0, 0.0)


def test_a_new_incarnation_before_the_old_token_is_gone_is_not_waited_for_in_this_tick() -> None:
    world, _ = started(config())
    feed(world, command("s2", 0))
    effects = feed(world, Alive("agent", "s1", 2))
    assert of_kind(Truth, effects)[0].tick == 1
    assert feed(world, Gone("agent", "s1", 1)) == []
    assert world.bodies.poses["s1"] == POSES["s1"]


def test_a_late_comer_is_greeted_when_it_appears_and_when_it_speaks() -> None:
    world, _ = started(config())
    feed(world, Gone("agent", "s2", 1))
    assert len(of_kind(Hello, feed(world, Alive("agent", "s2", 2)))) == 1
    assert len(of_kind(Hello, feed(world, hello("s2", incarnation=2)))) == 1
    assert of_kind(Hello, feed(world, hello("s2", incarnation=2))) == [], "once is enough"


def test_a_guest_with_a_wedge_gets_a_body_at_its_keyed_start() -> None:
    guest = Received(Hello(sender="guest", incarnation=1, sensor=SENSOR_CLASSES["D"]))
    poses = []
    for events in ((Alive("agent", "guest", 1), guest), (guest, Alive("agent", "guest", 1))):
        world, _ = started(config())
        feed(world, *events, command("s1", 0))
        effects = feed(world, command("s2", 0))
        poses += [one.pose for one in of_kind(Observation, effects) if one.recipient == "guest"]
        assert of_kind(Truth, effects)[0].bodies == ("s1", "s2", "guest")
    assert len(poses) == 2
    assert poses[0] == poses[1]


def test_a_guest_without_a_sensor_gets_no_body() -> None:
    world, _ = started(config())
    feed(world, Alive("agent", "guest", 1), hello("guest"), command("s1", 0), command("s2", 0))
    assert list(world.bodies.poses) == ["s1", "s2"]


def test_other_roles_are_no_agents() -> None:
    world = World(config(start_timeout=0.1), incarnation=1)
    watcher = Received(Hello(sender="monitor", incarnation=1, role="monitor", sensor=SENSOR_CLASSES["A"]))
    assert feed(world, Started(), Alive("monitor", "monitor", 1), watcher, now=9.0)[3:] == []
    assert feed(world, Gone("monitor", "monitor", 1), Alive("world", "world", 1), now=9.0) == []
    assert list(world.bodies.poses) == ["s1", "s2"]


def test_a_younger_world_takes_over() -> None:
    world, _ = started(config())
    assert feed(world, Alive("world", "world", 2)) == [Stop(3, "a younger world has taken over")]
    assert world.deadline() is None


def test_garbage_is_counted_and_nothing_else() -> None:
    world, _ = started(config())
    assert feed(world, Rejected("s1", "format"), Rejected("s1", "size")) == []
    assert world.rejected_messages == 2


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


# ---------------------------------------------------------------- restoring


def run_on(settings: WorldConfig, ticks: int) -> tuple[World, list[Truth]]:
    world, effects = started(settings)
    truths = of_kind(Truth, effects)
    for tick in range(ticks):
        truths += of_kind(Truth, feed(world, command("s1", tick), command("s2", tick)))
    return world, truths


def test_a_restored_world_goes_on_two_ticks_later_with_the_same_targets() -> None:
    _, truths = run_on(config(), 8)
    world = World(config(), 2, truths[4])
    feed(world, Started(), Alive("agent", "s1", 1), Alive("agent", "s2", 1), hello("s1"), now=50.0)
    (truth,) = of_kind(Truth, feed(world, hello("s2"), now=50.0))
    assert (truth.tick, truth.time) == (6, 3.0)
    assert truth.targets.tobytes() == truths[6].targets.tobytes()
    assert truth.ids.tobytes() == truths[6].ids.tobytes()
    np.testing.assert_array_equal(truth.poses, truths[4].poses)


def test_a_restored_world_waits_only_a_second_and_only_for_who_was_alive() -> None:
    truth = run_on(config(), 2)[1][2]
    world = World(config(), 2, with_alive(truth, alive=("s2",)))
    feed(world, Started(), Alive("agent", "s2", 1), now=10.0)
    assert of_kind(Observation, feed(world, Timer(), now=10.5)) == []
    assert [one.recipient for one in of_kind(Observation, feed(world, Timer(), now=11.0))] == ["s2"]
    world = World(config(), 2, with_alive(truth, alive=("s2",)))
    feed(world, Started(), Alive("agent", "s2", 1), now=10.0)
    assert len(of_kind(Observation, feed(world, hello("s2"), now=10.1))) == 1


def test_real_time_goes_on_at_its_period_after_a_restore() -> None:
    truth = run_on(config(), 2)[1][2]
    world = World(config("realtime"), 2, truth)
    feed(world, Started(), Alive("agent", "s1", 1), Alive("agent", "s2", 1), hello("s1"), hello("s2"), now=70.0)
    assert world.deadline() == 70.5
    assert world.tick == 4


def test_a_truth_of_another_run_is_refused() -> None:
    truth = run_on(config(), 1)[1][1]
    with pytest.raises(BadSetting, match="restore: tick 1 that was kept does not come from this scenario and seed 2"):
        World(config(seed=2), 2, truth)


def with_alive(truth: Truth, alive: tuple[str, ...]) -> Truth:
    return msgspec.structs.replace(truth, alive=alive)


# ---------------------------------------------------------------- bad scenarios


def test_an_agent_must_not_be_called_world() -> None:
    with pytest.raises(BadSetting, match=r"members\.world: this name belongs to the world"):
        World(WorldConfig(members={"world": "A"}), 1)


def test_an_unknown_sensor_class_is_named() -> None:
    with pytest.raises(BadSetting, match="sensor class 'Z' does not exist"):
        World(WorldConfig(members={"s1": "Z"}), 1)


# ---------------------------------------------------------------- two nodes talking


class Driver:
    """The smallest agent: says hello and answers every observation by driving in a circle."""

    run, role = "covey", "agent"

    def __init__(self, name: str, incarnation: int = 1) -> None:
        self.name, self.incarnation = name, incarnation
        self.observations: list[Observation] = []
        self._heard: set[str] = set()

    def handle(self, event: Event, now: float) -> list[Effect]:
        if isinstance(event, Started):
            return [Subscribe("covey/covey/hello/*"), Subscribe(f"covey/covey/observation/{self.name}"), self._hello()]
        message = event.message if isinstance(event, Received) else None
        if isinstance(message, Hello) and message.sender not in self._heard:
            self._heard.add(message.sender)
            return [self._hello()]
        if isinstance(message, Observation):
            self.observations.append(message)
            turn, speed = 0.3, 1.5
            way = speed * math.cos(message.pose[2]), speed * math.sin(message.pose[2])
            name = {"sender": self.name, "incarnation": self.incarnation}
            return [Command(**name, tick=message.tick, velocity=way, turn_rate=turn)]
        return []

    def deadline(self) -> float | None:
        return None

    def _hello(self) -> Message:
        return Hello(sender=self.name, incarnation=self.incarnation, heard=tuple(sorted(self._heard)), sensor=SENSOR_CLASSES["B"])


def drive(settings: WorldConfig, names: tuple[str, ...]) -> dict[str, list[Observation]]:
    bus = VirtualBus()
    agents = [Driver(name) for name in names]
    bus.add(World(settings, 1))
    for agent in agents:
        bus.add(agent)
    bus.run(until=100.0)
    assert bus.stopped["world"] == Stop(0, "done")
    return {agent.name: agent.observations for agent in agents}


def transcript(observations: list[Observation]) -> list[tuple[object, ...]]:
    return [(one.tick, one.time, one.pose, one.detections_bytes) for one in observations]


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_a_whole_run_over_the_bus_gives_every_agent_every_tick(clock: str) -> None:
    heard = drive(config(clock), ("s1", "s2"))
    for observations in heard.values():
        assert [one.tick for one in observations] == list(range(20))
    assert sum(len(one.detections) for one in heard["s1"]) > 0


def test_both_clocks_tell_the_same_story() -> None:
    lockstep, realtime = drive(config(), ("s1", "s2")), drive(config("realtime"), ("s1", "s2"))
    assert transcript(lockstep["s1"]) == transcript(realtime["s1"])
    assert transcript(lockstep["s2"]) == transcript(realtime["s2"])


def test_one_agent_more_changes_nobody_elses_dice() -> None:
    alone = drive(config(), ("s1", "s2"))
    settings = config()
    bigger = msgspec.structs.replace(
        settings,
        members={"s0": "D", **settings.members},
        bodies=BodySettings(start="given", poses={**POSES, "s0": (20.0, 20.0, 0.0)}),
    )
    crowded = drive(bigger, ("s0", "s1", "s2"))
    assert transcript(crowded["s1"]) == transcript(alone["s1"])
    assert transcript(crowded["s2"]) == transcript(alone["s2"])
    assert len(crowded["s0"]) == 20
