"""Whom an agent must hear: the owners of all that lies around its cell and in its footprint, and the sensors that look there.

It is worked out from places that may be a few seconds old, beacons or gossips, so everything is asked for `MARGIN` m wider than the
round needs. If in doubt hear more: what is heard beyond need changes no bit.
"""

import math

import numpy as np

from protocol.geometry import distances

PERIOD = 2.0  # s of world time between two beacons of an agent, and between two choices
MARGIN = 20.0  # m: a COD jumps by up to 14 m when the heading of a class D sensor turns, bodies and borders move between beacons
SPACING = 6.0  # m between the points at which owners are looked for; no owner is so small that it is missed


def owners(points: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """Which generators (N, 3) own anything within `SPACING` / sqrt(2) m of any of the points (P, 2): (N,) bool.

    The difference of two power distances is linear with slope 2 |p - q|, so who owns a place so near to a point is behind the best
    there by no more than sqrt(2) SPACING |p - q|.
    """
    found = np.zeros(len(generators), dtype=bool)
    rows = np.nonzero(_within_reach(points, generators))[0]
    near = generators[rows]
    x, y = near[:, 0], near[:, 1]
    dx, dy = x[:, None] - points[:, 0], y[:, None] - points[:, 1]
    power = dx * dx + dy * dy - (near[:, 2] ** 2)[:, None]
    best = power.argmin(axis=0)
    apart = np.sqrt((x[:, None] - x) ** 2 + (y[:, None] - y) ** 2)
    behind = power - power[best, np.arange(len(points))]
    found[rows] = (behind <= math.sqrt(2.0) * SPACING * apart[:, best]).any(axis=1)
    return found


def _within_reach(points: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """Which generators (N, 3) could own something around the points (P, 2) at all, (N,) bool: at best they are as near as the circle
    around the points allows, and the best of all is no worse there than from the far side of that circle."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.sqrt(((points - middle) ** 2).sum(axis=1).max())) + SPACING
    away = np.sqrt((generators[:, 0] - middle[0]) ** 2 + (generators[:, 1] - middle[1]) ** 2)
    least = np.maximum(away - radius, 0.0) ** 2 - generators[:, 2] ** 2
    found: np.ndarray = least <= ((away + radius) ** 2 - generators[:, 2] ** 2).min()
    return found


def region(cell: np.ndarray, eye: tuple[float, float], halo: float, reach: float, arena: np.ndarray) -> np.ndarray:
    """Points (P, 2) of a grid over the arena within the halo of a cell or within `reach` m of the sensor, `MARGIN` m wider."""
    around = np.vstack([cell, [eye]])
    width = max(halo, reach) + MARGIN + SPACING
    low = np.maximum(around.min(axis=0) - width, arena.min(axis=0))
    high = np.minimum(around.max(axis=0) + width, arena.max(axis=0))
    columns, rows = (np.arange(low[axis], high[axis] + SPACING, SPACING) for axis in (0, 1))
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    dx, dy = points[:, 0] - eye[0], points[:, 1] - eye[1]
    near = dx * dx + dy * dy <= (reach + MARGIN + SPACING) ** 2
    return points[near | (distances(cell, points) <= halo + MARGIN + SPACING)]


def wanted(
    cell: np.ndarray, eye: tuple[float, float], reach: float, halo: float, places: np.ndarray, generators: np.ndarray, arena: np.ndarray
) -> np.ndarray:
    """Which of N others must be heard: (N,) bool.

    `places` (N, 3) are x, y and reach of their sensors in m, `generators` (N + 1, 3) theirs and, last, the own one.
    """
    home = cell if len(cell) else _threshold(generators, arena)
    apart = distances(home, places[:, :2])
    looking = apart <= halo + MARGIN + places[:, 2]
    points = region(home, eye, halo, reach, arena)
    return looking | owners(points, generators)[:-1]


def _threshold(generators: np.ndarray, arena: np.ndarray) -> np.ndarray:
    """Where an empty cell, of the last generator, would appear first: the place (1, 2) of the arena at which it is least outdone."""
    low, high = arena.min(axis=0), arena.max(axis=0)
    columns, rows = (np.linspace(low[axis], high[axis], 2 + int((high[axis] - low[axis]) / (2.0 * SPACING))) for axis in (0, 1))
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    dx, dy = generators[:, :1] - points[:, 0], generators[:, 1:2] - points[:, 1]
    power = dx * dx + dy * dy - (generators[:, 2] ** 2)[:, None]
    return points[(power[-1] - power[:-1].min(axis=0)).argmin()][None, :]
