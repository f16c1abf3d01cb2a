"""Platforms of the user's own, the fence, and the tracking layer for robots that cannot move sideways."""

import math
import time
from typing import Any

import msgspec
import numpy as np
import pytest

from covey.examples.robots import INNER, DifferentialDrive
from deploy.live.platform_check import check_platform
from deploy.scenario import Scenario, resolve, world_config
from deploy.simulation import Simulation
from protocol.messages import Command, Gossip, Hello, Observation
from protocol.node import Alive, Gone, Reopen, Started, Stop, Timer, received
from protocol.settings import BadSetting, LimitSettings
from world.body import Body, check_epoch
from world.config import WorldConfig
from world.platform import Simulated, build_platform, fenced, platform_class
from world.unicycle import twist

HERE = "tests.world.test_platform"
LIMITS = LimitSettings(speed=2.0, turn_rate=5.0)


class Robot:
    """A platform that notes what it is told and answers what a test wants."""

    answer: Any = ((5.0, 5.0, 0.0), None)
    told: list[Any]

    def __init__(self, name: str) -> None:
        Robot.told = []

    def read(self, tick: int) -> Any:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def drive(self, velocity: tuple[float, float], turn_rate: float) -> None:
        self.told.append((velocity, turn_rate))

    def stop(self) -> None:
        self.told.append("stop")


class Unstoppable:
    read = drive = Robot.read

    def __init__(self, name: str) -> None:
        pass


class GivenItsMethods:
    """It passes on what it is told, as a wrapper around a vendor's class does."""

    def __init__(self, name: str) -> None:
        self._robot = Robot(name)

    def __getattr__(self, method: str) -> Any:
        return getattr(self._robot, method)


class NeedsAPort:
    def __init__(self, name: str, port: str) -> None:
        pass


def config(platform: str = f"{HERE}:Robot", **settings: object) -> WorldConfig:
    scenario: Scenario = resolve("quick", {"team.composition": "A2", "bodies.host": "own", "bodies.platform": platform, **settings})
    return world_config(scenario)


def test_a_platform_may_get_its_methods_when_it_is_built() -> None:
    body = Body(config(f"{HERE}:GivenItsMethods"), "s1", 1, 100.0)
    body.handle(Started(), 0.0)
    assert body.platform.read(0)[0] == Robot.answer[0]


def started(monkeypatch: pytest.MonkeyPatch, answer: Any = ((5.0, 5.0, 0.0), None), **settings: object) -> Body:
    monkeypatch.setattr(Robot, "answer", answer)
    body = Body(config(**{"bodies.epoch": 100.0, "run.clock": "realtime", **settings}), "s1", 1, 100.0)
    body.handle(Started(), 0.0)
    body.handle(Alive("agent", "s1", 1), 0.0)
    return body


def test_a_body_with_half_a_session_opens_it_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """It hears its agent and sees no token, so it would stand for ever."""
    body = started(monkeypatch)
    body.handle(Gone("agent", "s1", 1), 0.0)
    effects = [effect for now in (1.0, 3.0, 5.0, 7.0) for effect in body.handle(received(Hello(sender="s1", incarnation=1)), now)]
    assert [effect for effect in effects if isinstance(effect, Reopen)] == [Reopen("s1 speaks, but its token has gone")]


def command(tick: int, velocity: tuple[float, float] = (1.0, 0.0), incarnation: int = 1) -> Any:
    return received(Command(sender="s1", incarnation=incarnation, tick=tick, velocity=velocity, turn_rate=0.5))


@pytest.mark.parametrize(
    ("platform", "complaint"),
    [
        (f"{HERE}:Unstoppable", "has no method stop"),
        (f"{HERE}:Nobody", "has no Nobody"),
        (f"{HERE}:NeedsAPort", "NeedsAPort: missing a required argument: 'port'; it takes name, port, and is built as Class[(]name, "),
        (f"{HERE}:math", "math is a module: should be a class"),
        ("robot", "should read module:Name"),
    ],
)
def test_a_platform_that_cannot_be_one_is_refused_by_name(platform: str, complaint: str) -> None:
    with pytest.raises(BadSetting, match=complaint) as refused:
        build_platform("s1", config(platform))
    assert str(refused.value).startswith(f"bodies.platform = {platform!r}: ") and "\n" not in str(refused.value)
    if platform != f"{HERE}:Unstoppable":  # a platform may get its methods when it is built
        with pytest.raises(BadSetting, match=complaint):
            platform_class(config(platform).bodies)


