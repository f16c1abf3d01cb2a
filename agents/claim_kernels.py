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
    number, free, starts = len(points), np.ones(len(points), dtype=np.bool_), _starts(ends)
    owners = np.nonzero(starts < ends)[0]
    if len(owners) == 0:
        return free
    x, y = points[:, 0].copy(), points[:, 1].copy()
    nearest, least = np.zeros(number), np.full(number, np.inf)  # indices as floats, which are chosen several at once
    for k in range(len(owners)):
        east, north, radius = generators[starts[owners[k]]]
        squared = radius * radius
        for n in range(number):
            dx, dy = x[n] - east, y[n] - north
            apart = dx * dx + dy * dy - squared
            nearest[n] = float(k) if apart < least[n] else nearest[n]
            least[n] = min(least[n], apart)
    for n in range(number):
        if not (0.0 <= x[n] <= width and 0.0 <= y[n] <= height):
            continue
        likely = owners[int(nearest[n])]
        if _holds(x[n], y[n], generators, first, starts[likely], ends[likely]):
            free[n] = False
            continue
        for c in owners:
            if _holds(x[n], y[n], generators, first, starts[c], ends[c]):
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
    number, keep, starts, begin = len(points), np.ones(len(points), dtype=np.bool_), _starts(ends), 0
    x, y, own, seen = points[:, 0].copy(), points[:, 1].copy(), np.empty(number), np.empty(number, views.dtype)
    for c in range(len(sizes)):
        for n in range(begin, begin + sizes[c]):
            own[n], seen[n] = _power_distance(x[n], y[n], generators, starts[c]), views[c]
        begin += sizes[c]
    outdone = np.zeros(number, np.bool_)
    for owner in np.nonzero(starts < ends)[0]:  # as a rule nobody is nearer; without branches, for several points at once
        east, north, radius = generators[starts[owner]]
        squared, view = radius * radius, views[owner]
        for n in range(number):
            dx, dy = x[n] - east, y[n] - north
            outdone[n] |= (dx * dx + dy * dy - squared < own[n]) & (seen[n] != view)
    for row in np.nonzero(outdone)[0]:
        for rival in range(len(ends)):
            start, end = starts[rival], ends[rival]
            if views[rival] == seen[row] or start == end or not _power_distance(x[row], y[row], generators, start) < own[row]:
                continue
            if _depth(x[row], y[row], generators, start, end) > overlap:
                keep[row] = False
                break
    return keep
