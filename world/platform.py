"""Platforms: what a body drives and reads, simulated or a robot of the user's own.

A scenario names its own as `bodies.platform = "module:Class"`; it is built as Class(name, **bodies.parameters) in the process of the
body. Every answer is checked. A wrong one ends the process of this body with one line, after the platform was told to stop. It may be
started again: cables come loose, and localisations fail for a moment.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal, Protocol

import numpy as np

from protocol.fields import LARGEST_NUMBER, MAX_DETECTIONS
from protocol.message import Vector
from protocol.messages import Command
from protocol.pose import integrate
from protocol.sensing import Pose
from protocol.settings import BadSetting, LimitSettings
from protocol.user_classes import as_bad_setting, build, class_of, real_array, shown
from world.bodies import start_poses
from world.config import BodySettings, WorldConfig

OWN = "own"
METHODS = ("read", "drive", "stop")
BRAKED = 4.0  # s after which a body of mass that is not driven stands
SIMULATED = "simulated"
BUILT_AS = "Class(name, **bodies.parameters)"


class PlatformFailed(BadSetting):
    """A platform of the user's own has raised, or has given a wrong answer, after it was built."""

    exit_code = 1


@contextmanager
def _failing(what: str) -> Iterator[None]:
    """Turn what is raised inside the context, about an answer too, into a PlatformFailed."""
    try:
        with as_bad_setting(what):
            yield
    except BadSetting as error:
        raise PlatformFailed(str(error)) from error.__cause__


class Platform(Protocol):
    """What carries a sensor. Calls come from the event loop of its process: each must return within some ms.

    Where all of it is computed, and moves by its ticks alone, its class says `simulated = True`; else simulations refuse it.
    """

    def read(self, tick: int) -> tuple[Pose, np.ndarray | Literal[False] | None]:
        """The pose (x m, y m, heading rad) in the arena's frame and the detections (M, 2) of this tick, each x, y in that frame, m.

        Ticks grow; some may be left out. None in place of detections: the sensor of the scenario is simulated at this pose. False: the
        sensor has not scanned since the last call, unlike an array without rows, of a scan that found nothing.
        """

    def drive(self, velocity: Vector, turn_rate: float) -> None:
        """Move at this velocity (m/s, in the arena's frame) and turn rate (rad/s, counter-clockwise) until the next call."""

    def stop(self) -> None:
        """Stand still until the next `drive`. It may be called at any time, and more than once."""


class Simulated:
    """A body that obeys its command exactly for a whole tick (1), as the world moves its bodies."""

    def __init__(self, pose: Pose, dt: float, limits: LimitSettings) -> None:
        self.pose = pose
        self._dt, self._limits = dt, limits
        self._tick = 0
        self._motion: tuple[Vector, float] | None = None

    def read(self, tick: int) -> tuple[Pose, None]:
        """Move on to this tick; targets and detections are those of the scenario."""
        while self._tick < tick:
            if self._motion is not None:
                self.pose = integrate(self.pose, *self._motion, self._dt, self._limits)
            self._tick += 1
        return self.pose, None

    def drive(self, velocity: Vector, turn_rate: float) -> None:
        """Move from the last tick that was read on."""
        self._motion = velocity, turn_rate

    def stop(self) -> None:
        """Stand where the last tick has left it."""
        self._motion = None

    def put(self, pose: Pose) -> None:
        """Stand at this pose, as a body that was restored does."""
        self.pose = pose


class Physical:
    """A body of mass on wheels, alone on its floor: it keeps its own distance, but nothing stops it at a body of another process."""

    def __init__(self, pose: Pose, dt: float, limits: LimitSettings) -> None:
        from world.physical_bodies import PhysicalBodies  # an extra

        self._bodies = PhysicalBodies(dt, limits)
        self._bodies.place(OWN, pose)
        self._braking = math.ceil(BRAKED / dt)  # ticks
        self._tick = 0
        self._motion: Command | None = None

    def read(self, tick: int) -> tuple[Pose, None]:
        """Move on to this tick; targets and detections are those of the scenario."""
        if self._motion is None:  # a body that comes late, or again, need not stand through all that it has missed
            self._tick = max(self._tick, tick - self._braking)
        while self._tick < tick:
            self._bodies.move({OWN: self._motion} if self._motion is not None else {})
            self._tick += 1
        return self._bodies.poses[OWN], None

    def drive(self, velocity: Vector, turn_rate: float) -> None:
        """Move from the last tick that was read on."""
        self._motion = Command(sender=OWN, incarnation=0, tick=0, velocity=velocity, turn_rate=turn_rate)

    def stop(self) -> None:
        """Brake, and stand."""
        self._motion = None

    def put(self, pose: Pose) -> None:
        """Stand at this pose, as a body that was restored does."""
        self._bodies.place(OWN, pose)