def test_a_platform_is_imported_without_being_built(monkeypatch: pytest.MonkeyPatch) -> None:
    def opens_its_port(self: Robot, name: str) -> None:
        raise AssertionError("built")

    monkeypatch.setattr(Robot, "__init__", opens_its_port)
    assert platform_class(config().bodies) is Robot


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        (((math.nan, 0.0, 0.0), None), "three finite numbers"),
        ((("1", 0.0, 0.0), None), "three finite numbers"),
        (((0.0, 0.0), None), "three finite numbers"),
        (None, "a pose and detections"),
        (((0.0, 0.0, 0.0), np.zeros((2, 3))), "shape"),
        (((0.0, 0.0, 0.0), np.array([[0.0, math.inf]])), "inf"),
        (((0.0, 0.0, 0.0), np.full((1, 2), 1e30)), "within"),
        (RuntimeError("no link"), "raised RuntimeError: no link"),
    ],
)
def test_a_wrong_answer_stops_the_platform_and_names_the_class(monkeypatch: pytest.MonkeyPatch, answer: Any, complaint: str) -> None:
    body = started(monkeypatch, answer)
    with pytest.raises(BadSetting, match=complaint) as refused:
        body.handle(Timer(), 0.0)
    assert str(refused.value).startswith(f"{HERE}:Robot.read(0)") and "\n" not in str(refused.value)
    assert Robot.told[-1] == "stop"


def test_its_own_detections_reach_the_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch, ((5.0, 6.0, 7.0), np.array([[1.0, 2.0], [3.0, 4.0]])))
    [seen] = body.handle(Timer(), 0.0)
    assert isinstance(seen, Observation)
    assert (seen.recipient, seen.tick, seen.pose) == ("s1", 0, (5.0, 6.0, 7.0))
    assert seen.detections.tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_its_places_are_said_as_what_the_sensor_measures(monkeypatch: pytest.MonkeyPatch) -> None:
    measures = {"sensors.A.measures": "range-bearing", "sensors.A.range_noise": 0.1, "sensors.A.bearing_noise": 2.0}
    body = started(monkeypatch, ((5.0, 6.0, 0.5 * math.pi), np.array([[5.0, 9.0], [1.0, 6.0]])), **measures)
    [seen] = body.handle(Timer(), 0.0)
    assert isinstance(seen, Observation)
    assert seen.detections == pytest.approx(np.array([[3.0, 0.0], [4.0, 0.5 * math.pi]]), abs=1e-6)


def test_without_a_command_for_half_a_second_it_is_stopped_once(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.1)
    assert Robot.told == [((1.0, 0.0), 0.5)]
    for now in (0.25, 0.5, 0.59):
        body.handle(Timer(), now)
    assert Robot.told == [((1.0, 0.0), 0.5)]
    assert body.deadline() == pytest.approx(0.6)
    body.handle(Timer(), 0.6)
    body.handle(Timer(), 0.75)
    assert Robot.told[1:] == ["stop"]
    body.handle(command(3), 0.8)
    assert Robot.told[2:] == [((1.0, 0.0), 0.5)]


def test_a_late_command_drives_a_body_with_a_size_for_two_ticks_from_its_own_and_no_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch, **{"limits.radius": 0.25})
    for now in (0.0, 0.25):
        body.handle(Timer(), now)
    body.handle(command(0), 0.4)
    assert Robot.told == [((1.0, 0.0), 0.5)]
    body.handle(Timer(), 0.5)
    assert Robot.told[1:] == ["stop"], "who asked knew no places of later ticks"
    body.handle(command(1), 0.8)
    assert Robot.told[2:] == [], "its time is over"


