"""Compiled particle kernels: prediction, selection and resampling for numba, each the bit-for-bit twin of a numpy function.

Data types: particles are arrays of states (N, 4), weights (N,), ids and labels (N,) uint64. A sensor is a row of `GossipTable.table`
(agents/gossip/table.py). The settings and the keys of a run are arrays (agents/compiled/run_columns.py).

Rules of all kernels. The numpy functions are the reference and the oracle of the tests; agents/compiled/backend.py wraps the loops in
their signatures. No fast-math: the order and the rounding of each operation are those of the reference. Compiled code is cached on disk
(agents/compiled/cache.py). Inner loops without branches compile to vector instructions.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from agents.compiled import run_columns
from agents.compiled.cache import cached
from agents.compiled.cell_kernels import insert, sorted_by
from agents.gossip.table import (
    COS,
    COS_HALF,
    COS_LEFT,
    COS_RIGHT,
    FAR_PROB,
    HEADING_NOISE,
    PLACE_NOISE,
    PROB,
    REACH,
    SIN,
    SIN_LEFT,
    SIN_RIGHT,
    X,
    Y,
)
from agents.tracking.measurement_likelihood import POSE_SPREAD
from protocol import arithmetic, random_streams

_MOST_BITS, _FULLEST = 14, 64  # most bits of an id that choose its bucket, and most ids in a bucket


# The plain functions of arrays, compiled for single numbers
scramble: Any = njit(random_streams.scramble)
uniform: Any = njit(random_streams.uniform)
normal: Any = njit(random_streams.normal)
exp_minus: Any = njit(arithmetic.exp_minus)
wedge_probability: Any = njit(arithmetic.wedge_probability)


@njit
def motion_at(settings: np.ndarray, keys: np.ndarray, now: np.uint64) -> tuple:
    """What `move_one` needs in a tick: three keys, dt, half the turn per deviation, speed, noise, border, width and height."""
    return (
        scramble(now, keys[run_columns.TURN]),
        scramble(now, keys[run_columns.EASTWARD]),
        scramble(now, keys[run_columns.NORTHWARD]),
        settings[run_columns.DT],
        settings[run_columns.HALF_TURN],
        settings[run_columns.SPEED],
        settings[run_columns.POSITION_NOISE],
        settings[run_columns.REFLECT] != 0.0,
        settings[run_columns.WIDTH],
        settings[run_columns.HEIGHT],
    )


@njit
def mirrored_one(place: float, velocity: float, length: float) -> tuple[float, float]:
    """Twin of `particles.mirrored` for one coordinate, m, and its velocity, m/s, which turns with every mirror."""
    if place < -length or place > 2.0 * length:
        place %= 2.0 * length
    if place < 0.0:
        return -place, -velocity
    if place > length:
        return 2.0 * length - place, -velocity
    return place, velocity


@njit
def move_one(x: float, y: float, vx: float, vy: float, particle_id: np.uint64, motion: tuple) -> tuple[float, float, float, float, bool]:
    """Twin of `phd.predict` for one particle: x, y in m and vx, vy in m/s one step later, and True if it stays in the arena.

    `motion` is that of `motion_at`.
    """
    turn_salt, east_salt, north_salt, dt, half_turn, speed, position_noise, reflect, width, height = motion
    turn = normal(scramble(particle_id, turn_salt)) * half_turn
    scale = speed / max(math.sqrt(vx * vx + vy * vy), 1e-12)
    cos, sin = (1.0 - turn * turn) / (1.0 + turn * turn), 2.0 * turn / (1.0 + turn * turn)
    vx, vy = (cos * vx - sin * vy) * scale, (sin * vx + cos * vy) * scale
    x = x + vx * dt + normal(scramble(particle_id, east_salt)) * position_noise
    y = y + vy * dt + normal(scramble(particle_id, north_salt)) * position_noise
    if reflect:
        (x, vx), (y, vy) = mirrored_one(x, vx, width), mirrored_one(y, vy, height)
    return x, y, vx, vy, 0.0 <= x <= width and 0.0 <= y <= height


@njit
def blank(number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Uninitialised states, weights, ids and labels of `number` particles."""
    return np.empty((number, 4)), np.empty(number), np.empty(number, np.uint64), np.empty(number, np.uint64)


@cached
def sort_by_id(ids: np.ndarray, order: np.ndarray) -> np.ndarray:
    """The indices `order` (N,), sorted by ascending id; the sort is stable.

    Ids are hashes: their first bits spread them over buckets of about one id each, and an insertion sort orders the rest. Sorted indices
    are returned as they are. Ids that do not spread are sorted by merging.
    """
    count, runs = len(order), 1
    for n in range(1, count):
        runs += ids[order[n]] < ids[order[n - 1]]
    if runs == 1:
        return order
    bits = 1
    while 1 << bits < count:
        bits += 1
    shift = np.uint64(64 - min(bits, _MOST_BITS))
    starts, fullest = np.zeros((1 << min(bits, _MOST_BITS)) + 1, np.int64), 0
    for n in range(count):
        starts[np.int64(ids[order[n]] >> shift) + 1] += 1
    for bucket in range(1, len(starts)):
        fullest = max(fullest, starts[bucket])
        starts[bucket] += starts[bucket - 1]
    if fullest > _FULLEST:
        return sorted_by(ids, order)
    found = np.empty_like(order)
    for n in range(count):
        bucket = np.int64(ids[order[n]] >> shift)
        found[starts[bucket]] = order[n]
        starts[bucket] += 1
    insert(found, count, ids)
    return found


