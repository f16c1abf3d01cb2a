"""Compiled claims: the bit-for-bit twins of agents/tracking/claims.py.

Data types: several claims are their generators (G, 3) end to end, and the end of each claim in that array (C,).

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np
from numba import njit

from agents.compiled.cache import cached


@njit
def _power_distance(x: float, y: float, generators: np.ndarray, place: int) -> float:
    """Twin of `claims.power_distances` for a point and one generator: |x - p|^2 - r^2 in m^2 (15)."""
    dx, dy = x - generators[place, 0], y - generators[place, 1]
    return dx * dx + dy * dy - generators[place, 2] * generators[place, 2]


@njit
def _mark_owned(
    x: np.ndarray, y: np.ndarray, generators: np.ndarray, wins_ties: np.ndarray, start: int, end: int, own: np.ndarray, held: np.ndarray
) -> None:
    """Write into `held` (N,) True for the points in the cell of generator `start`, bounded by those up to `end`; `own` (N,) is scratch."""
    east, north, squared = generators[start, 0], generators[start, 1], generators[start, 2] * generators[start, 2]
    for n in range(len(x)):
        dx, dy = x[n] - east, y[n] - north
        own[n], held[n] = dx * dx + dy * dy - squared, True
    for g in range(start + 1, end):  # without branches, for several points at once
        east, north, squared, wins = generators[g, 0], generators[g, 1], generators[g, 2] * generators[g, 2], wins_ties[g]
        for n in range(len(x)):
            dx, dy = x[n] - east, y[n] - north
            other = dx * dx + dy * dy - squared
            held[n] &= (own[n] < other) | ((own[n] == other) & (not wins))


@cached
def owned(points: np.ndarray, generators: np.ndarray, wins_ties: np.ndarray, width: float, height: float) -> np.ndarray:
    """Twin of `claims.owned`: True for the points in the arena and in the cell of generator 0, (N,) bool."""
    number, mine = len(points), np.empty(len(points), dtype=np.bool_)
    if len(generators) == 0:
        mine[:] = False
        return mine
    x, y = points[:, 0].copy(), points[:, 1].copy()
    _mark_owned(x, y, generators, wins_ties, 0, len(generators), np.empty(number), mine)
    for n in range(number):
        mine[n] &= (x[n] >= 0.0) & (x[n] <= width) & (y[n] >= 0.0) & (y[n] <= height)
    return mine


@njit
def _starts(ends: np.ndarray) -> np.ndarray:
    """The start of each claim in the array of generators: (C,)."""
    starts = np.zeros_like(ends)
    starts[1:] = ends[:-1]
    return starts


@njit
def _likely(x: np.ndarray, y: np.ndarray, generators: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The generator of least power distance for each point, as an index into `places`: (N,) float32.

    The result is a first guess only. Single precision, for the indices too, doubles the number of points per vector instruction.
    """
    number = len(x)
    east, north = np.empty(number, np.float32), np.empty(number, np.float32)
    nearest, least = np.zeros(number, np.float32), np.full(number, np.float32(np.inf))
    for n in range(number):
        east[n], north[n] = np.float32(x[n]), np.float32(y[n])
    for k in range(len(places)):
        generator = generators[places[k]]
        there_x, there_y, squared = np.float32(generator[0]), np.float32(generator[1]), np.float32(generator[2] * generator[2])
        index = np.float32(k)
        for n in range(number):
            dx, dy = east[n] - there_x, north[n] - there_y
            apart = dx * dx + dy * dy - squared
            nearest[n] = index if apart < least[n] else nearest[n]
            least[n] = min(least[n], apart)
    return nearest


