"""Convex polygons in the plane: float64 arrays (V, 2) in metres, counter-clockwise; the empty polygon is (0, 2)."""

import math
from collections.abc import Sequence

import numpy as np

EMPTY = np.empty((0, 2))
EMPTY.flags.writeable = False


def rectangle(width: float, height: float) -> np.ndarray:
    """The rectangle with corners (0, 0) and (width, height), counter-clockwise (4, 2)."""
    return np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])


def wrap_angle(angle: float) -> float:
    """The same direction in [-pi, pi)."""
    wrapped = (angle + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped if wrapped < math.pi else -math.pi  # the remainder of a tiny negative number rounds up to 2 pi


def polygon_area(polygon: np.ndarray) -> float:
    """Signed area in m^2 (shoelace); positive when counter-clockwise, 0 when empty."""
    if len(polygon) < 3:
        return 0.0
    offset = polygon - polygon[0]
    x, y = offset[:, 0], offset[:, 1]
    return 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def total_area(polygons: Sequence[np.ndarray]) -> float:
    """Sum of the `polygon_area` of several polygons, m^2, correctly rounded but for the products in it."""
    some = [polygon for polygon in polygons if len(polygon) >= 3]
    if not some:
        return 0.0
    corners, sizes = np.concatenate(some), [len(polygon) for polygon in some]
    offset = corners - np.repeat(np.array([polygon[0] for polygon in some]), sizes, axis=0)
    x, y = offset.T  # the first corner of each is the origin, so the step from one polygon to the next adds nothing
    return 0.5 * math.fsum((x[:-1] * y[1:] - x[1:] * y[:-1]).tolist())


def polygon_centroid(polygon: np.ndarray) -> np.ndarray:
    """Centroid of the area (2,); the mean of the corners when the area vanishes; NaN when empty."""
    if len(polygon) == 0:
        return np.full(2, np.nan)
    offset = polygon - polygon[0]
    x, y = offset[:, 0], offset[:, 1]
    cross = x[:-1] * y[1:] - x[1:] * y[:-1]
    twice_area = float(np.sum(cross))
    if twice_area <= 1e-12:
        return polygon.mean(axis=0)
    return polygon[0] + np.array([np.sum((x[:-1] + x[1:]) * cross), np.sum((y[:-1] + y[1:]) * cross)]) / (3.0 * twice_area)


def contains(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which of the points (N, 2) lie in the convex polygon, its border included: (N,) bool."""
    inside = np.full(len(points), len(polygon) >= 3)
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0)):
        edge = end - start
        inside &= edge[0] * (points[:, 1] - start[1]) - edge[1] * (points[:, 0] - start[0]) >= 0.0
    return inside


def distances(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance in m of each point (N, 2) to the convex polygon: 0 inside, infinite when the polygon is empty; (N,)."""
    if len(polygon) == 0:
        return np.full(len(points), np.inf)
    nearest = np.full(len(points), np.inf)
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0)):
        edge = end - start
        length2 = edge[0] * edge[0] + edge[1] * edge[1]
        dx, dy = points[:, 0] - start[0], points[:, 1] - start[1]
        along = np.clip((dx * edge[0] + dy * edge[1]) / length2, 0.0, 1.0) if length2 > 0.0 else np.zeros(len(points))
        dx, dy = dx - along * edge[0], dy - along * edge[1]
        nearest = np.minimum(nearest, dx * dx + dy * dy)
    nearest[contains(polygon, points)] = 0.0
    return np.sqrt(nearest)
