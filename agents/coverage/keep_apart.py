"""Keeping bodies apart: the velocity nearest to the one that a control law asks for, under which no two bodies touch.

Buffered Voronoi cells (Zhou et al. 2017, eq. 5): between two bodies of radius r at a distance d each may move (d/2 - r) m towards the
other. Both bisectors are the same line, so both stay apart whatever the other does. The rule needs positions alone, of bodies that move
and of wrecks. A velocity v is held for T s at most, hence n . v <= (d/2 - r) / T for the unit vector n towards the other.

T is two times the time between commands: one that comes late by that time does no harm, and a body that approaches loses half of its
speed with each command, which leaves wheels the way to brake.
"""

import math
from collections.abc import Iterable
from itertools import combinations

from agents.coverage.control import ControlInput
from protocol.message import Vector
from protocol.pose import clip_velocity
from protocol.settings import LimitSettings

CLEARANCE = 0.05  # m, kept around each body besides its radius: wheels do not obey to the millimetre
HELD_PERIODS = 2  # times the time between two commands for which a velocity may be held
ROUNDING = 1.0e-9  # m/s

Bound = tuple[float, float, float]  # of velocities: n . v <= most, as n and most in m/s


def keep_apart(command: ControlInput, place: Vector, others: Iterable[Vector], limits: LimitSettings, seconds: float) -> ControlInput:
    """The command with its velocity kept within the bounds of the bodies at `others`, m; `seconds`: until the next command.

    Bodies that are too close already draw apart if there is room; one that has none stands.
    """
    velocity, turn_rate = command
    points = {other for other in others if other != place}
    for pressed in (True, False):
        bounds = [bound(place, other, limits.radius + CLEARANCE, HELD_PERIODS * seconds, pressed=pressed) for other in sorted(points)]
        found = nearest(clip_velocity(velocity, limits.speed), bounds, limits.speed)
        if found is not None:
            return found, turn_rate
    return (0.0, 0.0), turn_rate


def bound(place: Vector, other: Vector, radius: float, seconds: float, *, pressed: bool) -> Bound:
    """The bound for a body of this radius, m, beside one at `other`; `pressed`: a body that is too close has to leave."""
    dx, dy = other[0] - place[0], other[1] - place[1]
    apart = math.sqrt(dx * dx + dy * dy)
    room = 0.5 * apart - radius
    return dx / apart, dy / apart, (room if pressed else max(0.0, room)) / seconds


def nearest(velocity: Vector, bounds: list[Bound], speed: float) -> Vector | None:
    """The velocity nearest to the given one within all bounds and no faster than `speed`, m/s; None when there is none.

    It is the given one, its foot on one bound, a corner of two, or a place where a bound meets the greatest speed.
    """
    tight = [each for each in bounds if each[2] < speed]
    feet = [_foot(velocity, each) for each in tight if _excess(velocity, each) > 0.0]
    corners = [corner for one, other in combinations(tight, 2) if (corner := _corner(one, other)) is not None]
    rims = [rim for each in tight for rim in _rim(each, speed)]
    best, least = None, math.inf
    for x, y in [velocity, *feet, *corners, *rims]:
        away = (x - velocity[0]) ** 2 + (y - velocity[1]) ** 2
        if away < least and math.sqrt(x * x + y * y) <= speed + ROUNDING and all(_excess((x, y), each) <= ROUNDING for each in tight):
            best, least = (x, y), away
    return best


def _excess(velocity: Vector, bound: Bound) -> float:
    """By how much a velocity breaks a bound, m/s."""
    return bound[0] * velocity[0] + bound[1] * velocity[1] - bound[2]


def _foot(velocity: Vector, bound: Bound) -> Vector:
    """The point of a bound's line that is nearest to a velocity."""
    excess = _excess(velocity, bound)
    return velocity[0] - excess * bound[0], velocity[1] - excess * bound[1]


def _corner(one: Bound, other: Bound) -> Vector | None:
    """Where the lines of two bounds cross; None for parallel ones."""
    cross = one[0] * other[1] - one[1] * other[0]
    if abs(cross) < 1.0e-9:
        return None
    return (one[2] * other[1] - other[2] * one[1]) / cross, (other[2] * one[0] - one[2] * other[0]) / cross


def _rim(bound: Bound, speed: float) -> list[Vector]:
    """Where the line of a bound meets the circle of velocities of `speed` m/s."""
    rest = speed * speed - bound[2] * bound[2]
    if rest < 0.0:
        return []
    side = math.sqrt(rest)
    return [(bound[0] * bound[2] - along * bound[1], bound[1] * bound[2] + along * bound[0]) for along in (-side, side)]
