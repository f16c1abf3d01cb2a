"""Compiled prediction of the particles that matter to an owner: those around its cell and those in its footprint, one step on.

What cannot come near is not even predicted. What may go either way is written down and counted without branches, because no processor
foresees them. Rules as in `kernels`.
"""

import numpy as np
from numba import njit

from agents.cell_kernels import around, near
from agents.kernels import blank, move_one, sort_by_id
from agents.numba_cache import cached
from agents.words import PARTICLES, WEIGHT

Box = tuple[float, float, float, float]  # west, south, east and north, m


@njit
def _candidates(said: tuple, told: tuple, box: Box, eye: tuple[float, float], reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the particles in gossips (states float32, ids, and rows that say how many each and their weight) and of those told otherwise
    (states, weights, ids): those in a box or within `reach` m of a point, as places, ids and weights. The others stand behind the first.
    """
    said_states, said_ids, table = said
    states, weights, ids = told
    west, south, east, north = box
    number, size, count, reach2 = len(said_ids), len(said_ids) + len(ids), 0, reach * reach
    within, places = np.empty(size, np.bool_), np.empty(size, np.int64)
    for n in range(number):
        x, y = np.float64(said_states[n, 0]), np.float64(said_states[n, 1])
        dx, dy = x - eye[0], y - eye[1]
        within[n] = ((west <= x) & (x <= east) & (south <= y) & (y <= north)) | (dx * dx + dy * dy <= reach2)
    for n in range(len(ids)):
        x, y = states[n, 0], states[n, 1]
        dx, dy = x - eye[0], y - eye[1]
        within[number + n] = ((west <= x) & (x <= east) & (south <= y) & (y <= north)) | (dx * dx + dy * dy <= reach2)
    for n in range(size):
        places[count] = n
        count += within[n]
    names, masses, row, end = np.empty(count, np.uint64), np.empty(count), -1, 0
    for k in range(count):
        n = places[k]
        if n >= number:
            names[k], masses[k] = ids[n - number], weights[n - number]
            continue
        while n >= end:
            row += 1
            end += int(table[row, PARTICLES])
        names[k], masses[k] = said_ids[n], table[row, WEIGHT]
    return places[:count], names, masses


@cached
def gather(
    said: tuple,
    told: tuple,
    births: tuple,
    polygon: np.ndarray,
    halo: float,
    eye: tuple[float, float],
    reach: float,
    step: float,
    motion: tuple,
) -> tuple:
    """Twin of `arithmetic.gather`, of the particles in gossips and of those told otherwise; `step` is the farthest that one can move."""
    said_states, told_states, (born_states, born_weights, born_ids) = said[0], told[0], births
    places, names, masses = _candidates(said, told, around(polygon, halo + step), eye, reach + step)
    order, number, known, born = sort_by_id(names, np.arange(len(names))), len(said_states), 0, len(born_ids)
    states, weights, ids = blank(len(names) + born)
    for rank in range(len(names)):
        k = order[rank]
        if rank > 0 and names[k] == names[order[rank - 1]]:
            continue
        n = places[k]
        if n < number:
            vx, vy = np.float64(said_states[n, 2]), np.float64(said_states[n, 3])
            moved = move_one(np.float64(said_states[n, 0]), np.float64(said_states[n, 1]), vx, vy, names[k], motion)
        else:
            n -= number
            moved = move_one(told_states[n, 0], told_states[n, 1], told_states[n, 2], told_states[n, 3], names[k], motion)
        states[known, 0], states[known, 1], states[known, 2], states[known, 3], inside = moved
        weights[known], ids[known] = masses[k] * motion[7] if inside else 0.0, names[k]
        known += 1
    states[known : known + born], weights[known : known + born], ids[known : known + born] = born_states, born_weights, born_ids
    return divide(states, weights, ids, known, known + born, polygon, halo, around(polygon, halo), eye, reach)


@njit
def divide(
    states: np.ndarray,
    weights: np.ndarray,
    ids: np.ndarray,
    known: int,
    number: int,
    polygon: np.ndarray,
    halo: float,
    box: Box,
    eye: tuple[float, float],
    reach: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the first `number` particles those within the halo of a polygon, whose `box` that is, and of the others among the `known` ones,
    which come first, those within reach of a point."""
    west, south, east, north = box
    rows, x, y, count = np.empty(number, np.int64), np.empty(number), np.empty(number), 0
    for n in range(number):
        rows[count], x[count], y[count] = n, states[n, 0], states[n, 1]
        count += (west <= states[n, 0]) & (states[n, 0] <= east) & (south <= states[n, 1]) & (states[n, 1] <= north)
    close, inside = near(polygon, x[:count], y[:count], halo), np.zeros(number, np.bool_)
    for k in range(count):
        inside[rows[k]] = close[k]
    near_rows, far_rows, near_count, far_count = rows, np.empty(number, np.int64), 0, 0
    for n in range(number):
        dx, dy = states[n, 0] - eye[0], states[n, 1] - eye[1]
        near_rows[near_count], far_rows[far_count] = n, n
        near_count += inside[n]
        far_count += (not inside[n]) & (n < known) & (dx * dx + dy * dy <= reach * reach)
    return *_rows(near_rows[:near_count], states, weights, ids), *_rows(far_rows[:far_count], states, weights, ids)


@njit
def _rows(rows: np.ndarray, states: np.ndarray, weights: np.ndarray, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Some particles."""
    some_states, some_weights, some_ids = blank(len(rows))
    for k in range(len(rows)):
        n = rows[k]
        for axis in range(4):
            some_states[k, axis] = states[n, axis]
        some_weights[k], some_ids[k] = weights[n], ids[n]
    return some_states, some_weights, some_ids
