"""The World node, event by event: the start line, restarts and guests, scenarios that it refuses."""

import msgspec
import numpy as np
import pytest

from protocol.messages import Hello, Observation
from protocol.node import Alive, Gone, Received, Rejected, Reopen, Started, Stop, Subscribe, Timer, received
from protocol.observer_messages import Truth
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import BadSetting, LimitSettings, SensorSettings
from protocol.settings_digest import common_sections, shared_settings
from tests.names import names_in
from tests.world.stage import POSES, command, config, feed, hello, of_kind, started
from world.config import BodySettings, WorldConfig
from world.presence import MOST_STRANGERS
from world.world import EXIT_INCOMPLETE, HELLO_PERIOD, World

# ---------------------------------------------------------------- the start line


def test_the_world_listens_to_hellos_and_commands_and_says_hello() -> None:
    world = World(config(), incarnation=3)
    effects = feed(world, Started())
    assert [effect.expression for effect in of_kind(Subscribe, effects)] == [
        "covey/covey/hello/*",
        "covey/covey/command/*",
        "covey/covey/halt",
    ]
    settings = shared_settings(common_sections(config()))
    assert of_kind(Hello, effects) == [Hello(sender="world", incarnation=3, role="world", settings=settings)]
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


def test_it_does_not_start_alone_and_the_time_before_the_first_agent_does_not_count() -> None:
    world = World(config(start_timeout=2.0), incarnation=1)
    feed(world, Started())
    assert of_kind(Observation, feed(world, Timer(), now=50.0)) == []
    assert of_kind(Observation, feed(world, Alive("agent", "s1", 1), Timer(), now=51.0)) == []
    assert of_kind(Observation, feed(world, Timer(), now=52.9)) == []
    assert [one.recipient for one in of_kind(Observation, feed(world, Timer(), now=53.2))] == ["s1"]


def test_it_waits_as_long_as_agents_keep_coming_and_find_each_other() -> None:
    world = World(config(start_timeout=2.0), incarnation=1)
    feed(world, Started(), Alive("agent", "s1", 1), hello("s1", heard=()), now=10.0)
    assert of_kind(Observation, feed(world, Timer(), hello("s1", heard=("world",)), Alive("agent", "s2", 1), now=11.9)) == []
    assert of_kind(Observation, feed(world, Timer(), hello("s2", heard=("s1",)), now=13.8)) == []
    assert of_kind(Observation, feed(world, Timer(), hello("s2", heard=("s1",)), now=15.7)) == []  # says nothing new
    assert [one.recipient for one in of_kind(Observation, feed(world, Timer(), now=16.0))] == ["s1", "s2"]


def test_it_waits_without_limit_for_agents_that_a_parent_expects_and_no_longer_for_one_that_has_ended() -> None:
    world = World(config(start_timeout=2.0), incarnation=1)
    world.expect(("s1", "s2"))
    feed(world, Started(), Alive("agent", "s1", 1), hello("s1", heard=("world",)))
    assert of_kind(Observation, feed(world, Timer(), now=10_000.0)) == []
    world.expect(("s1",))
    assert [one.recipient for one in of_kind(Observation, feed(world, Timer(), now=10_001.0))] == ["s1"]


def test_a_strict_world_stops_when_an_agent_does_not_come() -> None:
    world = World(config(start_timeout=2.0, strict=True), incarnation=1)
    feed(world, Started(), Alive("agent", "s1", 1), hello("s1", heard=("world",)), now=10.0)
    assert of_kind(Stop, feed(world, Timer(), now=11.9)) == []
    assert feed(world, Timer(), now=12.2)[1:] == [Stop(EXIT_INCOMPLETE, "not all agents are ready, and the run is strict")]
    assert not world.started and world.deadline() is None


def test_a_strict_world_starts_with_all() -> None:
    world, effects = started(config(strict=True))
    assert len(of_kind(Observation, effects)) == 2 and world.started


def test_truth_tells_watchers_what_the_agents_must_not_know() -> None:
    world, effects = started(config())
    (truth,) = of_kind(Truth, effects)
    truth.check()
    assert truth.targets.tobytes() == world.scene.targets.positions.tobytes()
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
    guest = received(Hello(sender="guest", incarnation=1, sensor=SENSOR_CLASSES["D"]))
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


def test_a_guest_of_a_class_that_the_scenario_names_gets_a_body_and_one_of_an_unknown_class_is_told_of_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    own = SensorSettings(model="covey.examples.sensors:RangeFalling", parameters={"angle": 90.0, "radius": 9.0, "scale": 6.0})
    world, _ = started(msgspec.structs.replace(config(), sensors={"R": own}))
    for name, kind in (("known", "R"), ("other", "Q")):
        said = received(Hello(sender=name, incarnation=1, sensor_class=kind))
        feed(world, Alive("agent", name, 1), said, said)
    feed(world, command("s1", 0))
    (truth,) = of_kind(Truth, feed(world, command("s2", 0)))
    assert truth.bodies == ("s1", "s2", "known") and world.scene.sensors["known"].reach == 9.0
    assert [record.message.partition(";")[0] for record in caplog.records] == ["other gets no body: sensor class 'Q' does not exist"]


