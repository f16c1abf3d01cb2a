"""The contract of a platform, tried on a user's own: it is driven for a moment, so a robot needs a metre of room on every side."""

import math
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from deploy.bridge.frames import beyond_reach
from protocol.message import Vector
from protocol.sensing import Pose
from protocol.settings import BadSetting, sensor_of
from world.config import WorldConfig
from world.platform import Platform, build_platform

SLOW = 0.02  # s that a call may take: others wait for it
SPEED, DRIVEN = 0.2, 1.0  # m/s, s
TURN_RATE = 1.0  # rad/s
SKEW = 0.2  # rad that a heading may seem to turn
STILL = 0.02  # m that a standing robot may seem to move
T = TypeVar("T")


def check_platform(name: str, config: WorldConfig) -> Iterator[tuple[str, bool]]:
    """Every rule of the contract in words, and whether the platform of this body keeps it; raises BadSetting where it cannot go on."""
    platform = build_platform(name, config)
    trial = _Trial(platform, config.run.dt)
    try:
        yield "it can be built, and has read, drive and stop", True
        trial.stop()
        trial.stop()
        yield "stop may be called before anything else, and twice", True
        start = trial.read()
        yield "read returns a pose of finite numbers, and detections (M, 2), None or False", True
        trial.wait(0.5)
        yield f"it stands until it is driven (within {STILL} m)", math.dist(trial.read()[:2], start[:2]) <= STILL
        east, north, _ = trial.drive((SPEED, 0.0), 0.0)
        yield f"driven east at {SPEED} m/s for {DRIVEN:g} s it moves east: {east:.2f} m, {north:+.2f} m north", _obeys(east, north)
        rate = min(TURN_RATE, config.limits.turn_rate)
        *_, turned = trial.drive((0.0, 0.0), rate)  # the next drive begins at another heading: the arena's north is not the robot's
        yield (
            f"told to turn left at {rate:g} rad/s for {DRIVEN:g} s it turns left, or not at all: {turned:+.2f} rad",
            -SKEW <= turned <= 1.5 * rate * DRIVEN + SKEW,
        )
        east, north, _ = trial.drive((0.0, SPEED), 0.0)
        yield f"driven north it moves north: {north:.2f} m, {east:+.2f} m east", _obeys(north, east)
        trial.stop()
        trial.wait(0.5)
        there = trial.read()
        trial.wait(0.5)
        yield f"0.5 s after stop it stands (within {STILL} m)", math.dist(trial.read()[:2], there[:2]) <= STILL
        trial.tick += 8
        trial.read()
        yield "ticks may be left out", True
        if trial.ranges:
            words, too_far = beyond_reach(sensor_of(config, config.members[name]).reach, trial.ranges)
            yield f"detections lie within reach: {words}", not too_far
        yield f"no call takes longer than {1000 * SLOW:.0f} ms: the longest took {1000 * trial.longest:.1f} ms", trial.longest <= SLOW
    finally:
        platform.stop()


def _obeys(along: float, across: float) -> bool:
    """Whether it moved as it was driven: so many m along the velocity and across it."""
    return 0.25 <= along / (SPEED * DRIVEN) <= 1.5 and abs(across) <= 0.5 * SPEED * DRIVEN


class _Trial:
    """A platform that is read once a tick, and the time that its calls take."""

    def __init__(self, platform: Platform, dt: float) -> None:
        self.tick, self.longest = 0, 0.0
        self.ranges: list[float] = []  # m from the robot to each detection
        self._platform, self._dt = platform, dt

    def read(self) -> Pose:
        """The pose of this tick."""
        pose, detections = self._timed(lambda: self._platform.read(self.tick))
        if isinstance(detections, np.ndarray):
            self.ranges += np.hypot(*(detections.astype(float) - pose[:2]).T).tolist()
        return pose

    def stop(self) -> None:
        """Let it stand."""
        self._timed(self._platform.stop)

    def _timed(self, call: Callable[[], T]) -> T:
        begun = time.monotonic()
        answer = call()
        self.longest = max(self.longest, time.monotonic() - begun)
        return answer

    def wait(self, seconds: float) -> None:
        """Read once a tick for some seconds."""
        for _ in range(max(1, round(seconds / self._dt))):
            time.sleep(self._dt)
            self.tick += 1
            self.read()

    def drive(self, velocity: Vector, turn_rate: float) -> tuple[float, float, float]:
        """The way of a drive, m east and m north, and its turn, rad, with a command in every tick as an agent gives it."""
        x, y, heading = self.read()
        for _ in range(max(1, round(DRIVEN / self._dt))):
            self._timed(lambda: self._platform.drive(velocity, turn_rate))
            self.wait(self._dt)
        pose = self.read()
        turns = (pose[2] - heading + wrap for wrap in (-2.0 * math.pi, 0.0, 2.0 * math.pi))  # by one wrap: degrees stay too large
        return pose[0] - x, pose[1] - y, min(turns, key=abs)


def check_and_print(name: str, config: WorldConfig) -> int:
    """Print every rule; 1 when one is broken."""
    broken = 0
    try:
        for rule, kept in check_platform(name, config):
            print(f"{'ok    ' if kept else 'BROKEN'} {rule}", flush=True)
            broken += not kept
    except BadSetting as error:
        print(f"BROKEN {error}")
        return 1
    return 1 if broken else 0
