"""Compiled selection of peers: the bit-for-bit twin of agents/interest/selection.py, in one call.

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np
from numba import njit

from agents.compiled.cache import cached
from agents.compiled.cell_kernels import around, distance
from agents.interest.position_table import GENERATOR_X, GENERATOR_Y, POWER_RADIUS, SENSOR_REACH, SENSOR_X, SENSOR_Y
from agents.interest.selection import APPEARANCE_MARGIN, GRID_SPACING, OWNER_SLACK, SEARCH_RADIUS, SELECTION_MARGIN

Limits = tuple[float, float, float, float]
BLOCK = 4  # points of a grid along each side of a block


@njit
def _rivals(points: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Twin of `selection._within_reach`: (K, 4) of row number, x and y in m, and squared radius in m^2 of the generators."""
    west, south, east, north = around(points, 0.0)
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    farthest = 0.0
    for p in range(len(points)):
        dx, dy = points[p, 0] - x, points[p, 1] - y
        farthest = max(farthest, dx * dx + dy * dy)
    radius = math.sqrt(farthest) + GRID_SPACING
    number, limit = len(table), np.inf
    least = np.empty(number)
    for n in range(number):
        dx, dy, power_radius = table[n, GENERATOR_X] - x, table[n, GENERATOR_Y] - y, table[n, POWER_RADIUS]
        away, squared = math.sqrt(dx * dx + dy * dy), power_radius * power_radius
        near, far = max(away - radius, 0.0), away + radius
        least[n] = near * near - squared
        limit = min(limit, far * far - squared)
    found, count = np.empty((number, 4)), 0
    for n in range(number):
        if least[n] <= limit:
            x, y, power_radius = table[n, GENERATOR_X], table[n, GENERATOR_Y], table[n, POWER_RADIUS]
            found[count, 0], found[count, 1], found[count, 2], found[count, 3] = n, x, y, power_radius * power_radius
            count += 1
    return found[:count]


@njit
def _candidates(points: np.ndarray, rivals: np.ndarray, away: np.ndarray, found: np.ndarray) -> int:
    """The number of rivals (K, 4) that may own ground near one of a few points; their indices are written into `found`, ascending.

    `away` (K,) is scratch. A circle contains the points. Anywhere in it the smallest power distance is at most `limit`, the smallest one
    to the far sides of the circle. A rival is found if its power distance to the near side exceeds that by no more than the margin. The
    margin is `OWNER_SLACK` times the distance from the rival to the best generator, of which this is an upper bound.
    """
    west, south, east, north = around(points, 0.0)
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    dx, dy = 0.5 * (east - west), 0.5 * (north - south)
    radius, limit, most = math.sqrt(dx * dx + dy * dy), np.inf, 0.0
    for n in range(len(rivals)):
        dx, dy = rivals[n, 1] - x, rivals[n, 2] - y
        away[n] = math.sqrt(dx * dx + dy * dy)
        far = away[n] + radius
        limit, most = min(limit, far * far - rivals[n, 3]), max(most, rivals[n, 3])
    slack, count = OWNER_SLACK * (2.0 * radius + math.sqrt(max(limit + most, 0.0))) + 1e-6, 0
    for n in range(len(rivals)):
        near = max(away[n] - radius, 0.0)
        if near * near - rivals[n, 3] - OWNER_SLACK * near <= limit + slack:
            found[count] = n
            count += 1
    return count


