"""The compiled computation of a round: the bit-for-bit twin of `regions.update_regions` for wedges, one call for all owners.

What cannot come near any owner is not even predicted; the rest is sorted and predicted once, and each owner takes its part. What may go
either way is written down and counted without branches, because no processor foresees them. Rules as in `kernels`.
"""

import numpy as np
from numba import njit

from agents.cell_kernels import around, near
from agents.claim_kernels import owned
from agents.extraction_kernels import estimate_targets
from agents.kernels import blank, first_moments, in_view, move_one, resample, scramble, sort_by_id, take
from agents.numba_cache import cached
from agents.update_kernels import update
from agents.words import PARTICLES, WEIGHT

Box = tuple[float, float, float, float]  # west, south, east and north, m
SIZES = 4  # columns: how many particles were updated, are owned and were drawn, and how many targets are reported
SUMS = 5  # columns: mass, its sums of x and y, load and detected

# Columns of the settings, and of the keys to which the tick is still to be added.
DT, HALF_TURN, SPEED, POSITION_NOISE, SURVIVAL, REFLECT, WIDTH, HEIGHT, HALO, STEP, NOISE, GATE2 = range(12)
BIRTHS, COPIES, BIRTH_RADIUS, LEAST_SHARE, MOST_DENSITY, PER_TARGET, LEAST, MOST, BIN, THRESHOLD = range(12, 22)
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
    """Which of these boxes (N, 4) hold any candidate, by their indices in ascending order."""
    west, south, east, north = around(polygon, width)
    found, count = np.empty(len(boxes), np.int64), 0
    for n in range(len(boxes)):
        left, low, right, high = boxes[n]
        near = left <= east and right >= west and low <= north and high >= south
        if near or (left <= x + reach and right >= x - reach and low <= y + reach and high >= y - reach):
            found[count] = n
            count += 1
    return found[:count]


@njit
def _surroundings(corners: np.ndarray, eyes: np.ndarray, width: float, step: float) -> tuple[Box, tuple[float, float, float]]:
    """A box around all cells and a disc (x, y, radius) around all footprints, m; of a single owner just its own."""
    x, y, radius = eyes[0, 0], eyes[0, 1], 0.0
    for k in range(len(eyes)):
        dx, dy = eyes[k, 0] - x, eyes[k, 1] - y
        radius = max(radius, np.sqrt(dx * dx + dy * dy) + (eyes[k, 4] + step))
    return around(corners, width), (x, y, radius)


@njit
def _within(x: float, y: float, box: Box, disc: tuple[float, float, float]) -> bool:
    """Whether a place lies in a box or in a disc."""
    dx, dy = x - disc[0], y - disc[1]
    return ((box[0] <= x) & (x <= box[2]) & (box[1] <= y) & (y <= box[3])) | (dx * dx + dy * dy <= disc[2] * disc[2])