class CheckedPlatform:
    """A platform of the user's own with checked answers; a wrong one raises PlatformFailed naming the class."""

    def __init__(self, platform: Platform, name: str) -> None:
        self._platform, self._name = platform, name

    def read(self, tick: int) -> tuple[Pose, np.ndarray | Literal[False] | None]:
        """As the platform says."""
        what = f"{self._name}.read({tick})"
        with _failing(what):
            answer = self._platform.read(tick)
            if not isinstance(answer, tuple) or len(answer) != 2:
                raise BadSetting(f"{what} returned {shown(answer)}: should be a pose and detections")
            pose, detections = answer
            return _pose(what, pose), detections if detections is None or detections is False else _detections(what, detections)

    def drive(self, velocity: Vector, turn_rate: float) -> None:
        """Tell the platform."""
        with _failing(f"{self._name}.drive"):
            self._platform.drive(velocity, turn_rate)

    def stop(self) -> None:
        """Tell the platform."""
        with _failing(f"{self._name}.stop"):
            self._platform.stop()


def _pose(what: str, value: Any) -> Pose:
    """The pose as three floats; raises BadSetting for anything else."""
    right = "a pose should be three finite numbers [x m, y m, heading rad]"
    if not isinstance(value, tuple | list | np.ndarray) or len(value) != 3:
        raise BadSetting(f"{what} returned the pose {shown(value)}: {right}")
    if not all(isinstance(number, int | float | np.number) and abs(float(number)) <= LARGEST_NUMBER for number in value):
        raise BadSetting(f"{what} returned the pose {shown(value)}: {right}")
    return float(value[0]), float(value[1]), float(value[2])


def _detections(what: str, value: Any) -> np.ndarray:
    """The detections (M, 2) float32; raises BadSetting for anything else. `np.array([])`, which is (0,), holds none."""
    if isinstance(value, np.ndarray) and value.shape == (0,):
        value = np.empty((0, 2))
    found = real_array(f"{what}, detections:", value, (-1, 2))
    if len(found) > MAX_DETECTIONS or (len(found) and np.abs(found).max() > LARGEST_NUMBER):
        raise BadSetting(f"{what} returned {len(found)} detections: should be at most {MAX_DETECTIONS}, within {LARGEST_NUMBER:g} m")
    return found.astype(np.float32)


def build_platform(name: str, config: WorldConfig) -> Platform:
    """The platform of a body; raises BadSetting naming the field."""
    settings = config.bodies
    if settings.platform == SIMULATED:
        kind = Simulated if settings.model == "point" else Physical
        return kind(start_poses(config)[name], config.run.dt, config.limits)
    try:
        platform = build(settings.platform, BUILT_AS, METHODS, name, parameters=settings.parameters)
    except ValueError as error:
        raise BadSetting(f"bodies.platform = {settings.platform!r}: {error}") from error.__cause__
    return CheckedPlatform(platform, settings.platform)


def platform_class(settings: BodySettings) -> Callable[..., Any]:
    """The user's own class, not built yet: that may open the ports of a robot, or give it its methods. Raises BadSetting with the field."""
    try:
        return class_of(settings.platform, BUILT_AS, "", parameters=settings.parameters)
    except ValueError as error:
        raise BadSetting(f"bodies.platform = {settings.platform!r}: {error}; should be simulated or module:Class") from error.__cause__


def refuse_robots(settings: BodySettings) -> None:
    """Raise BadSetting for a platform that does not say that it is itself a simulation: a simulated run would drive robots, unpaced."""
    if settings.platform != SIMULATED and getattr(platform_class(settings), SIMULATED, False) is not True:
        where = f"bodies.platform = {settings.platform!r}"
        raise BadSetting(f'{where}: a simulation drives no robots; should be "simulated", or a class that says `simulated = True`')


def fenced(velocity: Vector, pose: Pose, box: tuple[float, float, float, float], seconds: float) -> Vector:
    """The velocity, m/s, shortened per axis so that `seconds` at it do not leave the box (west, south, east, north), m.

    Outside the box only motion towards it is left.
    """
    x = min(max(velocity[0], min(0.0, (box[0] - pose[0]) / seconds)), max(0.0, (box[2] - pose[0]) / seconds))
    y = min(max(velocity[1], min(0.0, (box[1] - pose[1]) / seconds)), max(0.0, (box[3] - pose[1]) / seconds))
    return x, y
