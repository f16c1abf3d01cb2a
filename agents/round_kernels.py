"""The compiled round: the steps of `arithmetic.in_steps` in one call, from the particles as they came to what an owner makes of them.

One call instead of ten: what lies between the steps stays in compiled code. Rules as in `kernels`.
"""

import numpy as np
from numba import njit

from agents.cell_kernels import around
from agents.claim_kernels import owned
from agents.extraction_kernels import estimate_targets
from agents.gather_kernels import gather
from agents.kernels import first_moments, in_view, resample, scramble, take
from agents.numba_cache import cached
from agents.update_kernels import update

# Columns of the settings, and of the keys to which the tick is still to be added.
DT, HALF_TURN, SPEED, POSITION_NOISE, SURVIVAL, REFLECT, WIDTH, HEIGHT, HALO, STEP, NOISE, LIKELIHOOD_NOISE, GATE2 = range(13)
CERTAINTY, MISS_BIN, BIRTHS, COPIES, BIRTH_RADIUS, LEAST_DENSITY, LEAST_SHARE, MOST_DENSITY = range(13, 21)
PER_TARGET, LEAST, MOST, BIN, THRESHOLD = range(21, 26)
TURN, EASTWARD, NORTHWARD, BIRTH, SPLIT = range(5)

_S11 = np.uint64(11)


@cached
def box(states: np.ndarray) -> np.ndarray:
    """West, south, east and north of some particles, (4,) m; inside out when there are none."""
    limits = np.array([np.inf, np.inf, -np.inf, -np.inf])
    for n in range(len(states)):
        x, y = np.float64(states[n, 0]), np.float64(states[n, 1])
        limits[0], limits[2] = min(limits[0], x), max(limits[2], x)
        limits[1], limits[3] = min(limits[1], y), max(limits[3], y)
    return limits


@cached
def touching(boxes: np.ndarray, polygon: np.ndarray, width: float, x: float, y: float, reach: float) -> np.ndarray:
    """Which of these boxes (N, 4) hold anything that `gather` could choose, by their indices in ascending order."""
    west, south, east, north = around(polygon, width)
    found, count = np.empty(len(boxes), np.int64), 0
    for n in range(len(boxes)):
        left, low, right, high = boxes[n]
        near = left <= east and right >= west and low <= north and high >= south
        if near or (left <= x + reach and right >= x - reach and low <= y + reach and high >= y - reach):
            found[count] = n
            count += 1
    return found[:count]


@cached
def refresh(
    settings: np.ndarray,
    keys: np.ndarray,
    tick: int,
    mine: int,
    table: np.ndarray,
    salts: np.ndarray,
    detections: np.ndarray,
    said: tuple,
    told: tuple,
    births: tuple,
    polygon: np.ndarray,
    generators: np.ndarray,
    first: np.ndarray,
    owner: np.uint64,
    directions: np.ndarray,
) -> tuple:
    """Twin of `arithmetic.in_steps` for wedges: the arrays and numbers of `Refreshed`; `mine` is the own row of the table."""
    now = np.uint64(tick)
    sensor, halo, step = table[mine], settings[HALO], settings[STEP]
    eye, reach = (sensor[0], sensor[1]), sensor[4]
    close_by = gather(said, told, births, polygon, halo, eye, reach, step, motion_of(settings, keys, now))
    return correct(settings, keys, now, mine, table, salts, detections, close_by, polygon, generators, first, owner, directions)


@njit
def motion_of(settings: np.ndarray, keys: np.ndarray, now: np.uint64) -> tuple:
    """`fast.motion` of a tick."""
    return (
        scramble(now, keys[TURN]),
        scramble(now, keys[EASTWARD]),
        scramble(now, keys[NORTHWARD]),
        settings[DT],
        settings[HALF_TURN],
        settings[SPEED],
        settings[POSITION_NOISE],
        settings[SURVIVAL],
        settings[REFLECT] != 0.0,
        settings[WIDTH],
        settings[HEIGHT],
    )


@njit
def correct(
    settings: np.ndarray,
    keys: np.ndarray,
    now: np.uint64,
    mine: int,
    table: np.ndarray,
    salts: np.ndarray,
    detections: np.ndarray,
    close_by: tuple,
    polygon: np.ndarray,
    generators: np.ndarray,
    first: np.ndarray,
    owner: np.uint64,
    directions: np.ndarray,
) -> tuple:
    """The rest of a `refresh`, when the particles around a cell are known (those of `gather`)."""
    near_states, near_weights, near_ids, far_states, far_weights, _ = close_by
    sensor, halo = table[mine], settings[HALO]
    birth = (
        settings[BIRTHS] != 0.0,
        np.int64(settings[COPIES]),
        settings[BIRTH_RADIUS],
        settings[LEAST_DENSITY],
        settings[LEAST_SHARE],
        settings[MOST_DENSITY],
        settings[SPEED],
        scramble(now, keys[BIRTH]),
        directions,
    )
    noise, miss = (settings[NOISE], settings[LIKELIHOOD_NOISE], settings[GATE2]), (settings[CERTAINTY], settings[MISS_BIN])
    states, weights, ids = update(near_states, near_weights, near_ids, table, salts, detections, polygon, halo, noise, miss, birth)
    own_states, own_weights, own_ids = take(states, weights, ids, generators, first, settings[WIDTH], settings[HEIGHT])
    mass, east, north = first_moments(own_states, own_weights)
    near_load, near_detected = in_view(states, weights, sensor)
    far_load, far_detected = in_view(far_states, far_weights, sensor)
    kept_states, kept_ids, each = np.empty((0, 4)), np.empty(0, np.uint64), 0.0
    if mass > 0.0:
        count = int(min(max(np.rint(settings[PER_TARGET] * mass), settings[LEAST]), settings[MOST]))
        offset = np.float64(scramble(now, owner) >> _S11) * 2.0**-53
        kept_states, kept_ids = resample(own_states, own_weights, own_ids, mass, count, offset, scramble(now, keys[SPLIT]))
        each = mass / count
    targets = np.empty((0, 2))
    if len(generators) > 0 and len(weights) > 0:
        targets = estimate_targets(states, weights, settings[BIN], settings[THRESHOLD])
        targets = targets[owned(targets, generators, first, settings[WIDTH], settings[HEIGHT])]
    updated, own, kept = (states, weights, ids), (own_states, own_weights, own_ids), (kept_states, np.full(len(kept_ids), each), kept_ids)
    return updated, own, kept, mass, east, north, near_load + far_load, near_detected + far_detected, targets
