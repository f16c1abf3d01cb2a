"""Compiled copies of a round; the twin of `remote_copies` of agents/tracking/regions.py.

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np
from numba import njit

from agents.compiled import run_columns
from agents.compiled.cache import cached
from agents.compiled.cell_kernels import apart, around
from agents.compiled.claim_kernels import owned
from agents.compiled.particle_kernels import blank, motion_at, move_one

_Particles = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@njit
def _farther(polygon: np.ndarray, x: np.ndarray, y: np.ndarray, halo: float, copy_distance: float) -> np.ndarray:
    """True for the points farther than `halo` m and at most `copy_distance` m from a polygon: (N,) bool.

    With an infinite copy_distance, points far outside the box around the polygon need no distance.
    """
    (west, south, east, north), wide, found = around(polygon, 0.0), halo + 1e-6, np.empty(len(x), np.bool_)
    for n in range(len(x)):
        found[n] = (x[n] < west - wide) | (x[n] > east + wide) | (y[n] < south - wide) | (y[n] > north + wide)
    rows = np.arange(len(x)) if copy_distance < np.inf else np.nonzero(~found)[0]
    nearest, within = apart(polygon, x[rows], y[rows])
    for k in range(len(rows)):
        away = 0.0 if within[k] else math.sqrt(nearest[k])
        found[rows[k]] = away > halo and (away <= copy_distance or copy_distance == np.inf)
    return found


@cached
def remote_copies(
    near: tuple,
    density: tuple,
    polygon: np.ndarray,
    generators: np.ndarray,
    wins_ties: np.ndarray,
    copy_distance: float,
    settings: np.ndarray,
    keys: np.ndarray,
    tick: int,
) -> _Particles:
    """Twin of `regions.remote_copies`: states, weights, ids and labels of the copies."""
    near_states, near_weights, near_ids, near_labels = near
    states, weights, ids, labels = density
    motion, survival = motion_at(settings, keys, np.uint64(tick)), settings[run_columns.SURVIVAL]
    width, height, halo = settings[run_columns.WIDTH], settings[run_columns.HEIGHT], settings[run_columns.HALO]
    found, found_weights, found_ids, found_labels = blank(len(near_ids) + len(ids))
    mine, count = owned(near_states, generators, wins_ties, width, height), 0
    for n in range(len(near_ids)):
        x, y = near_states[n, 0], near_states[n, 1]
        if near_weights[n] > 0.0 and not mine[n] and 0.0 <= x <= width and 0.0 <= y <= height:
            for axis in range(4):
                found[count, axis] = near_states[n, axis]
            found_weights[count], found_ids[count], found_labels[count] = near_weights[n], near_ids[n], near_labels[n]
            count += 1
    moved, moved_weights, number = np.empty((len(ids), 4)), np.empty(len(ids)), 0
    rows, east, north = np.empty(len(ids), np.int64), np.empty(len(ids)), np.empty(len(ids))
    for n in range(len(ids)):
        x, y, vx, vy, inside = move_one(states[n, 0], states[n, 1], states[n, 2], states[n, 3], ids[n], motion)
        weight = weights[n] * survival if inside else 0.0
        if weight > 0.0:
            moved[number, 0], moved[number, 1], moved[number, 2], moved[number, 3] = x, y, vx, vy
            moved_weights[number], rows[number], east[number], north[number] = weight, n, x, y
            number += 1
    outside = _farther(polygon, east[:number], north[:number], halo, copy_distance)
    for k in range(number):
        if outside[k]:
            for axis in range(4):
                found[count, axis] = moved[k, axis]
            found_weights[count], found_ids[count], found_labels[count] = moved_weights[k], ids[rows[k]], labels[rows[k]]
            count += 1
    return found[:count], found_weights[:count], found_ids[:count], found_labels[:count]
