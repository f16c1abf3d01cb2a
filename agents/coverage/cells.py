"""Power cells: generator k owns a point x when |x - p_k|^2 - r_k^2 is least (15).

Data types: generators are points (N, 2) in m and radii (N,) in m; a `Cell` is a convex polygon with the indices of its bounding generators.

Rules. Ties go to the lower index: of coincident equal generators the first owns the cell, and the others own nothing. Empty cells are
normal. A cell need not hold its own generator.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from protocol.geometry import EMPTY

TOUCH_TOLERANCE = 1.0e-6  # m: a generator this close to bounding a cell belongs to its claim


class Cell(NamedTuple):
    """A power cell and the indices of the generators that bound it, its own first; an empty cell has neither."""

    polygon: np.ndarray  # (V, 2), counter-clockwise
    bounding: tuple[int, ...]


NO_CELL = Cell(EMPTY, ())


def power_cell(index: int, points: np.ndarray, radii: np.ndarray, arena: np.ndarray) -> np.ndarray:
    """The power cell (15) of generator `index` inside the convex arena: (V, 2) counter-clockwise, (0, 2) when empty."""
    return cut(index, points, radii, arena).polygon


def cut(index: int, points: np.ndarray, radii: np.ndarray, arena: np.ndarray) -> Cell:
    """The power cell (15) of generator `index`, with the generators that bound it.

    The arena is clipped by half-planes, nearest bisector first. The bisector towards generator j lies
    t_j = (d^2 + r_i^2 - r_j^2) / (2 d) ahead of point i. Once t_j exceeds the distance of the farthest corner, no later generator cuts.
    """
    origin_x, origin_y = float(points[index, 0]), float(points[index, 1])
    order, ahead, normals = _bisectors(index, points, radii)
    corners = [(float(x) - origin_x, float(y) - origin_y) for x, y in arena]
    farthest = _farthest(corners)
    tried = 0
    for rank in range(len(order)):
        limit = ahead[rank]
        if limit > farthest + TOUCH_TOLERANCE:
            break
        tried = rank + 1
        clipped = _clip(corners, normals[rank][0], normals[rank][1], limit)
        if clipped is not corners:
            corners = clipped
            if len(corners) < 3:
                return NO_CELL
            farthest = _farthest(corners)
    if _area(corners) <= 1.0e-12:
        return NO_CELL
    bounds = [index]
    for rank in range(tried):
        nx, ny = normals[rank]
        if any(x * nx + y * ny > ahead[rank] - TOUCH_TOLERANCE for x, y in corners):
            bounds.append(order[rank])
    return Cell(np.array(corners) + points[index], tuple(bounds))


def cut_cells(indices: Sequence[int], generators: np.ndarray, arena: np.ndarray) -> list[Cell]:
    """The power cells (15) of the generators `indices` among several (N, 3), x, y and power radius in m, each as by `cut`."""
    return [cut(index, generators[:, :2], generators[:, 2], arena) for index in indices]


def _bisectors(index: int, points: np.ndarray, radii: np.ndarray) -> tuple[list[int], list[float], list[list[float]]]:
    """The other generators, sorted by the distance of their bisectors ahead of `index`: indices, distances in m, unit normals."""
    offsets = points - points[index]
    squared = offsets[:, 0] * offsets[:, 0] + offsets[:, 1] * offsets[:, 1]
    spans = np.sqrt(squared)
    excess = squared + radii[index] * radii[index] - radii * radii
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = excess / (2.0 * spans)
        normals = offsets / spans[:, None]
    coincident = spans == 0.0
    if coincident.any():
        wins = (radii < radii[index]) | ((radii == radii[index]) & (np.arange(len(radii)) > index))
        ahead[coincident] = np.where(wins[coincident], math.inf, -math.inf)
        normals[coincident] = (1.0, 0.0)
    ahead[index] = math.inf
    order = np.argsort(ahead, kind="stable")
    return order.tolist(), ahead[order].tolist(), normals[order].tolist()


def _farthest(corners: list[tuple[float, float]]) -> float:
    """The distance in m of the farthest corner from the origin."""
    return math.sqrt(max(x * x + y * y for x, y in corners))


def _clip(corners: list[tuple[float, float]], nx: float, ny: float, limit: float) -> list[tuple[float, float]]:
    """The part of a convex polygon with n . x <= limit, m; the same object when no corner is cut off."""
    heights = [x * nx + y * ny - limit for x, y in corners]
    if max(heights) <= 0.0:
        return corners
    inside = []
    for here, (x, y) in enumerate(corners):
        before, after = heights[here - 1], heights[here]
        if (before < 0.0 < after) or (after < 0.0 < before):
            px, py = corners[here - 1]
            share = before / (before - after)
            inside.append((px + share * (x - px), py + share * (y - py)))
        if after <= 0.0:
            inside.append((x, y))
    return inside


def _area(corners: list[tuple[float, float]]) -> float:
    """The area of a polygon in m^2, positive when counter-clockwise."""
    return 0.5 * sum(corners[i - 1][0] * corners[i][1] - corners[i][0] * corners[i - 1][1] for i in range(len(corners)))
