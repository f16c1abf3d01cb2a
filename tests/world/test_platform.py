"""Platforms of the user's own: how they are built, what they may answer, and the contract that they keep."""

import math
import time
from typing import Any

import numpy as np
import pytest

from deploy.cli.scenario_checks import check_platform_class
from deploy.live import platform_check
from deploy.live.platform_check import check_platform
from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol.messages import Observation
from protocol.node import Started, Timer
from protocol.settings import BadSetting, LimitSettings
from tests.world.robot import ROBOT, Robot, config, started
from world.body import Body
from world.platform import Simulated, build_platform, platform_class

HERE, EXAMPLE = "tests.world.test_platform", "covey.examples.robots:DifferentialDrive"


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


@pytest.mark.parametrize(("platform", "count", "remarked"), [(ROBOT, 4, True), (ROBOT, 0, False), (EXAMPLE, 4, False)])
def test_simulated_targets_beside_the_detections_of_a_robot_are_remarked_on(platform: str, count: int, remarked: bool) -> None:
    """A platform that is itself a simulation has its detections simulated."""
    settings = {"bodies.host": "own", "bodies.platform": platform, "bodies.parameters": {"places": {}}, "targets.count": count}
    if platform == ROBOT:
        del settings["bodies.parameters"]
    line = check_platform_class(resolve("quick", settings))
    said = f". Where it returns detections targets.count = {count} should be 0: scores are those of simulated targets"
    assert line == f"{platform} can be imported; `covey platform` tries it" + (said if remarked else "")


def test_a_platform_may_get_its_methods_when_it_is_built() -> None:
    body = Body(config(f"{HERE}:GivenItsMethods"), "s1", 1, 100.0)
    body.handle(Started(), 0.0)
    assert body.platform.read(0)[0] == Robot.answer[0]


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
    assert str(refused.value).startswith(f"{ROBOT}.read(0)") and "\n" not in str(refused.value)
    assert refused.value.exit_code == 1, "systemd starts the process again"
    assert Robot.told[-1] == "stop"


def test_its_own_detections_reach_the_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    body = started(monkeypatch, ((5.0, 6.0, 7.0), np.array([[1.0, 2.0], [3.0, 4.0]])))
    [seen] = body.handle(Timer(), 0.0)
    assert isinstance(seen, Observation)
    assert (seen.recipient, seen.tick, seen.pose) == ("s1", 0, (5.0, 6.0, 7.0))
    assert seen.detections.tolist() == [[1.0, 2.0], [3.0, 4.0]]


@pytest.mark.parametrize(("answer", "scanned"), [(False, False), (np.zeros((0, 2)), True), (np.array([]), True)])
def test_a_tick_without_a_scan_is_not_one_in_which_nothing_was_found(monkeypatch: pytest.MonkeyPatch, answer: Any, scanned: bool) -> None:
    [seen] = started(monkeypatch, ((5.0, 6.0, 7.0), answer)).handle(Timer(), 0.0)
    assert isinstance(seen, Observation)
    assert (len(seen.detections), seen.scanned) == (0, scanned)


def test_its_places_are_said_as_what_the_sensor_measures(monkeypatch: pytest.MonkeyPatch) -> None:
    measures = {"sensors.A.measures": "range-bearing", "sensors.A.range_noise": 0.1, "sensors.A.bearing_noise": 2.0}
    body = started(monkeypatch, ((5.0, 6.0, 0.5 * math.pi), np.array([[5.0, 9.0], [1.0, 6.0]])), **measures)
    [seen] = body.handle(Timer(), 0.0)
    assert isinstance(seen, Observation)
    assert seen.detections == pytest.approx(np.array([[3.0, 0.0], [4.0, 0.5 * math.pi]]), abs=1e-6)


def test_a_simulated_body_stands_where_the_last_tick_has_left_it() -> None:
    body = Simulated((1.0, 1.0, 0.0), 0.25, LimitSettings(speed=2.0, turn_rate=5.0))
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


class Centimetres(Ideal):
    """It finds a target 2 m east of it, and says that it is at 200 m."""

    def read(self, tick: int) -> Any:
        pose, _ = super().read(tick)
        return pose, np.array([[pose[0] + 200.0, pose[1]]])


class Sees(Ideal):
    """It finds a target 2 m east of it."""

    def read(self, tick: int) -> Any:
        pose, _ = super().read(tick)
        return pose, np.array([[pose[0] + 2.0, pose[1]]])


class Clock:
    """In place of the module `time`: no call takes time but those of `SlowToStop`, however busy the machine is."""

    now = 0.0

    @staticmethod
    def monotonic() -> float:
        return Clock.now

    @staticmethod
    def sleep(seconds: float) -> None:
        Clock.now += seconds


class SlowToStop(Ideal):
    def stop(self) -> None:
        Clock.now += 0.03
        super().stop()


@pytest.mark.parametrize(
    ("robot", "broken"),
    [
        (Ideal, []),
        (WrapsWhileItTurns, []),
        (NorthIsSouth, ["driven north"]),
        (LeftIsRight, ["told to turn"]),
        (BodyFrame, ["driven north"]),
        (Degrees, ["told to turn"]),
        (SlowToStop, ["no call take"]),
        (Sees, []),
        (Centimetres, ["detections l"]),
    ],
)
def test_the_contract_is_broken_by_a_robot_that_takes_a_direction_or_a_unit_for_another_or_is_slow(
    robot: type[Ideal], broken: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform_check, "time", Clock)
    rules = check_platform("s1", config(f"{HERE}:{robot.__name__}"))
    assert [rule[:12] for rule, kept in rules if not kept] == broken


@pytest.mark.slow
def test_the_contract_is_kept_by_the_example_and_broken_by_a_robot_that_does_not_stop() -> None:
    parameters = {"bodies.parameters": {"places": {"s1": [5.0, 5.0, 0.0]}}}
    example = config("covey.examples.robots:DifferentialDrive", **parameters)
    assert all(kept for _, kept in check_platform("s1", example))
    broken = [rule for rule, kept in check_platform("s1", config(f"{HERE}:Runaway")) if not kept]
    assert broken[-1] == "0.5 s after stop it stands (within 0.02 m)"
