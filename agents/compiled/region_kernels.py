"""The compiled computation of a round: the bit-for-bit twin of `regions.update_regions` for wedges, one call for all owners.

Data types: a result is a row of SIZES and SUMS columns. The stated particles are states (N, 4) float32, ids and labels (N,), and the rows
of the gossip table that state them.

Rules as in agents/compiled/particle_kernels.py. Particles that cannot come near an owner are not predicted. The others are sorted and
predicted once, and each owner gates its part. Filters write each index and advance the count without branches, because such branches
are unpredictable.
"""

import numpy as np
from numba import njit

from agents.compiled import run_columns
from agents.compiled.cache import cached
from agents.compiled.cell_kernels import around, near
from agents.compiled.claim_kernels import owned
from agents.compiled.correction_kernels import correct
from agents.compiled.extraction_kernels import ESTIMATE, estimate_targets
from agents.compiled.label_kernels import rename, stamp_of
from agents.compiled.particle_kernels import (
    blank,
    first_moments,
    in_view,
    motion_at,
    move_one,
    resample,
    scramble,
    sort_by_id,
    take,
    uniform,
)
from agents.gossip.table import PARTICLES, REACH, WEIGHT, X, Y
from protocol.gaussian_components import MOST_OWN_MASS

BoxLimits = tuple[float, float, float, float]  # west, south, east and north, m
SIZES = 4  # first columns of a result: the numbers of updated, own and resampled particles, and of estimated targets
SUMS = 5  # next columns: mass, its sums of x and y, load and detected


@njit
def _surroundings(
    corners: np.ndarray, table: np.ndarray, spans: np.ndarray, width: float, step: float
) -> tuple[BoxLimits, tuple[float, float, float]]:
    """A box around all cells and a disc (x, y, radius) around all footprints, m; for a single owner its own box and footprint."""
    x, y, radius = table[spans[0, 0], X], table[spans[0, 0], Y], 0.0
    for k in range(len(spans)):
        sensor = table[spans[k, 0]]
        dx, dy = sensor[X] - x, sensor[Y] - y
        radius = max(radius, np.sqrt(dx * dx + dy * dy) + (sensor[REACH] + step))
    return around(corners, width), (x, y, radius)


@njit
def _within(x: float, y: float, box: BoxLimits, disc: tuple[float, float, float]) -> bool:
    """True for a point in the box or in the disc."""
    dx, dy = x - disc[0], y - disc[1]
    return ((box[0] <= x) & (x <= box[2]) & (box[1] <= y) & (y <= box[3])) | (dx * dx + dy * dy <= disc[2] * disc[2])