@njit
def _candidates(said: tuple, others: tuple, box: Box, disc: tuple) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the particles in gossips (states float32, ids, and rows that say how many each and their weight) and of others behind them
    (states, weights, ids): those in a box or in a disc, as places, ids and weights."""
    said_states, said_ids, table = said
    states, weights, ids = others
    number, size, count = len(said_ids), len(said_ids) + len(ids), 0
    within, places = np.empty(size, np.bool_), np.empty(size, np.int64)
    for n in range(number):
        within[n] = _within(np.float64(said_states[n, 0]), np.float64(said_states[n, 1]), box, disc)
    for n in range(len(ids)):
        within[number + n] = _within(states[n, 0], states[n, 1], box, disc)
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


@njit
def _predict(said: tuple, others: tuple, box: Box, disc: tuple, motion: tuple) -> tuple:
    """The candidates in ascending order of id: where they were (x, y), and one step on (states, weights, ids)."""
    places, names, masses = _candidates(said, others, box, disc)
    order, number, count = sort_by_id(names, np.arange(len(names))), len(said[1]), len(names)
    x, y = np.empty(count), np.empty(count)
    states, weights, ids = blank(count)
    for rank in range(count):
        k = order[rank]
        n = places[k]
        if n < number:
            x[rank], y[rank] = np.float64(said[0][n, 0]), np.float64(said[0][n, 1])
            vx, vy = np.float64(said[0][n, 2]), np.float64(said[0][n, 3])
        else:
            x[rank], y[rank] = others[0][n - number, 0], others[0][n - number, 1]
            vx, vy = others[0][n - number, 2], others[0][n - number, 3]
        moved = move_one(x[rank], y[rank], vx, vy, names[k], motion)
        states[rank, 0], states[rank, 1], states[rank, 2], states[rank, 3], inside = moved
        weights[rank], ids[rank] = masses[k] * motion[7] if inside else 0.0, names[k]
    return x, y, states, weights, ids


@njit
def _gate(predicted: tuple, births: tuple, polygon: np.ndarray, halo: float, eye: np.ndarray, step: float, room: tuple) -> tuple:
    """Twin of `regions.gate` for one owner: states, weights and ids of the particles near its cell, and of those only in its reach."""
    x, y, moved, kept, names = predicted
    born_states, born_weights, born_ids = births
    within, chosen, states, weights, ids = room
    box, disc, count, known = around(polygon, halo + step), (eye[0], eye[1], eye[4] + step), 0, 0
    for k in range(len(x)):  # without branches, for several at once
        within[k] = _within(x[k], y[k], box, disc)
    for k in range(len(x)):
        chosen[count] = k
        count += within[k]
    for j in range(count):
        k = chosen[j]
        if j > 0 and names[k] == names[chosen[j - 1]]:
            continue
        for axis in range(4):
            states[known, axis] = moved[k, axis]
        weights[known], ids[known] = kept[k], names[k]
        known += 1
    number = known + len(born_ids)
    states[known:number], weights[known:number], ids[known:number] = born_states, born_weights, born_ids
    return _divide(states, weights, ids, known, number, polygon, halo, around(polygon, halo), (eye[0], eye[1]), eye[4])


@njit
def _divide(
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


@njit
def _motion(settings: np.ndarray, keys: np.ndarray, now: np.uint64) -> tuple:
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
def _update_region(
    settings: np.ndarray,
    keys: np.ndarray,
    now: np.uint64,
    eye: np.ndarray,
    table: np.ndarray,
    salts: np.ndarray,
    detections: np.ndarray,
    gated: tuple,
    polygon: np.ndarray,
    generators: np.ndarray,
    first: np.ndarray,
    owner: np.uint64,
    directions: np.ndarray,
) -> tuple:
    """The steps of `regions.update_regions` for one owner once its particles are gated; `eye` is its sensor, a row of numbers."""
    near_states, near_weights, near_ids, far_states, far_weights, _ = gated
    halo = settings[HALO]
    birth = (
        settings[BIRTHS] != 0.0,
        np.int64(settings[COPIES]),
        settings[BIRTH_RADIUS],
        settings[LEAST_SHARE],
        settings[MOST_DENSITY],
        settings[SPEED],
        scramble(now, keys[BIRTH]),
        directions,
    )
    states, weights, ids = update(
        near_states, near_weights, near_ids, table, salts, detections, polygon, halo, settings[NOISE], settings[GATE2], birth
    )
    own_states, own_weights, own_ids = take(states, weights, ids, generators, first, settings[WIDTH], settings[HEIGHT])
    mass, east, north = first_moments(own_states, own_weights)
    near_load, near_detected = in_view(states, weights, eye)
    far_load, far_detected = in_view(far_states, far_weights, eye)
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


@njit
def _append(whole: tuple, size: int, part: tuple, room: int) -> tuple:
    """Particles behind the first `size` ones of others, with more room where it is needed, at least `room`; the first part is the whole."""
    states, weights, ids = whole
    end = size + len(part[2])
    if size == 0:
        return part
    if end > len(ids):
        more = max(2 * end, room)
        wider, heavier, longer = blank(more)
        wider[:size], heavier[:size], longer[:size] = states[:size], weights[:size], ids[:size]
        states, weights, ids = wider, heavier, longer
    states[size:end], weights[size:end], ids[size:end] = part
    return states, weights, ids


@cached
def update_regions(
    settings: np.ndarray,
    keys: np.ndarray,
    tick: int,
    table: np.ndarray,
    salts: np.ndarray,
    detections: np.ndarray,
    said: tuple,
    others: tuple,
    births: tuple,
    eyes: np.ndarray,
    corners: np.ndarray,
    cells: np.ndarray,
    generators: np.ndarray,
    first: np.ndarray,
    claims: np.ndarray,
    draws: np.ndarray,
    directions: np.ndarray,
) -> tuple:
    """What K owners make of their parts: updated, own and drawn particles and targets (T, 2), each owner after owner, where those of each
    end (K, SIZES), and sums (K, SUMS).

    `eyes` (K, 7) are the owners' sensors, `cells` and `claims` (K + 1,) say where the corners and the generators of each begin, `draws`
    (K,) are the keys of their draws.
    """
    now, number, halo, step = np.uint64(tick), len(eyes), settings[HALO], settings[STEP]
    box, disc = _surroundings(corners, eyes, halo + step, step)
    predicted = _predict(said, others, box, disc, _motion(settings, keys, now))
    count = len(predicted[0])
    size = count + len(births[2])
    room = np.empty(count, np.bool_), np.empty(count + 1, np.int64), *blank(size)
    updated, own, kept, targets = blank(0), blank(0), blank(0), np.empty((0, 2))
    ends, sums = np.zeros((number + 1, SIZES), np.int64), np.zeros((number, SUMS))
    for k in range(number):
        polygon, claimed = corners[cells[k] : cells[k + 1]], slice(claims[k], claims[k + 1])
        gated = _gate(predicted, births, polygon, halo, eyes[k], step, room)
        claim = generators[claimed], first[claimed]
        found = _update_region(
            settings, keys, now, eyes[k], table, salts, detections, gated, polygon, claim[0], claim[1], draws[k], directions
        )
        start = ends[k]
        updated, own = _append(updated, start[0], found[0], 2 * size), _append(own, start[1], found[1], 2 * size)
        kept = _append(kept, start[2], found[2], 2 * size)
        targets = np.concatenate((targets, found[8])) if k > 0 else found[8]
        ends[k + 1] = start + np.array([len(found[0][2]), len(found[1][2]), len(found[2][2]), len(found[8])])
        sums[k] = np.array([found[3], found[4], found[5], found[6], found[7]])
    return updated, own, kept, targets, ends, sums
