"""Compiled geometry: the loops of `cells` and `protocol.geometry` for numba, each the bit-for-bit twin of a numpy function.

Same rules as `kernels`: no fast-math, the reference's order and rounding of every operation, compiled code cached on disk.
"""

import math

import numpy as np
from numba import njit


@njit
def distance(polygon: np.ndarray, px: float, py: float) -> float:
    """Twin of `geometry.distances` for one point; infinite for the empty polygon."""
    corners = len(polygon)
    nearest, inside = np.inf, corners >= 3
    for c in range(corners):
        following = c + 1 if c + 1 < corners else 0
        sx, sy = polygon[c, 0], polygon[c, 1]
        ex, ey = polygon[following, 0] - sx, polygon[following, 1] - sy
        length2 = ex * ex + ey * ey
        dx, dy = px - sx, py - sy
        if ex * dy - ey * dx < 0.0:
            inside = False
        along = min(max((dx * ex + dy * ey) / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
        dx, dy = dx - along * ex, dy - along * ey
        nearest = min(nearest, dx * dx + dy * dy)
    return 0.0 if inside else math.sqrt(nearest)


@njit(cache=True)
def distances(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Twin of `geometry.distances`; points may have more than two columns."""
    found = np.empty(len(points))
    for n in range(len(points)):
        found[n] = distance(polygon, points[n, 0], points[n, 1])
    return found


@njit(cache=True)
def owned(points: np.ndarray, generators: np.ndarray, first: np.ndarray, width: float, height: float) -> np.ndarray:
    """Twin of `cells.owned` and the arena test: which points lie in the arena and in the cell of generator 0."""
    mine = np.empty(len(points), dtype=np.bool_)
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        inside = len(generators) > 0 and 0.0 <= x <= width and 0.0 <= y <= height
        if inside:
            dx, dy = x - generators[0, 0], y - generators[0, 1]
            own = dx * dx + dy * dy - generators[0, 2] * generators[0, 2]
            for g in range(1, len(generators)):
                dx, dy = x - generators[g, 0], y - generators[g, 1]
                other = dx * dx + dy * dy - generators[g, 2] * generators[g, 2]
                if not (own < other if first[g] else own <= other):
                    inside = False
                    break
        mine[n] = inside
    return mine


@njit(cache=True)
def cut(index: int, points: np.ndarray, radii: np.ndarray, arena: np.ndarray, touch: float) -> tuple[np.ndarray, np.ndarray]:
    """Twin of `cells.cut`: corners (V, 2) relative to the generator, and indices of the bounding generators."""
    number = len(radii)
    ox, oy = points[index, 0], points[index, 1]
    ahead = np.empty(number)
    for j in range(number):
        dx, dy = points[j, 0] - ox, points[j, 1] - oy
        squared = dx * dx + dy * dy
        if j == index:
            ahead[j] = np.inf
        elif squared == 0.0:
            wins = radii[j] < radii[index] or (radii[j] == radii[index] and j > index)
            ahead[j] = np.inf if wins else -np.inf
        else:
            ahead[j] = (squared + radii[index] * radii[index] - radii[j] * radii[j]) / (2.0 * math.sqrt(squared))
    order, picked = np.empty(number, np.int64), np.empty(number, np.int64)
    corners, other = np.empty((len(arena) + number + 2, 2)), np.empty((len(arena) + number + 2, 2))
    heights = np.empty(len(corners))
    size = len(arena)
    farthest = 0.0
    for c in range(size):
        corners[c, 0], corners[c, 1] = arena[c, 0] - ox, arena[c, 1] - oy
        farthest = max(farthest, corners[c, 0] * corners[c, 0] + corners[c, 1] * corners[c, 1])
    farthest = math.sqrt(farthest)
    tried = 0
    beyond, within = -np.inf, farthest / math.sqrt(number)
    reached = True
    while reached:  # band after band, so that only the generators that can cut are sorted
        count = 0
        for j in range(number):
            if ahead[j] <= within and (ahead[j] > beyond or beyond == -np.inf):
                picked[count] = j
                count += 1
        for rank in np.argsort(ahead[picked[:count]], kind="mergesort"):
            j = picked[rank]
            limit = ahead[j]
            if limit > farthest + touch:
                break
            order[tried] = j
            tried += 1
            nx, ny = _direction(points, index, j)
            highest = -np.inf
            for c in range(size):
                heights[c] = corners[c, 0] * nx + corners[c, 1] * ny - limit
                highest = max(highest, heights[c])
            if highest <= 0.0:
                continue
            kept = 0
            for c in range(size):
                p = c - 1 if c > 0 else size - 1
                before, after = heights[p], heights[c]
                if (before < 0.0 and after > 0.0) or (after < 0.0 and before > 0.0):
                    share = before / (before - after)
                    other[kept, 0] = corners[p, 0] + share * (corners[c, 0] - corners[p, 0])
                    other[kept, 1] = corners[p, 1] + share * (corners[c, 1] - corners[p, 1])
                    kept += 1
                if after <= 0.0:
                    other[kept, 0], other[kept, 1] = corners[c, 0], corners[c, 1]
                    kept += 1
            corners, other, size = other, corners, kept
            if size < 3:
                return np.empty((0, 2)), np.empty(0, np.int64)
            farthest = 0.0
            for c in range(size):
                farthest = max(farthest, corners[c, 0] * corners[c, 0] + corners[c, 1] * corners[c, 1])
            farthest = math.sqrt(farthest)
        reached = within <= farthest + touch
        beyond, within = within, 2.0 * within
    area = 0.0
    for c in range(size):
        p = c - 1 if c > 0 else size - 1
        area += corners[p, 0] * corners[c, 1] - corners[c, 0] * corners[p, 1]
    if 0.5 * area <= 1.0e-12:
        return np.empty((0, 2)), np.empty(0, np.int64)
    bounds = np.empty(tried + 1, np.int64)
    bounds[0] = index
    bounding = 1
    for rank in range(tried):
        j = order[rank]
        nx, ny = _direction(points, index, j)
        for c in range(size):
            if corners[c, 0] * nx + corners[c, 1] * ny > ahead[j] - touch:
                bounds[bounding] = j
                bounding += 1
                break
    return corners[:size].copy(), bounds[:bounding]


@njit
def _direction(points: np.ndarray, index: int, j: int) -> tuple[float, float]:
    dx, dy = points[j, 0] - points[index, 0], points[j, 1] - points[index, 1]
    span = math.sqrt(dx * dx + dy * dy)
    if span == 0.0:
        return 1.0, 0.0
    return dx / span, dy / span