@njit
def _candidates(stated: tuple, others: tuple, box: BoxLimits, disc: tuple) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices, ids and weights of the particles in the box or in the disc: the stated ones, then the others.

    The stated particles are (states float32, ids, labels, rows of the table with their numbers and weights). The others are (states,
    weights, ids, labels), and their indices continue those of the stated ones.
    """
    gossip_states, gossip_ids, _, table = stated
    states, weights, ids, _ = others
    number, size, count = len(gossip_ids), len(gossip_ids) + len(ids), 0
    within, places = np.empty(size, np.bool_), np.empty(size, np.int64)
    for n in range(number):
        within[n] = _within(np.float64(gossip_states[n, 0]), np.float64(gossip_states[n, 1]), box, disc)
    for n in range(len(ids)):
        within[number + n] = _within(states[n, 0], states[n, 1], box, disc)
    for n in range(size):
        places[count] = n
        count += within[n]
    candidate_ids, masses, row, end = np.empty(count, np.uint64), np.empty(count), -1, 0
    for k in range(count):
        n = places[k]
        if n >= number:
            candidate_ids[k], masses[k] = ids[n - number], weights[n - number]
            continue
        while n >= end:
            row += 1
            end += int(table[row, PARTICLES])
        candidate_ids[k], masses[k] = gossip_ids[n], table[row, WEIGHT]
    return places[:count], candidate_ids, masses


@njit
def _predict(stated: tuple, others: tuple, births: tuple, box: BoxLimits, disc: tuple, motion: tuple, survival: float) -> tuple:
    """The candidates one step later, each id once and ids ascending, then the births: x, y, states, weights, ids, labels.

    The seventh value is the number of particles before the births.
    """
    places, candidate_ids, masses = _candidates(stated, others, box, disc)
    order, number, born, known = sort_by_id(candidate_ids, np.arange(len(candidate_ids))), len(stated[1]), len(births[2]), 0
    states, weights, ids, labels = blank(len(candidate_ids) + born)
    for rank in range(len(candidate_ids)):
        k = order[rank]
        if rank > 0 and candidate_ids[k] == candidate_ids[order[rank - 1]]:
            continue
        n = places[k]
        if n < number:
            x, y, vx, vy = stated[0][n, 0], stated[0][n, 1], stated[0][n, 2], stated[0][n, 3]
            moved = move_one(np.float64(x), np.float64(y), np.float64(vx), np.float64(vy), candidate_ids[k], motion)
            labels[known] = stated[2][n]
        else:
            n -= number
            moved = move_one(others[0][n, 0], others[0][n, 1], others[0][n, 2], others[0][n, 3], candidate_ids[k], motion)
            labels[known] = others[3][n]
        states[known, 0], states[known, 1], states[known, 2], states[known, 3], inside = moved
        weights[known], ids[known] = masses[k] * survival if inside else 0.0, candidate_ids[k]
        known += 1
    end = known + born
    for k in range(born):  # numba takes seconds to compile an assignment of arrays whose shapes it must check
        for column in range(4):
            states[known + k, column] = births[0][k, column]
        weights[known + k], ids[known + k], labels[known + k] = births[1][k], births[2][k], births[3][k]
    return states[:end, 0].copy(), states[:end, 1].copy(), states, weights, ids, labels, known


@njit
def _split_by_halo(predicted: tuple, polygon: np.ndarray, halo: float, sensor: np.ndarray, scratch: tuple) -> tuple:
    """Twin of `regions.split_by_halo`: states, weights, ids and labels of the particles within the halo, and of the others within reach."""
    x, y, states, weights, ids, labels, known = predicted
    boxed, seen, rows, some = scratch
    west, south, east, north = around(polygon, halo)
    far2, count, boxes, near_count, far_count = sensor[REACH] * sensor[REACH], 0, 0, 0, 0
    for n in range(len(x)):  # without branches, for several at once
        dx, dy = x[n] - sensor[X], y[n] - sensor[Y]
        boxed[n] = (west <= x[n]) & (x[n] <= east) & (south <= y[n]) & (y[n] <= north)
        seen[n] = dx * dx + dy * dy <= far2
    for n in range(len(x)):
        rows[count] = n
        count += boxed[n] | seen[n]
    for k in range(count):
        some[boxes] = rows[k]
        boxes += boxed[rows[k]]
    close = near(polygon, x[some[:boxes]], y[some[:boxes]], halo)
    for k in range(boxes):
        some[near_count] = some[k]
        near_count += close[k]
    near_rows = some[:near_count]
    for k in range(near_count):
        seen[near_rows[k]] = False
    for k in range(count):
        n = rows[k]
        rows[far_count] = n
        far_count += seen[n] & (n < known)
    return *_rows(near_rows, states, weights, ids, labels), *_rows(rows[:far_count], states, weights, ids, labels)


@njit
def _rows(
    rows: np.ndarray, states: np.ndarray, weights: np.ndarray, ids: np.ndarray, labels: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """States, weights, ids and labels of the particles at the indices `rows`."""
    some_states, some_weights, some_ids, some_labels = blank(len(rows))
    for k in range(len(rows)):
        n = rows[k]
        for axis in range(4):
            some_states[k, axis] = states[n, axis]
        some_weights[k], some_ids[k], some_labels[k] = weights[n], ids[n], labels[n]
    return some_states, some_weights, some_ids, some_labels


@njit
def _update_region(
    settings: np.ndarray,
    keys: np.ndarray,
    now: np.uint64,
    sensor: np.ndarray,
    table: np.ndarray,
    salts: np.ndarray,
    detections: np.ndarray,
    rays: np.ndarray,
    parted: tuple,
    polygon: np.ndarray,
    generators: np.ndarray,
    wins_ties: np.ndarray,
    owner: np.uint64,
    directions: np.ndarray,
) -> tuple:
    """The fields of a `tracker.RegionUpdate` for one owner from its particles, parted by the halo; `sensor` is its row of the table."""
    near_states, near_weights, near_ids, near_labels, far_states, far_weights, _, _ = parted
    near, births_key, stamp = (near_states, near_weights, near_ids, near_labels), scramble(now, keys[run_columns.BIRTH]), stamp_of(now)
    states, weights, ids, labels = correct(near, table, salts, detections, rays, polygon, settings, births_key, directions, stamp)
    width, height, side = settings[run_columns.WIDTH], settings[run_columns.HEIGHT], settings[run_columns.BIN]
    mine = owned(states, generators, wins_ties, width, height)
    targets, names = np.empty((0, ESTIMATE)), np.empty(0, np.uint64)
    if len(generators) > 0 and len(weights) > 0:
        targets, names = estimate_targets(
            states, weights, labels, side, settings[run_columns.THRESHOLD], settings[run_columns.BESIDE], stamp
        )
        inside = owned(targets, generators, wins_ties, width, height)
        targets, names = targets[inside], names[inside]
        labels = rename((states, weights, labels), mine, (near_weights, near_labels), targets, side)
    own = take(states, weights, ids, labels, mine)
    own_states, own_weights, own_ids, own_labels = own
    mass, moment_x, moment_y = first_moments(own_states, own_weights)
    near_load, near_detected = in_view(states, weights, sensor)
    far_load, far_detected = in_view(far_states, far_weights, sensor)
    drawn_states, drawn_ids, drawn_labels, each = np.empty((0, 4)), np.empty(0, np.uint64), np.empty(0, np.uint64), 0.0
    if mass > 0.0:
        count = int(min(max(np.rint(settings[run_columns.PER_TARGET] * mass), settings[run_columns.LEAST]), settings[run_columns.MOST]))
        offset = uniform(scramble(now, owner))
        resampled = resample(own_states, own_weights, own_ids, own_labels, mass, count, offset, scramble(now, keys[run_columns.SPLIT]))
        drawn_states, drawn_ids, drawn_labels = resampled
        each = min(mass, MOST_OWN_MASS) / count
    drawn = drawn_states, np.full(len(drawn_ids), each), drawn_ids, drawn_labels
    sums = mass, moment_x, moment_y, near_load + far_load, near_detected + far_detected
    return (states, weights, ids, labels), own, drawn, sums, targets, names


@njit
def _append(whole: tuple, size: int, part: tuple, least: int) -> tuple:
    """The first `size` particles of `whole` with `part` behind them; the first part becomes the whole.

    Arrays that are too small grow to `least` particles or more.
    """
    states, weights, ids, labels = whole
    end = size + len(part[2])
    if size == 0:
        return part
    if end > len(ids):
        more = max(2 * end, least)
        wider, heavier, longer, named = blank(more)
        wider[:size], heavier[:size], longer[:size], named[:size] = states[:size], weights[:size], ids[:size], labels[:size]
        states, weights, ids, labels = wider, heavier, longer, named
    states[size:end], weights[size:end], ids[size:end], labels[size:end] = part
    return states, weights, ids, labels


@cached
def update_regions(
    settings: np.ndarray,
    keys: np.ndarray,
    tick: int,
    table: np.ndarray,
    salts: np.ndarray,
    detections: np.ndarray,
    rays: np.ndarray,
    stated: tuple,
    others: tuple,
    births: tuple,
    spans: np.ndarray,
    corners: np.ndarray,
    generators: np.ndarray,
    wins_ties: np.ndarray,
    draws: np.ndarray,
    directions: np.ndarray,
) -> tuple:
    """Twin of `regions.update_regions`: updated, own and resampled particles, estimates and their labels, owner after owner, and results.

    An estimate (ESTIMATE columns) is x, y in m and the columns of `extraction.TargetEstimates.details`.

    The results (K, SIZES + SUMS) hold the sizes and sums of K owners. `spans` (K, 3) are the row of each owner in the table, its number of
    corners and its number of generators. `draws` (K,) are the keys of the resampling of each owner.
    """
    now, number, halo, step = np.uint64(tick), len(spans), settings[run_columns.HALO], settings[run_columns.STEP]
    box, disc = _surroundings(corners, table, spans, halo + step, step)
    predicted = _predict(stated, others, births, box, disc, motion_at(settings, keys, now), settings[run_columns.SURVIVAL])
    size = len(predicted[0])
    scratch = np.empty(size, np.bool_), np.empty(size, np.bool_), np.empty(size + 1, np.int64), np.empty(size + 1, np.int64)
    updated, own, drawn, targets, names = blank(0), blank(0), blank(0), np.empty((0, ESTIMATE)), np.empty(0, np.uint64)
    results, start = np.empty((number, SIZES + SUMS)), np.zeros(SIZES, np.int64)
    corner = bound = 0
    for k in range(number):
        sensor, polygon = table[spans[k, 0]], corners[corner : corner + spans[k, 1]]
        claimed = slice(bound, bound + spans[k, 2])
        corner, bound = corner + spans[k, 1], bound + spans[k, 2]
        parted = _split_by_halo(predicted, polygon, halo, sensor, scratch)
        claim = generators[claimed], wins_ties[claimed]
        found = _update_region(
            settings, keys, now, sensor, table, salts, detections, rays, parted, polygon, claim[0], claim[1], draws[k], directions
        )
        updated, own = _append(updated, start[0], found[0], 2 * size), _append(own, start[1], found[1], 2 * size)
        drawn = _append(drawn, start[2], found[2], 2 * size)
        targets, names = (np.concatenate((targets, found[4])), np.concatenate((names, found[5]))) if k > 0 else (found[4], found[5])
        sizes = len(found[0][2]), len(found[1][2]), len(found[2][2]), len(found[5])
        for column in range(SIZES):
            start[column] += sizes[column]
            results[k, column] = sizes[column]
        for column, value in enumerate(found[3]):
            results[k, SIZES + column] = value
    return updated, own, drawn, targets, names, results
