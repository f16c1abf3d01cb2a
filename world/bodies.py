"""Bodies: the pose (x m, y m, heading rad) of every sensor, moved by commands and clipped to the limits.

Plain scalar arithmetic throughout, so that the same commands give the same poses to the last bit.
"""

import math
from collections.abc import Iterable
from itertools import combinations

import numpy as np

from protocol.fields import LARGEST_NUMBER
from protocol.geometry import wrap_angle
from protocol.messages import Command
from protocol.pose import integrate
from protocol.random_streams import random_key, stream
from protocol.sensing import Pose
from protocol.settings import ArenaSettings, BadSetting, LimitSettings
from world.config import BodySettings, WorldConfig

CLEARANCE = 0.1  # m around each body at the start
ATTEMPTS = 1000  # at a random start pose
ERRORS = "position_error", "heading_error", "time_error"  # of [bodies]


def start_pose(name: str, settings: BodySettings, arena: ArenaSettings, seed: int) -> Pose:
    """Where a body starts: its given pose, or uniform in the arena with a uniform heading, keyed by (seed, name) alone."""
    given = settings.poses.get(name) if settings.start == "given" else None
    if given is not None:
        return given[0], given[1], wrap_angle(given[2])
    return _random_pose(arena, stream(seed, "start", random_key(name)))


def _random_pose(arena: ArenaSettings, numbers: np.random.Generator) -> Pose:
    """Uniform in the arena with a uniform heading."""
    x, y, turn = numbers.random(3).tolist()
    return x * arena.width, y * arena.height, wrap_angle(2.0 * math.pi * turn)


def free_pose(name: str, config: WorldConfig, taken: Iterable[Pose]) -> Pose:
    """The start pose of a body that touches none of those that are there; the first of its random poses with room around it."""
    apart, others = 2.0 * (config.limits.radius + CLEARANCE), list(taken)
    for attempt in range(ATTEMPTS):
        if attempt:
            pose = _random_pose(config.arena, stream(config.run.seed, "start", random_key(name), attempt))
        else:
            pose = start_pose(name, config.bodies, config.arena, config.run.seed)
        if config.limits.radius == 0.0 or all(math.dist(pose[:2], other[:2]) >= apart for other in others):
            return pose
    raise BadSetting(f"limits.radius = {config.limits.radius:g}: the arena has no room for {len(others) + 1} bodies of this size")


def start_poses(config: WorldConfig) -> dict[str, Pose]:
    """Where the bodies of all members start; the first ones choose first."""
    poses: dict[str, Pose] = {}
    for name in config.members:
        poses[name] = free_pose(name, config, poses.values())
    return poses


def pose_with_error(pose: Pose, before: Pose, config: WorldConfig, name: str, tick: int) -> Pose:
    """The pose that an agent is told, with the errors of the scenario, keyed by (seed, name, tick); independent from tick to tick.

    `before`: the pose one tick earlier. An error in time moves the pose along the motion since then, ahead or back.
    """
    settings = config.bodies
    if not any(getattr(settings, field) for field in ERRORS):
        return pose
    east, north, turn, ahead = stream(config.run.seed, "pose", random_key(name), tick).standard_normal(4).tolist()
    ticks = ahead * settings.time_error / config.run.dt
    x = pose[0] + settings.position_error * east + ticks * (pose[0] - before[0])
    y = pose[1] + settings.position_error * north + ticks * (pose[1] - before[1])
    return x, y, wrap_angle(pose[2] + settings.heading_error * turn + ticks * wrap_angle(pose[2] - before[2]))


def check_given(config: WorldConfig) -> None:
    """Raise BadSetting unless every member has a usable pose where poses are given. Bodies of their own neither err nor are recorded."""
    if config.bodies.host == "own" and config.recorded.kind == "mrclam":
        raise BadSetting("bodies.host = 'own': should be 'world' with recorded.kind = 'mrclam', whose bodies were recorded as well")
    for field in ERRORS:
        if config.bodies.host == "own" and getattr(config.bodies, field):
            wrong = getattr(config.bodies, field)
            raise BadSetting(f"bodies.{field} = {wrong:g}: should be 0 with bodies of their own; a world adds such errors")
    if config.bodies.start != "given":
        return
    for name in config.members:
        pose = config.bodies.poses.get(name)
        if pose is None:
            raise BadSetting(f"bodies.poses.{name}: is missing; start = 'given' needs [x, y, heading] for every member")
        if not all(-LARGEST_NUMBER <= number <= LARGEST_NUMBER for number in pose):
            raise BadSetting(f"bodies.poses.{name} = {list(pose)}: should be [x m, y m, heading rad], each of at most {LARGEST_NUMBER:g}")
    least = 2.0 * (config.limits.radius + CLEARANCE)
    for one, other in combinations(config.members if config.limits.radius else (), 2):
        apart = math.dist(config.bodies.poses[one][:2], config.bodies.poses[other][:2])
        if apart < least - 1e-9:  # 11.2 - 10.0 is less than 1.2
            raise BadSetting(
                f"bodies.poses.{one}: lies {apart:.2f} m from {other}; should be {least:g} m at least, twice limits.radius + {CLEARANCE:g}"
            )


def pose_warnings(config: WorldConfig) -> list[str]:
    """A line for each given pose that is not read, or lies outside of the arena."""
    if config.bodies.start != "given":
        return ["bodies.poses is not read: bodies.start should be 'given'"] if config.bodies.poses else []
    remarks = []
    for name, (x, y, _) in config.bodies.poses.items():
        if name not in config.members:
            remarks.append(f"bodies.poses.{name}: there is no such agent")
        if not config.arena.holds(x, y):
            remarks.append(f"bodies.poses.{name}: lies outside of the arena of {config.arena.width:g} x {config.arena.height:g} m")
    return remarks


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
