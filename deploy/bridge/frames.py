"""Poses in the plane: quaternions, the frame of the odometry, what a command is to the wheels, and what lies beyond a sensor's reach."""

import math
from collections.abc import Sequence
from typing import Any

Placement = tuple[float, float, float]  # x m, y m, heading rad
Planar = tuple[float, float]


def heading_of(quaternion: Any) -> float:
    """The turn about the vertical, rad."""
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def placed(frame: Placement, inner: Placement) -> Placement:
    """A pose that is given in a frame, where the frame itself lies at a pose."""
    (east, north), heading = moved(frame, inner[:2]), frame[2] + inner[2]
    return east, north, math.remainder(heading, 2.0 * math.pi)


def moved(frame: Placement, point: Planar) -> Planar:
    """A point that is given in a frame."""
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    return frame[0] + cos * point[0] - sin * point[1], frame[1] + sin * point[0] + cos * point[1]


def beyond_reach(reach: float, ranges: Sequence[float]) -> tuple[str, bool]:
    """How many detections at these distances lie beyond the reach of their sensor, all in m, in words; and whether most of them do."""
    beyond = sum(distance > reach for distance in ranges)
    words = f"{beyond} of {len(ranges)} lie beyond the reach of the sensor, {reach:g} m"
    return f"{words}, the farthest {max(ranges, default=0.0):.1f} m away", 2 * beyond > len(ranges)


def clipped(velocity: Planar, speed: float) -> Planar:
    """A velocity, shortened to a speed where it is faster."""
    excess = max(1.0, math.hypot(*velocity) / speed) if speed > 0.0 else math.inf
    return velocity[0] / excess, velocity[1] / excess


def fenced(velocity: Planar, pose: Placement, box: tuple[float, float, float, float], seconds: float) -> Planar:
    """A velocity that does not lead out of a box (west, south, east, north) within some seconds; from outside it leads back."""
    x = min(max(velocity[0], min(0.0, (box[0] - pose[0]) / seconds)), max(0.0, (box[2] - pose[0]) / seconds))
    y = min(max(velocity[1], min(0.0, (box[1] - pose[1]) / seconds)), max(0.0, (box[3] - pose[1]) / seconds))
    return x, y


def wheels(velocity: Planar, turn_rate: float, heading: float, offset: float, limit: float) -> tuple[float, float, float]:
    """Forward, leftward m/s and turn rad/s in the robot's own frame, for a velocity in the arena's.

    With an offset of 0 the robot moves in any direction. Otherwise it is a differential drive whose sensor sits `offset` m ahead of the
    axle. Then turning moves the sensor sideways, and the heading obeys no command.
    """
    cos, sin = math.cos(heading), math.sin(heading)
    ahead, left = velocity[0] * cos + velocity[1] * sin, velocity[1] * cos - velocity[0] * sin
    if offset == 0.0:
        return ahead, left, max(-limit, min(limit, turn_rate))
    excess = max(1.0, abs(left / offset) / limit) if limit > 0.0 else math.inf
    return ahead / excess, 0.0, left / offset / excess
