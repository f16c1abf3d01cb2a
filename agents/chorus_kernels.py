"""The compiled round of all who have heard the same: what `round_kernels.refresh` gives each of them, in one call.

Every particle is predicted once and sorted once, and each owner takes from those what it would have taken alone. Rules as in `kernels`.
"""

import numpy as np
from numba import njit

from agents.cell_kernels import around
from agents.gather_kernels import divide
from agents.kernels import blank, move_one, sort_by_id
from agents.numba_cache import cached
from agents.round_kernels import HALO, STEP, correct, motion_of
from agents.words import PARTICLES, WEIGHT

SIZES = 4  # columns: how many particles were updated, are owned and were drawn, and how many targets are reported
SUMS = 5  # columns: mass, its sums of x and y, load and detected


@njit
def _predicted(states: np.ndarray, ids: np.ndarray, table: np.ndarray, motion: tuple) -> tuple:
    """All particles of gossips in ascending order of id: where they were (x, y), and one step on (states, weights, ids)."""
    number = len(ids)
    weights, start = np.empty(number), 0
    for row in range(len(table)):
        end = start + int(table[row, PARTICLES])
        weights[start:end] = table[row, WEIGHT]
        start = end
    order = sort_by_id(ids, np.arange(number))
    x, y, moved, kept, names = np.empty(number), np.empty(number), np.empty((number, 4)), np.empty(number), np.empty(number, np.uint64)
    for k in range(number):
        n = order[k]
        x[k], y[k] = np.float64(states[n, 0]), np.float64(states[n, 1])
        east, north, vx, vy, inside = move_one(x[k], y[k], np.float64(states[n, 2]), np.float64(states[n, 3]), ids[n], motion)
        moved[k, 0], moved[k, 1], moved[k, 2], moved[k, 3] = east, north, vx, vy
        kept[k], names[k] = weights[n] * motion[7] if inside else 0.0, ids[n]
    return x, y, moved, kept, names


@njit
def _close_by(
    said: tuple, births: tuple, polygon: np.ndarray, halo: float, eye: tuple[float, float], reach: float, step: float, room: tuple
) -> tuple:
    """What `gather_kernels.gather` finds, of particles that have been `_predicted`."""
    x, y, moved, kept, names = said
    born_states, born_weights, born_ids = births
    within, chosen, states, weights, ids = room
    left, low, right, high = around(polygon, halo + step)
    far2, count = (reach + step) * (reach + step), 0
    for k in range(len(x)):  # without branches, for several at once
        dx, dy = x[k] - eye[0], y[k] - eye[1]
        within[k] = ((left <= x[k]) & (x[k] <= right) & (low <= y[k]) & (y[k] <= high)) | (dx * dx + dy * dy <= far2)
    for k in range(len(x)):
        chosen[count] = k
        count += within[k]
    known = 0
    for j in range(count):
        k = chosen[j]
        if j > 0 and names[k] == names[chosen[j - 1]]:
            continue
        for axis in range(4):
            states[known, axis] = moved[k, axis]
        weights[known], ids[known] = kept[k], names[k]
        known += 1
    for n in range(len(born_ids)):
        for axis in range(4):
            states[known + n, axis] = born_states[n, axis]
        weights[known + n], ids[known + n] = born_weights[n], born_ids[n]
    return divide(states, weights, ids, known, known + len(born_ids), polygon, halo, around(polygon, halo), eye, reach)


@njit
def _append(whole: tuple, size: int, part: tuple) -> tuple:
    """Particles behind the first `size` ones of others; with more room where it is needed."""
    states, weights, ids = whole
    end = size + len(part[2])
    if end > len(ids):
        more = 2 * end
        wider, heavier, longer = np.empty((more, 4)), np.empty(more), np.empty(more, np.uint64)
        wider[:size], heavier[:size], longer[:size] = states[:size], weights[:size], ids[:size]
        states, weights, ids = wider, heavier, longer
    states[size:end], weights[size:end], ids[size:end] = part
    return states, weights, ids


@cached
def refresh_all(
    settings: np.ndarray,
    keys: np.ndarray,
    tick: int,
    table: np.ndarray,
    salts: np.ndarray,
    detections: np.ndarray,
    said: tuple,
    births: tuple,
    corners: np.ndarray,
    cells: np.ndarray,
    generators: np.ndarray,
    first: np.ndarray,
    claims: np.ndarray,
    owners: np.ndarray,
    directions: np.ndarray,
) -> tuple:
    """What all N make of their parts: updated, own and drawn particles and targets (T, 2), each owner after owner, their numbers
    (N, SIZES), and sums (N, SUMS).

    `cells` and `claims` (N + 1,) say where the corners and the generators of each begin, `owners` (N,) are the keys of their draws.
    """
    now, number = np.uint64(tick), len(table)
    halo, step = settings[HALO], settings[STEP]
    predicted = _predicted(said[0], said[1], table, motion_of(settings, keys, now))
    size = len(said[1]) + len(births[2])
    room = np.empty(len(said[1]), np.bool_), np.empty(len(said[1]) + 1, np.int64), *blank(size)
    updated, own, kept, targets = blank(2 * size), blank(2 * size), blank(2 * size), np.empty((size + 1, 2))
    sizes, sums, ends = np.zeros((number, SIZES), np.int64), np.zeros((number, SUMS)), np.zeros(SIZES, np.int64)
    for n in range(number):
        polygon, eye, reach = corners[cells[n] : cells[n + 1]], (table[n, 0], table[n, 1]), table[n, 4]
        close_by = _close_by(predicted, births, polygon, halo, eye, reach, step, room)
        claimed = slice(claims[n], claims[n + 1])
        claim = generators[claimed], first[claimed]
        found = correct(settings, keys, now, n, table, salts, detections, close_by, polygon, claim[0], claim[1], owners[n], directions)
        updated, own, kept = _append(updated, ends[0], found[0]), _append(own, ends[1], found[1]), _append(kept, ends[2], found[2])
        if ends[3] + len(found[8]) > len(targets):
            targets = np.concatenate((targets, np.empty((len(targets) + len(found[8]), 2))))
        targets[ends[3] : ends[3] + len(found[8])] = found[8]
        sizes[n] = len(found[0][2]), len(found[1][2]), len(found[2][2]), len(found[8])
        sums[n] = found[3], found[4], found[5], found[6], found[7]
        ends += sizes[n]
    return updated, own, kept, targets, sizes, sums