@njit
def _owners(points: np.ndarray, ends: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twin of `selection.owners` for points in blocks; `ends` holds the end of each block."""
    rivals = _rivals(points, table)
    number = len(rivals)
    power, near = np.empty(number), np.empty(number, np.int64)
    found, least, start = np.zeros(len(table), np.bool_), np.empty(len(points)), 0
    for end in ends:
        count = _candidates(points[start:end], rivals, power, near)
        for p in range(start, end):
            best, smallest = 0, np.inf
            for m in range(count):
                n = near[m]
                dx, dy = rivals[n, 1] - points[p, 0], rivals[n, 2] - points[p, 1]
                power[m] = dx * dx + dy * dy - rivals[n, 3]
                if power[m] < smallest:
                    best, smallest = n, power[m]
            least[p] = smallest
            for m in range(count):
                n = near[m]
                row = int(rivals[n, 0])
                if not found[row]:
                    dx, dy = rivals[n, 1] - rivals[best, 1], rivals[n, 2] - rivals[best, 2]
                    found[row] = power[m] - smallest <= OWNER_SLACK * math.sqrt(dx * dx + dy * dy)
        start = end
    return found, least


@njit
def _search_grid(
    cell: np.ndarray, position: tuple[float, float], halo: float, reach: float, arena: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Twin of `selection.search_grid`: points (N, 2) in m, block after block of neighbouring points, and the end of each block."""
    west, south, east, north = around(cell, 0.0)
    width = max(halo, reach) + SELECTION_MARGIN + GRID_SPACING
    first, bottom, last, top = around(arena, 0.0)
    first, bottom = max(min(west, position[0]) - width, first), max(min(south, position[1]) - width, bottom)
    last, top = min(max(east, position[0]) + width, last), min(max(north, position[1]) + width, top)
    columns, rows = 2 + int(max(last - first, 0.0) / GRID_SPACING), 2 + int(max(top - bottom, 0.0) / GRID_SPACING)
    points, count = np.empty((columns * rows, 2)), 0
    ends, blocks = np.empty(columns * rows, np.int64), 0
    disc, ring = (
        (reach + SELECTION_MARGIN + GRID_SPACING) * (reach + SELECTION_MARGIN + GRID_SPACING),
        halo + SELECTION_MARGIN + GRID_SPACING,
    )
    for south_row in range(0, rows, BLOCK):
        for west_column in range(0, columns, BLOCK):
            start = count
            for row in range(south_row, min(south_row + BLOCK, rows)):
                y = bottom + GRID_SPACING * row
                for column in range(west_column, min(west_column + BLOCK, columns)):
                    x = first + GRID_SPACING * column
                    dx, dy = x - position[0], y - position[1]
                    if dx * dx + dy * dy <= disc or distance(cell, x, y) <= ring:
                        points[count, 0], points[count, 1] = x, y
                        count += 1
            if count > start:
                ends[blocks] = count
                blocks += 1
    return points[:count], ends[:blocks]


@njit
def _likeliest_cell(table: np.ndarray, arena: np.ndarray) -> np.ndarray:
    """Twin of `selection._likeliest_cell`: a point (1, 2), m."""
    number, home = len(table), np.empty((1, 2))
    x, y, radius = table[number - 1, GENERATOR_X], table[number - 1, GENERATOR_Y], table[number - 1, POWER_RADIUS]
    squared = radius * radius
    home[0, 0], home[0, 1] = x, y
    if number == 1:
        return home
    west, south, east, north = around(arena, 0.0)
    west, south, east, north = (
        max(west, x - SEARCH_RADIUS),
        max(south, y - SEARCH_RADIUS),
        min(east, x + SEARCH_RADIUS),
        min(north, y + SEARCH_RADIUS),
    )
    columns, rows = 2 + int(max(east - west, 0.0) / (2.0 * GRID_SPACING)), 2 + int(max(north - south, 0.0) / (2.0 * GRID_SPACING))
    across, up = (east - west) / (columns - 1), (north - south) / (rows - 1)
    px, py, best = np.empty(columns * rows), np.empty(columns * rows), np.full(columns * rows, np.inf)
    for p in range(len(best)):
        px[p], py[p] = west + across * (p % columns), south + up * (p // columns)
    for n in range(number - 1):
        there_x, there_y, radius = table[n, GENERATOR_X], table[n, GENERATOR_Y], table[n, POWER_RADIUS]
        for p in range(len(best)):  # without branches, for several at once
            dx, dy = there_x - px[p], there_y - py[p]
            best[p] = min(best[p], dx * dx + dy * dy - radius * radius)
    smallest = np.inf
    for p in range(len(best)):
        dx, dy = x - px[p], y - py[p]
        outdone = dx * dx + dy * dy - squared - best[p]
        if outdone < smallest:
            smallest, home[0, 0], home[0, 1] = outdone, px[p], py[p]
    return home


@cached
def select_peers(
    cell: np.ndarray,
    position: tuple[float, float],
    reach: float,
    halo: float,
    table: np.ndarray,
    arena: np.ndarray,
    bounds: tuple[float, float, float],
    drift: float,
) -> tuple[np.ndarray, Limits]:
    """Twin of `selection.select_peers`: True for the chosen rows, and the needed ground as west, south, east and north in m.

    `bounds` and `drift` are those of `selection.KnownArena`.
    """
    number, home = len(table) - 1, cell
    if len(cell) == 0:
        home, halo = _likeliest_cell(table, arena), halo + APPEARANCE_MARGIN
    points, ends = _search_grid(home, position, halo, reach, arena)
    owning, least = _owners(points, ends, table)
    west, south, east, north = around(home, 0.0)
    chosen = owning[:number]
    for n in range(number):
        if not chosen[n]:
            x, y, width = table[n, SENSOR_X], table[n, SENSOR_Y], halo + SELECTION_MARGIN + table[n, SENSOR_REACH]
            away = max(max(west - x, x - east), max(south - y, y - north))  # a lower bound of the distance
            chosen[n] = away <= width + 1e-6 and distance(home, x, y) <= width
    look = halo + SELECTION_MARGIN + bounds[0] + drift
    west, south, east, north = west - look, south - look, east + look, north + look
    for p in range(len(points)):
        far = math.sqrt(max(least[p] + bounds[2] * bounds[2], 0.0)) + (bounds[1] + drift)
        west, south = min(west, points[p, 0] - far), min(south, points[p, 1] - far)
        east, north = max(east, points[p, 0] + far), max(north, points[p, 1] + far)
    return chosen, (west, south, east, north)