def test_in_a_paced_lockstep_a_command_holds_for_the_whole_of_a_long_tick() -> None:
    settings = {
        "team.composition": "A1",
        "bodies.host": "own",
        "run.clock": "lockstep",
        "run.max_rate": 0.25,
        "run.dt": 0.25,
        "targets.count": 1,
    }
    body, now = Body(world_config(resolve("efficacy", settings)), "s1", 1), 0.0
    body.handle(Started(), now)
    body.handle(Alive("agent", "s1", 1), now)
    hello = Hello(sender="s1", incarnation=1, role="agent", software="", sensor_class="A", max_speed=2.0, max_turn_rate=5.0, heard=())
    body.handle(received(hello), now)
    while body.tick < 0:
        now += 0.25
        body.handle(Timer(), now)
    start, tick, now = body.pose, body.tick, now + 0.1
    body.handle(received(Command(sender="s1", incarnation=1, tick=tick, velocity=(1.0, 0.0), turn_rate=0.0)), now)
    while body.tick == tick:
        due = body.deadline()
        assert due is not None
        now = max(now, due)
        body.handle(Timer(), now)
    assert body.pose[0] - start[0] == pytest.approx(0.25)


def test_a_command_of_another_life_of_the_agent_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    body.handle(Timer(), 0.0)
    body.handle(command(0, incarnation=2), 0.1)
    body.handle(command(1), 0.1)
    assert Robot.told == [] and body.ignored_commands == 2


def test_a_younger_agent_does_not_drive_on_by_the_command_of_the_older_one(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.1)
    body.handle(Alive("agent", "s1", 2), 0.15)
    assert Robot.told[1:] == ["stop"]
    body.handle(Gone("agent", "s1", 1), 0.2)
    body.handle(command(0, incarnation=2), 0.2)
    assert Robot.told[-1] != "stop", "the younger one drives it"


def test_no_gossip_of_a_tick_after_the_last_one_ends_a_body(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch, **{"run.seconds": 5.0})
    for event in (Alive("agent", "s2", 1), Alive("body", "s2", 1), Timer()):
        body.handle(event, 0.0)
    wrong = Gossip(sender="s2", incarnation=1, tick=20, pose=(1.0, 1.0, 0.0), cod=(1.0, 1.0), power_radius=0.0, unused=0.0)
    assert body.handle(received(wrong), 0.1) == [] and body.tick == 0
    body.handle(received(msgspec.structs.replace(wrong, tick=19)), 0.1)
    assert body.tick == 19


def test_a_tick_that_is_left_out_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.1)
    body.handle(Timer(), 0.55)  # tick 1 never began
    assert Robot.told[1:] == ["stop"] and body.tick == 2


def test_the_last_tick_stops_the_platform(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch, **{"run.seconds": 0.25})
    body.handle(Timer(), 0.0)
    assert body.handle(Timer(), 0.25) == [Stop(0, "done")] and Robot.told == ["stop"]


def test_the_fence_shortens_what_leads_out_and_leaves_what_leads_back(monkeypatch: pytest.MonkeyPatch) -> None:
    box = (-1.0, -1.0, 11.0, 11.0)
    assert fenced((2.0, 1.0), (5.0, 5.0, 0.0), box, 0.5) == (2.0, 1.0)
    assert fenced((2.0, 1.0), (10.5, 5.0, 0.0), box, 0.5) == (1.0, 1.0)
    assert fenced((-2.0, 2.0), (-0.5, 10.5, 0.0), box, 0.5) == (-1.0, 1.0)
    assert fenced((2.0, -2.0), (11.5, -1.5, 0.0), box, 0.5) == (0.0, 0.0)
    assert fenced((-2.0, 2.0), (11.5, -1.5, 0.0), box, 0.5) == (-2.0, 2.0)
    body = started(monkeypatch, ((43.0, 5.0, 0.0), None), **{"bodies.fence": 3.0, "arena.width": 40.0})
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.1)
    assert Robot.told == [((0.0, 0.0), 0.5)]


def test_the_fence_holds_in_a_run_that_is_faster_than_its_world(monkeypatch: pytest.MonkeyPatch) -> None:
    """At rate 8 a simulated body moves for 8 s of the world in the second for which a command counts."""
    body = started(monkeypatch, ((39.0, 5.0, 0.0), None), **{"bodies.fence": 1.0, "arena.width": 40.0, "bodies.hold": 1.0, "run.rate": 8.0})
    body.handle(Timer(), 0.0)
    body.handle(command(0), 0.01)
    assert Robot.told == [((0.25, 0.0), 0.5)]


