"""Compiled geometry: the bit-for-bit twins of agents/coverage/cells.py and of the distances of protocol/geometry.py.

Data types: a polygon is its corners (V, 2) in m, counter-clockwise; generators are points (N, 2) in m and radii (N,) in m.

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np
from numba import njit

from agents.compiled.cache import cached
from agents.coverage.cells import TOUCH_TOLERANCE


@njit
def around(polygon: np.ndarray, width: float) -> tuple[float, float, float, float]:
    """West, south, east and north, m, of the box around a polygon, widened by `width` m; empty for the empty polygon."""
    west = south = np.inf
    east = north = -np.inf
    for c in range(len(polygon)):
        west, east = min(west, polygon[c, 0] - width), max(east, polygon[c, 0] + width)
        south, north = min(south, polygon[c, 1] - width), max(north, polygon[c, 1] + width)
    return west, south, east, north


@njit
def distance(polygon: np.ndarray, px: float, py: float) -> float:
    """Twin of `protocol.geometry.distances` for one point: distance to a polygon in m, infinite for the empty polygon."""
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


@njit
def apart(polygon: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared distance in m^2 of each point to the nearest edge, (N,), and True for the points in the polygon, (N,) bool.

    The loops run edge by edge and without branches, for several points at once.
    """
    number, corners = len(x), len(polygon)
    nearest, side, inside = np.full(number, np.inf), np.zeros(number), np.empty(number, np.bool_)
    for c in range(corners):
        following = c + 1 if c + 1 < corners else 0
        sx, sy = polygon[c, 0], polygon[c, 1]
        ex, ey = polygon[following, 0] - sx, polygon[following, 1] - sy
        length2 = ex * ex + ey * ey
        if length2 > 0.0:
            for n in range(number):
                dx, dy = x[n] - sx, y[n] - sy
                side[n] = min(side[n], ex * dy - ey * dx)
                along = min(max((dx * ex + dy * ey) / length2, 0.0), 1.0)
                dx, dy = dx - along * ex, dy - along * ey
                nearest[n] = min(nearest[n], dx * dx + dy * dy)
        else:
            for n in range(number):
                dx, dy = x[n] - sx, y[n] - sy
                nearest[n] = min(nearest[n], dx * dx + dy * dy)
    for n in range(number):
        inside[n] = (side[n] >= 0.0) & (corners >= 3)
    return nearest, inside


@njit
def near(polygon: np.ndarray, x: np.ndarray, y: np.ndarray, width: float) -> np.ndarray:
    """True for the points whose `distance` is at most `width` m: (N,) bool."""
    nearest, inside = apart(polygon, x, y)
    for n in range(len(x)):
        inside[n] = (inside[n] & (width >= 0.0)) | (math.sqrt(nearest[n]) <= width)
    return inside


@njit
def _scratch(number: int, corners: int) -> tuple:
    """Scratch arrays of `_cut` for `number` generators and an arena of `corners` corners."""
    size = corners + number + 2
    places = np.empty(number), np.empty(number, np.int64), np.empty(number, np.int64)
    return *places, np.empty((size, 2)), np.empty((size, 2)), np.empty(size)


@njit
def _sort(places: np.ndarray, count: int, keys: np.ndarray) -> None:
    """Sort the first `count` places by their keys, stable; by insertion up to 64."""
    if count > 64:
        places[:count] = sorted_by(keys, places[:count])
    else:
        insert(places, count, keys)