def roomless(settings: WorldConfig) -> WorldConfig:
    """Two bodies of 19 m at the sides of a stage of 40 m, which leave no third one room."""
    poses = {"s1": (0.0, 20.0, 0.0), "s2": (40.0, 20.0, 0.0)}
    return msgspec.structs.replace(settings, limits=LimitSettings(radius=19.0), bodies=BodySettings(start="given", poses=poses))


def guest(name: str = "guest", incarnation: int = 1) -> tuple[Alive, Received]:
    return Alive("agent", name, incarnation), received(Hello(sender=name, incarnation=incarnation, sensor=SENSOR_CLASSES["D"]))


def test_a_guest_without_room_gets_no_body_is_told_of_once_and_ends_no_run(caplog: pytest.LogCaptureFixture) -> None:
    world, _ = started(roomless(config()))
    feed(world, *guest(), guest()[1], command("s1", 0))
    (truth,) = of_kind(Truth, feed(world, command("s2", 0)))
    assert truth.bodies == ("s1", "s2") and list(world.scene.sensors) == ["s1", "s2"]
    assert [record.message for record in caplog.records] == [
        "guest gets no body: limits.radius = 19: the arena has no room for 3 bodies of this size"
    ]
    feed(world, *guest(incarnation=2))
    assert len(caplog.records) == 2, "a new process is a new attempt"


def test_only_so_many_guests_get_a_body_and_who_has_one_keeps_it(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """Anybody can make up names, and the world publishes an observation for each body."""
    monkeypatch.setattr("world.world.MOST_GUESTS", 2)
    world, _ = started(config())
    for name in ("a", "b", "c", "d"):
        feed(world, *guest(name))
    assert list(world.bodies.poses) == ["s1", "s2", "a", "b"]
    complaint = "2 guests have one already; agents that belong to the run should stand in [members]"
    assert [record.message for record in caplog.records] == [f"{name} gets no body: {complaint}" for name in ("c", "d")]
    feed(world, guest("c")[1], Gone("agent", "a", 1), *guest("a", incarnation=2), command("s1", 0), command("a", 0, incarnation=2))
    (truth,) = of_kind(Truth, feed(world, command("b", 0), command("s2", 0)))
    assert truth.alive == ("s1", "s2", "a", "b") and len(caplog.records) == 2


def test_warnings_about_guests_are_few_and_short(caplog: pytest.LogCaptureFixture) -> None:
    """Anybody can make up incarnations, and a class of any length."""
    world, _ = started(config())
    for incarnation in range(100):
        feed(world, Alive("agent", "x", incarnation), received(Hello(sender="x", incarnation=incarnation, sensor_class="Q" * 5000)))
    assert len(caplog.records) == 64 and max(len(record.message) for record in caplog.records) < 300


def test_made_up_names_leave_nothing_behind_and_its_hello_lists_none_of_them() -> None:
    world, _ = started(config())
    for number in range(3 * MOST_STRANGERS):
        name = f"x{number}"
        feed(world, hello(name), Alive("agent", name, 1), hello(name), Gone("agent", name, 1), hello(f"y{number}"))
    answers = of_kind(Hello, feed(world, Gone("agent", "s2", 1), Alive("agent", "s2", 2)))
    assert [answer.heard for answer in answers] == [("s1",)]
    kept = {name for name in names_in(world, "world", "protocol") if name[0] in "xy"}
    assert kept == {f"y{number}" for number in range(2 * MOST_STRANGERS, 3 * MOST_STRANGERS)}


def test_made_up_names_do_not_put_off_the_start() -> None:
    world = World(config(start_timeout=2.0), incarnation=1)
    feed(world, Started(), Alive("agent", "s1", 1), hello("s1"))
    for tenth in range(20):
        feed(world, hello(f"x{tenth}", heard=("s1",) * tenth), now=0.1 * tenth)
    assert of_kind(Truth, feed(world, Timer(), now=2.1)) and world.started


def test_other_roles_are_no_agents() -> None:
    world = World(config(start_timeout=0.1), incarnation=1)
    watcher = received(Hello(sender="monitor", incarnation=1, role="monitor", sensor=SENSOR_CLASSES["A"]))
    assert feed(world, Started(), Alive("monitor", "monitor", 1), watcher, now=9.0)[4:] == []
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


# ---------------------------------------------------------------- bad scenarios


def test_an_agent_must_not_be_called_world() -> None:
    with pytest.raises(BadSetting, match=r"members\.world: this name belongs to the world"):
        World(WorldConfig(members={"world": "A"}), 1)


def test_an_unknown_sensor_class_is_named() -> None:
    with pytest.raises(BadSetting, match="sensor class 'Z' does not exist"):
        World(WorldConfig(members={"s1": "Z"}), 1)