def test_an_epoch_that_lies_too_far_ahead_is_refused() -> None:
    settings = config(**{"bodies.epoch": 1000.0, "run.clock": "realtime"})
    check_epoch(settings, 941.0)
    with pytest.raises(BadSetting, match=r"bodies.epoch = 1000.000: lies 100 s ahead of this machine's clock; should be at most 60 s"):
        check_epoch(settings, 900.0)


# ---------------------------------------------------------------------- robots that cannot move sideways


def test_ahead_of_the_axle_a_point_moves_in_any_direction() -> None:
    for heading in np.linspace(-3.0, 3.0, 13):
        forward, turn = twist(heading, (0.3, -0.2), 0.5, LIMITS)
        east, north = math.cos(heading), math.sin(heading)
        moved = forward * east - 0.5 * turn * north, forward * north + 0.5 * turn * east
        assert moved == pytest.approx((0.3, -0.2), abs=1e-12)


def test_limits_shorten_the_motion_and_keep_its_direction() -> None:
    assert twist(0.0, (0.0, 2.0), 0.2, LIMITS) == pytest.approx((0.0, 5.0))
    assert twist(0.0, (4.0, 1.0), 0.5, LIMITS) == pytest.approx((2.0, 1.0))
    assert twist(1.0, (1.0, 1.0), 0.5, LimitSettings(speed=0.0, turn_rate=5.0)) == (0.0, 0.0)


def test_the_error_over_a_tick_is_as_stated() -> None:
    """A course that changes every second, within the limits: at most |velocity| dt turn_rate h / 2 off it in a tick, and never faster."""
    rng, robot = np.random.default_rng(7), DifferentialDrive("s1", {"s1": (0.0, 0.0, 0.0)})
    (x, y, _), _ = robot.read(0)
    worst, tick, slow = -math.inf, 0, []
    for _ in range(300):
        course, speed = rng.uniform(-math.pi, math.pi), rng.uniform(0.5, 2.0)
        for _ in range(4):
            robot.drive((speed * math.cos(course), speed * math.sin(course)), 0.0)
            tick += 1
            (x1, y1, _), _ = robot.read(tick)
            along = (x1 - x) * math.cos(course) + (y1 - y) * math.sin(course)
            across = (y1 - y) * math.cos(course) - (x1 - x) * math.sin(course)
            worst = max(worst, abs(across) - speed * 0.25 * 5.0 * INNER / 2.0)
            slow.append(along / (speed * 0.25))
            x, y = x1, y1
    print(f"margin {-1000 * worst:.2f} mm; share of the way {min(slow):.2f} to {max(slow):.2f}, median {np.median(slow):.3f}")
    assert worst <= 0.0
    assert min(slow) >= 0.2 * 5.0 / 2.0 - 0.05 and max(slow) <= 1.0 + 1e-9
    assert np.median(slow) >= 0.98


def test_a_simulated_body_stands_where_the_last_tick_has_left_it() -> None:
    body = Simulated((1.0, 1.0, 0.0), 0.25, LIMITS)
    body.drive((1.0, 0.0), 0.0)
    assert body.read(2)[0] == (1.5, 1.0, 0.0)
    body.stop()
    assert body.read(9)[0] == (1.5, 1.0, 0.0)


class Runaway(Robot):
    """A robot that goes on after stop."""

    def __init__(self, name: str) -> None:
        self.begun: float | None = None

    def read(self, tick: int) -> Any:
        return ((0.2 * (time.monotonic() - self.begun) if self.begun else 0.0, 0.0, 0.0), None)

    def drive(self, velocity: tuple[float, float], turn_rate: float) -> None:
        self.begun = self.begun or time.monotonic()

    def stop(self) -> None:
        pass


def test_a_simulation_drives_no_platform_that_does_not_say_that_it_is_simulated() -> None:
    robots = resolve("quick", {"bodies.host": "own", "bodies.platform": f"{HERE}:Runaway"})
    with pytest.raises(BadSetting, match=r"^bodies\.platform = .*Runaway': a simulation drives no robots") as refused:
        Simulation(robots)
    assert "\n" not in str(refused.value)
    places = {name: [5.0 * number, 5.0, 0.0] for number, name in enumerate(robots.members)}
    example = {"bodies.platform": "covey.examples.robots:DifferentialDrive", "bodies.parameters": {"places": places}}
    Simulation(resolve("quick", {"bodies.host": "own", **example}))
    Simulation(resolve("quick", {"bodies.platform": f"{HERE}:Runaway"}))  # one world moves all bodies, and builds no platform