@njit
def sorted_by(keys: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The places (N,), sorted by their keys, stable."""
    return places[np.argsort(keys[places], kind="mergesort")]


@njit
def insert(places: np.ndarray, count: int, keys: np.ndarray) -> None:
    """Sort the first `count` places by their keys, stable, by insertion."""
    for rank in range(1, count):
        place, here = places[rank], rank
        while here > 0 and keys[places[here - 1]] > keys[place]:
            places[here] = places[here - 1]
            here -= 1
        places[here] = place


@njit
def _clip(corners: np.ndarray, size: int, heights: np.ndarray, other: np.ndarray) -> int:
    """The number of corners of the part of a polygon with heights <= 0; its corners are written into `other`."""
    corner = 0
    for c in range(size):
        p = c - 1 if c > 0 else size - 1
        before, after = heights[p], heights[c]
        if (before < 0.0 and after > 0.0) or (after < 0.0 and before > 0.0):
            share = before / (before - after)
            other[corner, 0] = corners[p, 0] + share * (corners[c, 0] - corners[p, 0])
            other[corner, 1] = corners[p, 1] + share * (corners[c, 1] - corners[p, 1])
            corner += 1
        if after <= 0.0:
            other[corner, 0], other[corner, 1] = corners[c, 0], corners[c, 1]
            corner += 1
    return corner


@njit
def _farthest(corners: np.ndarray, size: int) -> float:
    """Twin of `cells._farthest` for the first `size` corners."""
    farthest = 0.0
    for c in range(size):
        farthest = max(farthest, corners[c, 0] * corners[c, 0] + corners[c, 1] * corners[c, 1])
    return math.sqrt(farthest)


@njit
def _bisectors(index: int, points: np.ndarray, radii: np.ndarray, ahead: np.ndarray) -> float:
    """The distance in m of the farthest finite bisector ahead of a generator; those of all bisectors are written into `ahead` (N,)."""
    ox, oy, own, farthest = points[index, 0], points[index, 1], radii[index] * radii[index], 0.0
    for j in range(len(radii)):
        dx, dy = points[j, 0] - ox, points[j, 1] - oy
        squared = dx * dx + dy * dy
        if squared == 0.0:
            wins = radii[j] < radii[index] or (radii[j] == radii[index] and j > index)
            ahead[j] = np.inf if wins else -np.inf
        else:
            ahead[j] = (squared + own - radii[j] * radii[j]) / (2.0 * math.sqrt(squared))
            farthest = max(farthest, ahead[j])
    ahead[index] = np.inf
    return farthest


@njit
def _cut(index: int, points: np.ndarray, radii: np.ndarray, arena: np.ndarray, scratch: tuple) -> tuple[np.ndarray, int, int]:
    """Twin of `cells.cut`: the corners relative to the generator, m, their number, and the number of bounding generators.

    The corners lie in scratch. The bounding generators are the first entries of `picked`, the third array of the scratch.
    """
    ahead, order, picked, corners, other, heights = scratch
    number, size = len(radii), len(arena)
    spread = _bisectors(index, points, radii, ahead)
    for c in range(size):
        corners[c, 0], corners[c, 1] = arena[c, 0] - points[index, 0], arena[c, 1] - points[index, 1]
    farthest = _farthest(corners, size)
    tried = 0
    beyond, within = -np.inf, (spread if spread > 0.0 else farthest) / math.sqrt(number)
    reached = True
    while reached:  # band after band, so that only the generators that can cut are sorted
        count = 0
        for j in range(number):
            if ahead[j] <= within and (ahead[j] > beyond or beyond == -np.inf):
                picked[count] = j
                count += 1
        _sort(picked, count, ahead)
        for rank in range(count):
            j = picked[rank]
            limit = ahead[j]
            if limit > farthest + TOUCH_TOLERANCE:
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
            size = _clip(corners, size, heights, other)
            corners, other = other, corners
            if size < 3:
                return corners, 0, 0
            farthest = _farthest(corners, size)
        reached = within <= farthest + TOUCH_TOLERANCE
        beyond, within = within, 2.0 * within
    area = 0.0
    for c in range(size):
        p = c - 1 if c > 0 else size - 1
        area += corners[p, 0] * corners[c, 1] - corners[c, 0] * corners[p, 1]
    if 0.5 * area <= 1.0e-12:
        return corners, 0, 0
    picked[0], bounding = index, 1
    for rank in range(tried):
        j = order[rank]
        nx, ny = _direction(points, index, j)
        for c in range(size):
            if corners[c, 0] * nx + corners[c, 1] * ny > ahead[j] - TOUCH_TOLERANCE:
                picked[bounding] = j
                bounding += 1
                break
    return corners, size, bounding


@cached
def cut_cells(indices: np.ndarray, points: np.ndarray, radii: np.ndarray, arena: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Twin of `cells.cut_cells`: corners (V, 2) in m and indices of bounding generators, both cell after cell, and their starts.

    The starts (K + 1, 2) are the first corner and the first bounding generator of each cell. An empty cell has neither.
    """
    number = len(indices)
    scratch, starts = _scratch(len(radii), len(arena)), np.zeros((number + 1, 2), np.int64)
    corners, bounds = np.empty((8 * number + 8, 2)), np.empty(10 * number + 10, np.int64)
    for k in range(number):
        index = indices[k]
        relative, size, bounding = _cut(index, points, radii, arena, scratch)
        first, bound = starts[k]
        if first + size > len(corners):
            corners = np.concatenate((corners, np.empty((len(corners) + size, 2))))
        if bound + bounding > len(bounds):
            bounds = np.concatenate((bounds, np.empty(len(bounds) + bounding, np.int64)))
        for c in range(size):
            corners[first + c, 0], corners[first + c, 1] = relative[c, 0] + points[index, 0], relative[c, 1] + points[index, 1]
        bounds[bound : bound + bounding] = scratch[2][:bounding]
        starts[k + 1, 0], starts[k + 1, 1] = first + size, bound + bounding
    return corners[: starts[number, 0]], bounds[: starts[number, 1]], starts


@njit
def _direction(points: np.ndarray, index: int, j: int) -> tuple[float, float]:
    """The unit vector from generator `index` to generator `j`; (1, 0) for coincident generators."""
    dx, dy = points[j, 0] - points[index, 0], points[j, 1] - points[index, 1]
    span = math.sqrt(dx * dx + dy * dy)
    if span == 0.0:
        return 1.0, 0.0
    return dx / span, dy / span