@cached
def orphaned(
    points: np.ndarray, generators: np.ndarray, wins_ties: np.ndarray, ends: np.ndarray, width: float, height: float
) -> np.ndarray:
    """Twin of `claims.orphaned`: True for the points in none of the claimed cells, (N,) bool.

    Each point is tested against the claim of its likely nearest owner first. The points left over are tested against all claims.
    """
    free, starts = np.ones(len(points), dtype=np.bool_), _starts(ends)
    owners = np.nonzero(starts < ends)[0]
    rows = np.nonzero((points[:, 0] >= 0.0) & (points[:, 0] <= width) & (points[:, 1] >= 0.0) & (points[:, 1] <= height))[0]
    if len(owners) == 0 or len(rows) == 0:
        return free
    likely, begins = _likely(points[rows, 0], points[rows, 1], generators, starts[owners]), np.zeros(len(owners) + 1, np.int64)
    for n in range(len(rows)):
        begins[int(likely[n]) + 1] += 1
    begins = np.cumsum(begins)
    order, filled = np.empty(len(rows), np.int64), begins[:-1].copy()
    for n in range(len(rows)):  # the points of each owner side by side
        k = int(likely[n])
        order[filled[k]] = rows[n]
        filled[k] += 1
    x, y, own, held = points[order, 0], points[order, 1], np.empty(len(rows)), np.empty(len(rows), np.bool_)
    for k in range(len(owners)):
        part, owner = slice(begins[k], begins[k + 1]), owners[k]
        _mark_owned(x[part], y[part], generators, wins_ties, starts[owner], ends[owner], own[part], held[part])
    free[order[held]] = False
    left = order[~held]
    x, y, taken = points[left, 0], points[left, 1], np.zeros(len(left), np.bool_)
    for owner in owners:
        _mark_owned(x, y, generators, wins_ties, starts[owner], ends[owner], own[: len(left)], held[: len(left)])
        taken |= held[: len(left)]
    free[left] = ~taken
    return free


@njit
def _depth(x: float, y: float, generators: np.ndarray, start: int, end: int) -> float:
    """Twin of `claims.depths` for one point, m; the claim lies from `start` to `end`."""
    own, least = _power_distance(x, y, generators, start), np.inf
    for g in range(start + 1, end):
        dx, dy = generators[g, 0] - generators[start, 0], generators[g, 1] - generators[start, 1]
        span = math.sqrt(dx * dx + dy * dy)
        least = min(least, (_power_distance(x, y, generators, g) - own) / (2.0 * max(span, 1e-9)))
    return least


@cached
def resolve_conflicts(
    points: np.ndarray, sizes: np.ndarray, generators: np.ndarray, ends: np.ndarray, hashes: np.ndarray, overlap: float
) -> np.ndarray:
    """Twin of `claims.resolve_conflicts`: True for the stated points that count, (N,) bool."""
    number, keep, starts, begin = len(points), np.ones(len(points), dtype=np.bool_), _starts(ends), 0
    x, y, own, point_hashes = points[:, 0].copy(), points[:, 1].copy(), np.empty(number), np.empty(number, hashes.dtype)
    for c in range(len(sizes)):
        for n in range(begin, begin + sizes[c]):
            own[n], point_hashes[n] = _power_distance(x[n], y[n], generators, starts[c]), hashes[c]
        begin += sizes[c]
    outdone = np.zeros(number, np.bool_)
    for owner in np.nonzero(starts < ends)[0]:  # rarely is another owner nearer; without branches, for several points at once
        east, north, radius = generators[starts[owner]]
        squared, hashed = radius * radius, hashes[owner]
        for n in range(number):
            dx, dy = x[n] - east, y[n] - north
            outdone[n] |= (dx * dx + dy * dy - squared < own[n]) & (point_hashes[n] != hashed)
    for row in np.nonzero(outdone)[0]:
        for rival in range(len(ends)):
            start, end = starts[rival], ends[rival]
            if hashes[rival] == point_hashes[row] or start == end or not _power_distance(x[row], y[row], generators, start) < own[row]:
                continue
            if _depth(x[row], y[row], generators, start, end) > overlap:
                keep[row] = False
                break
    return keep
