"""Poses of bodies in the plane: how a command moves one, and where points lie that were seen from one.

Data types: a `Pose` is x m, y m and heading rad. Plain scalar arithmetic moves it, so that the same commands give the same poses to the
last bit.
"""

import math

import numpy as np

from protocol.fields import LARGEST_NUMBER
from protocol.geometry import wrap_angle
from protocol.message import Vector
from protocol.sensing import Pose
from protocol.settings import LimitSettings


def clip_velocity(velocity: Vector, speed: float) -> Vector:
    """The velocity in m/s, shortened to `speed` m/s where it is faster; the direction stays."""
    x, y = velocity
    fast = math.sqrt(x * x + y * y)
    return (x * speed / fast, y * speed / fast) if fast > speed else (x, y)


def clip(number: float, most: float) -> float:
    """The number, or the nearest one from -`most` to `most`."""
    return max(-most, min(most, number))


def clip_motion(velocity: Vector, turn_rate: float, limits: LimitSettings) -> tuple[Vector, float]:
    """Velocity in m/s and turn rate in rad/s within the limits; the direction of the velocity stays."""
    return clip_velocity(velocity, limits.speed), clip(turn_rate, limits.turn_rate)


def integrate(pose: Pose, velocity: Vector, turn_rate: float, dt: float, limits: LimitSettings) -> Pose:
    """The pose after dt s at a constant velocity m/s in the world frame and turn rate rad/s, both clipped to the limits (1)."""
    (x, y), turn = clip_motion(velocity, turn_rate, limits)
    east, north = pose[0] + x * dt, pose[1] + y * dt  # no farther than a coordinate may be on the wire
    return clip(east, LARGEST_NUMBER), clip(north, LARGEST_NUMBER), wrap_angle(pose[2] + turn * dt)


def from_other_frame(points: np.ndarray, true: Pose, reported: Pose) -> np.ndarray:
    """Points (N, 2) that a sensor saw from its true pose, where an agent places them that takes `reported` for its pose."""
    (x, y), turn = (points.astype(float) - np.array(true[:2])).T, reported[2] - true[2]
    cos, sin = math.cos(turn), math.sin(turn)
    return np.column_stack([x * cos - y * sin + reported[0], x * sin + y * cos + reported[1]])
