"""Bodies: the pose (x m, y m, heading rad) of every sensor, moved by commands and clipped to the limits.

Plain scalar arithmetic throughout, so that the same commands give the same poses to the last bit.
"""

import math
from collections.abc import Iterable
from itertools import combinations

import numpy as np

from protocol.fields import FARTHEST
from protocol.geometry import wrap_angle
from protocol.message import Vector
from protocol.messages import Command
from protocol.sensing import Pose
from protocol.settings import ArenaSettings, BadSetting, LimitSettings
from protocol.streams import key, stream
from world.config import BodySettings, WorldConfig

ROOM = 0.1  # m around each body at the start
ATTEMPTS = 1000  # at a random start pose


def clip_velocity(velocity: Vector, speed: float) -> Vector:
    """The velocity in m/s, shortened to `speed` m/s where it is faster; the direction stays."""
    x, y = velocity
    fast = math.sqrt(x * x + y * y)
    return (x * (speed / fast), y * (speed / fast)) if fast > speed else (x, y)


def integrate(pose: Pose, velocity: Vector, turn_rate: float, dt: float, limits: LimitSettings) -> Pose:
    """The pose after dt s at a constant velocity m/s in the world frame and turn rate rad/s, both clipped to the limits (1)."""
    x, y = clip_velocity(velocity, limits.speed)
    turn = max(-limits.turn_rate, min(limits.turn_rate, turn_rate))
    east, north = pose[0] + x * dt, pose[1] + y * dt  # no farther than a coordinate may be on the wire
    return max(-FARTHEST, min(FARTHEST, east)), max(-FARTHEST, min(FARTHEST, north)), wrap_angle(pose[2] + turn * dt)


def start_pose(name: str, settings: BodySettings, arena: ArenaSettings, seed: int) -> Pose:
    """Where a body starts: its given pose, or uniform in the arena with a uniform heading, keyed by (seed, name) alone."""
    given = settings.poses.get(name) if settings.start == "given" else None
    if given is not None:
        return given[0], given[1], wrap_angle(given[2])
    x, y, turn = stream(seed, "start", key(name)).random(3).tolist()
    return x * arena.width, y * arena.height, wrap_angle(2.0 * math.pi * turn)


def free_pose(name: str, config: WorldConfig, taken: Iterable[Pose]) -> Pose:
    """The start pose of a body that touches none of those that are there; the first of its random poses with room around it."""
    settings, apart, others = config.bodies, 2.0 * (config.limits.radius + ROOM), list(taken)
    pose = start_pose(name, settings, config.arena, config.run.seed)
    for attempt in range(1, ATTEMPTS):
        if config.limits.radius == 0.0 or all(math.dist(pose[:2], other[:2]) >= apart for other in others):
            return pose
        x, y, turn = stream(config.run.seed, "start", key(name), attempt).random(3).tolist()
        pose = x * config.arena.width, y * config.arena.height, wrap_angle(2.0 * math.pi * turn)
    raise BadSetting(f"limits.radius = {config.limits.radius:g}: the arena has no room for {len(others) + 1} bodies of this size")


def start_poses(config: WorldConfig) -> dict[str, Pose]:
    """Where the bodies of all members start; the first ones choose first."""
    poses: dict[str, Pose] = {}
    for name in config.members:
        poses[name] = free_pose(name, config, poses.values())
    return poses


def pose_with_error(pose: Pose, settings: BodySettings, name: str, tick: int, seed: int) -> Pose:
    """The pose that an agent is told, with the errors of the scenario, keyed by (seed, name, tick); independent from tick to tick."""
    if settings.position_error == 0.0 and settings.heading_error == 0.0:
        return pose
    east, north, turn = stream(seed, "pose", key(name), tick).standard_normal(3).tolist()
    x, y = pose[0] + settings.position_error * east, pose[1] + settings.position_error * north
    return x, y, wrap_angle(pose[2] + settings.heading_error * turn)


def from_other_frame(points: np.ndarray, true: Pose, reported: Pose) -> np.ndarray:
    """Points (N, 2) float32 that a sensor saw from its true pose, where an agent places them that takes `reported` for its pose."""
    offset, turn = points.astype(float) - np.array(true[:2]), reported[2] - true[2]
    cos, sin = math.cos(turn), math.sin(turn)
    return (offset @ np.array([[cos, sin], [-sin, cos]]) + np.array(reported[:2])).astype(np.float32)


def check_given(config: WorldConfig) -> None:
    """Raise BadSetting unless every member has a usable pose where poses are given, or if bodies of their own should err."""
    for field in ("position_error", "heading_error"):
        if config.bodies.host == "own" and getattr(config.bodies, field):
            wrong = getattr(config.bodies, field)
            raise BadSetting(f"bodies.{field} = {wrong:g}: should be 0 with bodies of their own; a world adds such errors")
    if config.bodies.start != "given":
        return
    for name in config.members:
        pose = config.bodies.poses.get(name)
        if pose is None:
            raise BadSetting(f"bodies.poses.{name}: is missing; start = 'given' needs [x, y, heading] for every member")
        if not all(-FARTHEST <= number <= FARTHEST for number in pose):
            raise BadSetting(f"bodies.poses.{name} = {list(pose)}: should be three finite numbers [x m, y m, heading rad]")
    least = 2.0 * (config.limits.radius + ROOM)
    for one, other in combinations(config.members if config.limits.radius else (), 2):
        apart = math.dist(config.bodies.poses[one][:2], config.bodies.poses[other][:2])
        if apart < least:
            raise BadSetting(
                f"bodies.poses.{one}: lies {apart:.2f} m from {other}; should be {least:g} m at least, twice limits.radius + {ROOM:g}"
            )


class Bodies:
    """The poses of all bodies by name, in team order; a body stays where it is until a command moves it."""

    def __init__(self, dt: float, limits: LimitSettings) -> None:
        self._dt, self._limits = dt, limits
        self.poses: dict[str, Pose] = {}

    def place(self, name: str, pose: Pose) -> None:
        """Put a body somewhere; a new one goes to the end of the order."""
        self.poses[name] = pose

    def move(self, commands: dict[str, Command]) -> None:
        """Move every body that has a command by one tick; bodies may leave the arena."""
        for name, command in commands.items():
            self.poses[name] = integrate(self.poses[name], command.velocity, command.turn_rate, self._dt, self._limits)