class Ideal:
    """It obeys for a tick of 0.25 s after each command."""

    pose = 5.0, 5.0, 0.0

    def __init__(self, name: str) -> None:
        self._motion, self._tick = (0.0, 0.0, 0.0), 0

    def read(self, tick: int) -> Any:
        x, y, heading = self.pose
        seconds, self._tick = 0.25 * (tick - self._tick), tick
        self.pose = (
            x + seconds * self._motion[0],
            y + seconds * self._motion[1],
            math.remainder(heading + seconds * self._motion[2], math.tau),
        )
        return self.pose, None

    def drive(self, velocity: tuple[float, float], turn_rate: float) -> None:
        self._motion = *velocity, turn_rate

    def stop(self) -> None:
        self._motion = 0.0, 0.0, 0.0


class WrapsWhileItTurns(Ideal):
    pose = 5.0, 5.0, 2.9


class NorthIsSouth(Ideal):
    def drive(self, velocity: tuple[float, float], turn_rate: float) -> None:
        super().drive((velocity[0], -velocity[1]), turn_rate)


class LeftIsRight(Ideal):
    def drive(self, velocity: tuple[float, float], turn_rate: float) -> None:
        super().drive(velocity, -turn_rate)


class BodyFrame(Ideal):
    """It takes the velocity for one in its own frame, and starts with heading 0."""

    def drive(self, velocity: tuple[float, float], turn_rate: float) -> None:
        east, north = math.cos(self.pose[2]), math.sin(self.pose[2])
        super().drive((velocity[0] * east - velocity[1] * north, velocity[0] * north + velocity[1] * east), turn_rate)


class Degrees(Ideal):
    def read(self, tick: int) -> Any:
        (x, y, heading), _ = super().read(tick)
        return (x, y, math.degrees(heading)), None


@pytest.mark.parametrize(
    ("robot", "broken"),
    [
        (Ideal, []),
        (WrapsWhileItTurns, []),
        (NorthIsSouth, ["driven north"]),
        (LeftIsRight, ["told to turn"]),
        (BodyFrame, ["driven north"]),
        (Degrees, ["told to turn"]),
    ],
)
def test_the_contract_is_broken_by_a_robot_that_takes_a_direction_for_another(
    robot: type[Ideal], broken: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    rules = check_platform("s1", config(f"{HERE}:{robot.__name__}"))
    assert [rule[:12] for rule, kept in rules if not kept] == broken


@pytest.mark.slow
def test_the_contract_is_kept_by_the_example_and_broken_by_a_robot_that_does_not_stop() -> None:
    parameters = {"bodies.parameters": {"places": {"s1": [5.0, 5.0, 0.0]}}}
    example = config("covey.examples.robots:DifferentialDrive", **parameters)
    assert all(kept for _, kept in check_platform("s1", example))
    broken = [rule for rule, kept in check_platform("s1", config(f"{HERE}:Runaway")) if not kept]
    assert broken[-1] == "0.5 s after stop it stands (within 0.02 m)"


def test_a_late_loss_of_an_old_body_takes_its_successor_not_out_of_the_ring_of_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch)
    for event in (Alive("agent", "s2", 1), Alive("body", "s2", 1), Alive("body", "s2", 2), Gone("body", "s2", 1)):
        body.handle(event, 0.1)
    assert body._ring == ("s2",)
    body.handle(Gone("body", "s2", 2), 0.2)
    assert body._ring == ()


def test_a_body_in_lockstep_keeps_a_pause_that_is_longer_than_its_patience() -> None:
    paced = {"run.clock": "lockstep", "run.max_rate": 0.1, "run.patience": 0.5, "run.start_timeout": 1.0}
    body = Body(config("simulated", **paced), "s1", 1)
    for event in (Started(), Alive("agent", "s1", 1), received(Hello(sender="s1", incarnation=1))):
        body.handle(event, 100.0)
    body.handle(Timer(), 102.0)
    body.handle(Timer(), 102.5)
    assert body.tick == 1 and body._waiting
    assert body.deadline() == 102.0 + body._pause == 104.5
