"""Compiled choice of whom to hear: the bit-for-bit twin of `interest.wanted`, in one call. Same rules as `kernels`."""

import math

import numpy as np
from numba import njit

from agents.cell_kernels import distance

Limits = tuple[float, float, float, float]


@njit
def _limits(corners: np.ndarray) -> Limits:
    """West, south, east and north of some points."""
    west = east = corners[0, 0]
    south = north = corners[0, 1]
    for c in range(1, len(corners)):
        west, east = min(west, corners[c, 0]), max(east, corners[c, 0])
        south, north = min(south, corners[c, 1]), max(north, corners[c, 1])
    return west, south, east, north


@njit
def _rivals(points: np.ndarray, table: np.ndarray, spacing: float) -> np.ndarray:
    """Twin of `interest._within_reach`, of whole rows: the generators (K, 3) behind their row numbers, (K, 4)."""
    west, south, east, north = _limits(points)
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    farthest = 0.0
    for p in range(len(points)):
        dx, dy = points[p, 0] - x, points[p, 1] - y
        farthest = max(farthest, dx * dx + dy * dy)
    radius = math.sqrt(farthest) + spacing
    number, limit = len(table), np.inf
    least = np.empty(number)
    for n in range(number):
        dx, dy = table[n, 3] - x, table[n, 4] - y
        away, squared = math.sqrt(dx * dx + dy * dy), table[n, 5] * table[n, 5]
        near, far = max(away - radius, 0.0), away + radius
        least[n] = near * near - squared
        limit = min(limit, far * far - squared)
    found, count = np.empty((number, 4)), 0
    for n in range(number):
        if least[n] <= limit:
            found[count, 0], found[count, 1], found[count, 2], found[count, 3] = n, table[n, 3], table[n, 4], table[n, 5] * table[n, 5]
            count += 1
    return found[:count]


@njit
def _owners(points: np.ndarray, table: np.ndarray, spacing: float, behind: float) -> tuple[np.ndarray, np.ndarray]:
    """Twin of `interest.owners`."""
    rivals = _rivals(points, table, spacing)
    number = len(rivals)
    power, missing = np.empty(number), np.arange(number)
    found, least = np.zeros(len(table), np.bool_), np.empty(len(points))
    left = number
    for p in range(len(points)):
        best = 0
        for n in range(number):
            dx, dy = rivals[n, 1] - points[p, 0], rivals[n, 2] - points[p, 1]
            power[n] = dx * dx + dy * dy - rivals[n, 3]
            if power[n] < power[best]:
                best = n
        least[p] = power[best]
        kept = 0
        for m in range(left):
            n = missing[m]
            dx, dy = rivals[n, 1] - rivals[best, 1], rivals[n, 2] - rivals[best, 2]
            if power[n] - power[best] <= behind * math.sqrt(dx * dx + dy * dy):
                found[int(rivals[n, 0])] = True
            else:
                missing[kept] = n
                kept += 1
        left = kept
    return found, least


@njit
def _region(
    cell: np.ndarray, eye: tuple[float, float], halo: float, reach: float, arena: np.ndarray, margin: float, spacing: float
) -> np.ndarray:
    """Twin of `interest.region`."""
    west, south, east, north = _limits(cell)
    width = max(halo, reach) + margin + spacing
    first, bottom, last, top = _limits(arena)
    first, bottom = max(min(west, eye[0]) - width, first), max(min(south, eye[1]) - width, bottom)
    last, top = min(max(east, eye[0]) + width, last), min(max(north, eye[1]) + width, top)
    columns, rows = 2 + int(max(last - first, 0.0) / spacing), 2 + int(max(top - bottom, 0.0) / spacing)
    points, count = np.empty((columns * rows, 2)), 0
    disc, ring = (reach + margin + spacing) * (reach + margin + spacing), halo + margin + spacing
    for row in range(rows):
        y = bottom + spacing * row
        for column in range(columns):
            x = first + spacing * column
            dx, dy = x - eye[0], y - eye[1]
            if dx * dx + dy * dy <= disc or distance(cell, x, y) <= ring:
                points[count, 0], points[count, 1] = x, y
                count += 1
    return points[:count]


@njit
def _threshold(table: np.ndarray, arena: np.ndarray, around: float, spacing: float) -> np.ndarray:
    """Twin of `interest._threshold`."""
    number, home = len(table), np.empty((1, 2))
    x, y, squared = table[number - 1, 3], table[number - 1, 4], table[number - 1, 5] * table[number - 1, 5]
    home[0, 0], home[0, 1] = x, y
    if number == 1:
        return home
    west, south, east, north = _limits(arena)
    west, south, east, north = max(west, x - around), max(south, y - around), min(east, x + around), min(north, y + around)
    columns, rows = 2 + int(max(east - west, 0.0) / (2.0 * spacing)), 2 + int(max(north - south, 0.0) / (2.0 * spacing))
    across, up = (east - west) / (columns - 1), (north - south) / (rows - 1)
    smallest = np.inf
    for row in range(rows):
        py = south + up * row
        for column in range(columns):
            px = west + across * column
            best = np.inf
            for n in range(number - 1):
                dx, dy = table[n, 3] - px, table[n, 4] - py
                best = min(best, dx * dx + dy * dy - table[n, 5] * table[n, 5])
            dx, dy = x - px, y - py
            outdone = dx * dx + dy * dy - squared - best
            if outdone < smallest:
                smallest, home[0, 0], home[0, 1] = outdone, px, py
    return home


@njit(cache=True)
def wanted(
    cell: np.ndarray,
    eye: tuple[float, float],
    reach: float,
    halo: float,
    table: np.ndarray,
    arena: np.ndarray,
    bounds: tuple[float, float, float],
    drift: float,
    settings: tuple[float, float, float, float, float],
) -> tuple[np.ndarray, Limits]:
    """Twin of `interest.wanted`: who is chosen, and the needed ground. `bounds` and `drift` are those of the Ground; `settings` are
    MARGIN, APPEARING, SPACING, THRESHOLD and BEHIND."""
    margin, appearing, spacing, around, behind = settings
    number, home = len(table) - 1, cell
    if len(cell) == 0:
        home, halo = _threshold(table, arena, around, spacing), halo + appearing
    points = _region(home, eye, halo, reach, arena, margin, spacing)
    owning, least = _owners(points, table, spacing, behind)
    west, south, east, north = _limits(home)
    chosen = owning[:number]
    for n in range(number):
        if not chosen[n]:
            x, y, width = table[n, 0], table[n, 1], halo + margin + table[n, 2]
            away = max(max(west - x, x - east), max(south - y, y - north))  # no more than the distance
            chosen[n] = away <= width + 1e-6 and distance(home, x, y) <= width
    look = halo + margin + bounds[0] + drift
    west, south, east, north = west - look, south - look, east + look, north + look
    for p in range(len(points)):
        far = math.sqrt(max(least[p] + bounds[2] * bounds[2], 0.0)) + (bounds[1] + drift)
        west, south = min(west, points[p, 0] - far), min(south, points[p, 1] - far)
        east, north = max(east, points[p, 0] + far), max(north, points[p, 1] + far)
    return chosen, (west, south, east, north)
