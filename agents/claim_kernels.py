"""Compiled claims: the loops of `claims` for numba, each the bit-for-bit twin of a numpy function.

Same rules as `kernels`: no fast-math, the reference's order and rounding of every operation, compiled code cached on disk. Several claims
are given as their generators (G, 3) end to end, and where each of them ends.
"""

import math

import numpy as np
from numba import njit


@njit
def _power_distance(x: float, y: float, generators: np.ndarray, place: int) -> float:
    """|x - p|^2 - r^2 of a point to one generator, m^2."""
    dx, dy = x - generators[place, 0], y - generators[place, 1]
    return dx * dx + dy * dy - generators[place, 2] * generators[place, 2]


@njit
def _holds(x: float, y: float, generators: np.ndarray, first: np.ndarray, start: int, end: int) -> bool:
    """Whether a point lies in the cell of the generator `start`, which those up to `end` bound."""
    if start == end:
        return False
    own = _power_distance(x, y, generators, start)
    for g in range(start + 1, end):
        other = _power_distance(x, y, generators, g)
        if not (own < other if first[g] else own <= other):
            return False
    return True


@njit(cache=True)
def owned(points: np.ndarray, generators: np.ndarray, first: np.ndarray, width: float, height: float) -> np.ndarray:
    """Twin of `claims.owned`: which points lie in the arena and in the cell of generator 0."""
    number, mine = len(points), np.empty(len(points), dtype=np.bool_)
    if len(generators) == 0:
        mine[:] = False
        return mine
    x, y, own = np.empty(number), np.empty(number), np.empty(number)
    for n in range(number):
        x[n], y[n] = points[n, 0], points[n, 1]
    east, north, squared = generators[0, 0], generators[0, 1], generators[0, 2] * generators[0, 2]
    for n in range(number):
        dx, dy = x[n] - east, y[n] - north
        own[n] = dx * dx + dy * dy - squared
        mine[n] = (x[n] >= 0.0) & (x[n] <= width) & (y[n] >= 0.0) & (y[n] <= height)
    for g in range(1, len(generators)):  # one rival after the other and without branches, for several points at once
        east, north, squared, wins = generators[g, 0], generators[g, 1], generators[g, 2] * generators[g, 2], first[g]
        for n in range(number):
            dx, dy = x[n] - east, y[n] - north
            other = dx * dx + dy * dy - squared
            mine[n] &= (own[n] < other) | ((own[n] == other) & (not wins))
    return mine


@njit
def _starts(ends: np.ndarray) -> np.ndarray:
    """Where each claim starts, (C,)."""
    starts = np.zeros_like(ends)
    starts[1:] = ends[:-1]
    return starts


@njit(cache=True)
def unclaimed(points: np.ndarray, generators: np.ndarray, first: np.ndarray, ends: np.ndarray, width: float, height: float) -> np.ndarray:
    """Twin of `claims.unclaimed`. It asks the nearest owner first, in power distance: as a rule the point is in his cell."""
    free, starts = np.ones(len(points), dtype=np.bool_), _starts(ends)
    owners = np.nonzero(starts < ends)[0]
    east, north, squared = np.empty(len(owners)), np.empty(len(owners)), np.empty(len(owners))
    for k in range(len(owners)):
        east[k], north[k], radius = generators[starts[owners[k]]]
        squared[k] = radius * radius
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        if len(owners) == 0 or not (0.0 <= x <= width and 0.0 <= y <= height):
            continue
        nearest, least = 0, np.inf
        for k in range(len(owners)):
            dx, dy = x - east[k], y - north[k]
            apart = dx * dx + dy * dy - squared[k]
            if apart < least:
                nearest, least = k, apart
        likely = owners[nearest]
        if _holds(x, y, generators, first, starts[likely], ends[likely]):
            free[n] = False
            continue
        for c in owners:
            if _holds(x, y, generators, first, starts[c], ends[c]):
                free[n] = False
                break
    return free


@njit
def _depth(x: float, y: float, generators: np.ndarray, start: int, end: int) -> float:
    """Twin of `claims.depths` for one point and the claim from `start` to `end`."""
    own, least = _power_distance(x, y, generators, start), np.inf
    for g in range(start + 1, end):
        dx, dy = generators[g, 0] - generators[start, 0], generators[g, 1] - generators[start, 1]
        span = math.sqrt(dx * dx + dy * dy)
        least = min(least, (_power_distance(x, y, generators, g) - own) / (2.0 * max(span, 1e-9)))
    return least


@njit(cache=True)
def undisputed(
    points: np.ndarray, sizes: np.ndarray, generators: np.ndarray, ends: np.ndarray, views: np.ndarray, overlap: float
) -> np.ndarray:
    """Twin of `claims.undisputed`."""
    keep, starts, n = np.ones(len(points), dtype=np.bool_), _starts(ends), 0
    for c in range(len(sizes)):
        for _ in range(sizes[c]):
            x, y = points[n, 0], points[n, 1]
            own = _power_distance(x, y, generators, starts[c])
            for rival in range(len(ends)):
                start, end = starts[rival], ends[rival]
                if views[rival] == views[c] or start == end or not _power_distance(x, y, generators, start) < own:
                    continue
                if _depth(x, y, generators, start, end) > overlap:
                    keep[n] = False
                    break
            n += 1
    return keep
