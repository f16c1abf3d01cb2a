"""Bodies: the pose (x m, y m, heading rad) of every sensor, moved by commands and clipped to the limits.

Plain scalar arithmetic throughout, so that the same commands give the same poses to the last bit.
"""

import math

from protocol.fields import FARTHEST
from protocol.geometry import wrap_angle
from protocol.messages import Command, Vector
from protocol.sensing import Pose
from protocol.settings import ArenaSettings, BadSetting, LimitSettings
from protocol.streams import key, stream
from world.config import BodySettings, WorldConfig


def clip_velocity(velocity: Vector, speed: float) -> Vector:
    """The velocity in m/s, shortened to `speed` m/s where it is faster; the direction stays."""
    x, y = velocity
    fast = math.sqrt(x * x + y * y)
    return (x * (speed / fast), y * (speed / fast)) if fast > speed else (x, y)


def integrate(pose: Pose, velocity: Vector, turn_rate: float, dt: float, limits: LimitSettings) -> Pose:
    """The pose after dt s at a constant velocity m/s in the world frame and turn rate rad/s, both clipped to the limits (1)."""
    x, y = clip_velocity(velocity, limits.speed)
    turn = max(-limits.turn_rate, min(limits.turn_rate, turn_rate))
    return pose[0] + x * dt, pose[1] + y * dt, wrap_angle(pose[2] + turn * dt)


def start_pose(name: str, settings: BodySettings, arena: ArenaSettings, seed: int) -> Pose:
    """Where a body starts: its given pose, or uniform in the arena with a uniform heading, keyed by (seed, name) alone."""
    given = settings.poses.get(name) if settings.start == "given" else None
    if given is not None:
        return given[0], given[1], wrap_angle(given[2])
    x, y, turn = stream(seed, "start", key(name)).random(3).tolist()
    return x * arena.width, y * arena.height, wrap_angle(2.0 * math.pi * turn)


def check_given(config: WorldConfig) -> None:
    """Raise BadSetting unless every member has a usable pose where the scenario says that poses are given."""
    if config.bodies.start != "given":
        return
    for name in config.members:
        pose = config.bodies.poses.get(name)
        if pose is None:
            raise BadSetting(f"bodies.poses.{name}: is missing; start = 'given' needs [x, y, heading] for every member")
        if not all(-FARTHEST <= number <= FARTHEST for number in pose):
            raise BadSetting(f"bodies.poses.{name} = {list(pose)}: should be three finite numbers [x m, y m, heading rad]")


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
        for name, command in commands.items():  # no farther than a coordinate may be on the wire
            pose = integrate(self.poses[name], command.velocity, command.turn_rate, self._dt, self._limits)
            self.poses[name] = max(-FARTHEST, min(FARTHEST, pose[0])), max(-FARTHEST, min(FARTHEST, pose[1])), pose[2]