@njit
def wedge(x: float, y: float, sensor: np.ndarray) -> float:
    """Twin of `WedgeSensor.probability` for one point; `sensor` is a row of `GossipTable.table`."""
    shape = sensor[REACH], sensor[COS_HALF]
    return wedge_probability(x - sensor[X], y - sensor[Y], sensor[COS], sensor[SIN], *shape, sensor[PROB], sensor[FAR_PROB])


@njit
def sigma_sensors(sensor: np.ndarray) -> np.ndarray:
    """Twin of `measurement_likelihood.sigma_poses`: the rows (6 or 1, COLUMNS) of the sensor at each of these poses."""
    if sensor[PLACE_NOISE] == 0.0 and sensor[HEADING_NOISE] == 0.0:
        return sensor.copy().reshape(1, -1)
    rows, away = np.empty((6, len(sensor))), POSE_SPREAD * sensor[PLACE_NOISE]
    for k in range(6):
        rows[k] = sensor
    rows[0, X], rows[1, X] = sensor[X] + away, sensor[X] - away
    rows[2, Y], rows[3, Y] = sensor[Y] + away, sensor[Y] - away
    rows[4, COS], rows[4, SIN], rows[5, COS], rows[5, SIN] = sensor[COS_LEFT], sensor[SIN_LEFT], sensor[COS_RIGHT], sensor[SIN_RIGHT]
    return rows


@cached
def in_view(states: np.ndarray, weights: np.ndarray, sensor: np.ndarray) -> tuple[float, float]:
    """Twin of `regions.in_view` for a wedge (10): mass in the footprint, and that mass times p_d, expected targets."""
    load = detected = 0.0
    for n in range(len(weights)):
        probability = wedge(states[n, 0], states[n, 1], sensor)
        load += weights[n] if probability > 0.0 else 0.0
        detected += weights[n] * probability
    return load, detected


@cached
def resample(
    states: np.ndarray,
    weights: np.ndarray,
    ids: np.ndarray,
    labels: np.ndarray,
    mass: float,
    count: int,
    offset: float,
    salt: np.uint64,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Twin of `phd.resample`: states (count, 4), rounded to float32, ids (count,), ascending, and labels; equal ids occur once."""
    chosen, new_ids, parents = np.empty((count, 4)), np.empty(count, np.uint64), np.empty(count, np.int64)
    step = mass / count
    parent, reached, copy, last = 0, weights[0], 0, -1
    for n in range(count):
        mark = (n + offset) * step
        while reached <= mark and parent < len(weights) - 1:
            parent += 1
            reached += weights[parent]
        copy = copy + 1 if parent == last else 0
        last = parent
        new_ids[n] = ids[parent] if copy == 0 else scramble(ids[parent] + np.uint64(copy), salt)
        parents[n] = parent
    order = sort_by_id(new_ids, np.arange(count))
    sorted_ids, sorted_labels, unique = np.empty(count, np.uint64), np.empty(count, np.uint64), 0
    for rank in range(count):
        n = order[rank]
        if rank > 0 and new_ids[n] == new_ids[order[rank - 1]]:
            continue
        sorted_ids[unique], sorted_labels[unique] = new_ids[n], labels[parents[n]]
        for axis in range(4):
            chosen[unique, axis] = np.float64(np.float32(states[parents[n], axis]))
        unique += 1
    return chosen[:unique], sorted_ids[:unique], sorted_labels[:unique]


@cached
def take(
    states: np.ndarray, weights: np.ndarray, ids: np.ndarray, labels: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Twin of `particles.select` and `canonical`: the particles marked in `inside` (N,) bool, in canonical order."""
    chosen, count = np.empty(len(ids), np.int64), 0
    for n in range(len(ids)):
        chosen[count] = n
        count += inside[n]
    order = sort_by_id(ids, chosen[:count])
    (own_states, own_weights, own_ids, own_labels), own = blank(count), 0
    for rank in range(count):
        n = order[rank]
        if rank == 0 or ids[n] != ids[order[rank - 1]]:
            own_states[own], own_weights[own], own_ids[own], own_labels[own] = states[n], weights[n], ids[n], labels[n]
            own += 1
    return own_states[:own], own_weights[:own], own_ids[:own], own_labels[:own]


@cached
def first_moments(states: np.ndarray, weights: np.ndarray) -> tuple[float, float, float]:
    """Twin of `regions.moments`: mass in expected targets, and the mass-weighted sums of x and y in m (17)."""
    mass = east = north = 0.0
    for n in range(len(weights)):
        mass += weights[n]
        east += weights[n] * states[n, 0]
        north += weights[n] * states[n, 1]
    return mass, east, north
