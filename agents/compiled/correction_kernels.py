"""The compiled corrector: the bit-for-bit twin of `regions.correct`.

Data types: the settings of a run are an array (agents/compiled/run_columns.py).

Rules as in agents/compiled/particle_kernels.py. Work on several particles at once stands in loops of its own without branches, so that
the compiler emits vector instructions.
"""

import math

import numpy as np
from numba import njit

from agents.compiled import run_columns
from agents.compiled.birth_kernels import add_births, birth_densities, close_by, nearby
from agents.compiled.cache import cached
from agents.compiled.cell_kernels import around, distance
from agents.compiled.extraction_kernels import block
from agents.compiled.label_kernels import birth_label, label_scan
from agents.compiled.measuring_kernels import has_rays, noise_of
from agents.compiled.measuring_kernels import pairs as ray_pairs
from agents.compiled.particle_kernels import blank, exp_minus, scramble, sigma_sensors, wedge, wedge_probability
from agents.gossip.table import (
    CLUTTER_DENSITY,
    COS,
    COS_HALF,
    DETECTIONS,
    FAR_PROB,
    KIND,
    MODEL,
    NO_SCAN,
    PROB,
    REACH,
    SIN,
    X,
    Y,
)
from agents.tracking.measurement_likelihood import BEARING, LARGEST_DEVIATION, Noise


@njit
def _raster(
    x: np.ndarray, y: np.ndarray, detections: np.ndarray, spreads: np.ndarray, table: np.ndarray, sensors: np.ndarray, settings: np.ndarray
) -> tuple:
    """The grid of bins for `_missed`: its first column, its first row, masses, explained masses, their rests and shares.

    It covers the particles that a scan, a row of `table` in `sensors`, can see, the detections, and births within `spreads` (M,) m of them,
    which are all `close_by`.
    """
    side = settings[run_columns.MISS_BIN]
    west, south, east, north = _box_in_reach(x, y, table, sensors, side)
    for m in range(len(detections)):
        px, py, spread = detections[m, 0], detections[m, 1], spreads[m]
        least, most = close_by(px - spread, py - spread, settings), close_by(px + spread, py + spread, settings)
        west, south, east, north = min(west, px, least[0]), min(south, py, least[1]), max(east, px, most[0]), max(north, py, most[1])
    if west > east or south > north:
        return 0, 0, np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1))
    left, low = np.int64(math.floor(west / side)) - 2, np.int64(math.floor(south / side)) - 2
    shape = np.int64(math.floor(north / side)) - low + 3, np.int64(math.floor(east / side)) - left + 3
    return left, low, np.zeros(shape), np.zeros(shape), np.full(shape, -1.0), np.empty(shape)


@njit
def _box_in_reach(x: np.ndarray, y: np.ndarray, table: np.ndarray, sensors: np.ndarray, margin: float) -> tuple[float, float, float, float]:
    """The box, west, south, east, north, around the points of the box around particles that scans reach, or almost; else an empty one."""
    west, south, east, north = math.inf, math.inf, -math.inf, -math.inf
    for n in range(len(x)):
        west, south, east, north = min(west, x[n]), min(south, y[n]), max(east, x[n]), max(north, y[n])
    first_x, first_y, last_x, last_y = math.inf, math.inf, -math.inf, -math.inf
    for s in sensors:
        for row in sigma_sensors(table[s]):
            wide = row[REACH] + margin
            first_x, first_y = min(first_x, row[X] - wide), min(first_y, row[Y] - wide)
            last_x, last_y = max(last_x, row[X] + wide), max(last_y, row[Y] + wide)
    return max(west, first_x), max(south, first_y), min(east, last_x), min(north, last_y)


@njit
def _bin(x: float, y: float, side: float, left: int, low: int) -> tuple[int, int]:
    """Column and row of a point in the grid of `_raster`."""
    return np.int64(math.floor(x / side)) - left, np.int64(math.floor(y / side)) - low


@cached
def _missed(
    columns: np.ndarray,
    rows: np.ndarray,
    weights: np.ndarray,
    probabilities: np.ndarray,
    gained: np.ndarray,
    seen: np.ndarray,
    points: np.ndarray,
    born: np.ndarray,
    settings: np.ndarray,
    raster: tuple,
) -> None:
    """Twin of `phd.missed`: multiply the weights of the rows in view, `seen`, by their factors.

    `columns` and `rows` (N,) are the bins of all particles. The raster is restored for the next scan.
    """
    certainty, side = settings[run_columns.CERTAINTY], settings[run_columns.MISS_BIN]
    left, low, masses, explained, rests, shares = raster
    for n in seen:
        masses[rows[n], columns[n]] += weights[n]
        explained[rows[n], columns[n]] += gained[n]
    for m in range(len(points)):
        column, row = _bin(points[m, 0], points[m, 1], side, left, low)
        explained[row, column] += born[m]
    for n in seen:
        row, column, probability = rows[n], columns[n], probabilities[n]
        if rests[row, column] < 0.0:
            mass = block(masses, row, column)
            rests[row, column] = max(mass - block(explained, row, column), 0.0)
            shares[row, column] = rests[row, column] / (mass if mass > 0.0 else 1.0)
        odds = (1.0 - probability) / (1.0 - probability * min(rests[row, column], certainty))
        weights[n] = weights[n] * (shares[row, column] * odds)
    for n in seen:
        masses[rows[n], columns[n]], explained[rows[n], columns[n]], rests[rows[n], columns[n]] = 0.0, 0.0, -1.0
    for m in range(len(points)):
        column, row = _bin(points[m, 0], points[m, 1], side, left, low)
        explained[row, column] = 0.0


@cached
def _probabilities(x: np.ndarray, y: np.ndarray, sensors: np.ndarray, probabilities: np.ndarray, seen: np.ndarray) -> int:
    """Twin of `births.Scan.probability` for a wedge: write p_d of points into `probabilities` (N,), the mean over `sigma_sensors`.

    Writes the rows with p_d > 0 into `seen` (N,). Returns the number of these rows.
    """
    probabilities[: len(x)] = 0.0
    for k in range(len(sensors)):
        _add_view(x, y, sensors[k], probabilities)
    number = 0
    for n in range(len(x)):
        probabilities[n] /= np.float64(len(sensors))
        seen[number] = n
        number += probabilities[n] > 0.0
    return number


@njit
def _add_view(x: np.ndarray, y: np.ndarray, sensor: np.ndarray, probabilities: np.ndarray) -> None:
    """Add p_d of points, of a row of `GossipTable.table`, to `probabilities` (N,); without branches, for several at once."""
    sensor_x, sensor_y, cos, sin = sensor[X], sensor[Y], sensor[COS], sensor[SIN]
    reach, cos_half, near, far = sensor[REACH], sensor[COS_HALF], sensor[PROB], sensor[FAR_PROB]
    for n in range(len(x)):
        probabilities[n] += wedge_probability(x[n] - sensor_x, y[n] - sensor_y, cos, sin, reach, cos_half, near, far)


@njit
def _seen(x: float, y: float, sensors: np.ndarray) -> float:
    """p_d of one point, the mean over `sigma_sensors`."""
    found = 0.0
    for k in range(len(sensors)):
        found += wedge(x, y, sensors[k])
    return found / np.float64(len(sensors))


@cached
def _pairs(
    x: np.ndarray,
    y: np.ndarray,
    weights: np.ndarray,
    probabilities: np.ndarray,
    detections: np.ndarray,
    gate2: float,
    found: tuple,
) -> int:
    """The number of pairs of a particle, all of them in view, and a detection within its gate, or -1 if `found` may be too small.

    Each pair is written into `found`: row of the particle, number of the detection, squared distance in m^2, weight times p_d.
    """
    rows, columns, squares, terms = found
    number, pairs = len(x), 0
    apart = np.empty(number)
    for m in range(len(detections)):
        at_x, at_y = detections[m, 0], detections[m, 1]
        for n in range(number):
            dx, dy = x[n] - at_x, y[n] - at_y
            apart[n] = dx * dx + dy * dy
        if pairs + number > len(rows):
            return -1
        for n in range(number):  # the next pair overwrites a miss
            rows[pairs], columns[pairs], squares[pairs], terms[pairs] = n, m, apart[n], weights[n] * probabilities[n]
            pairs += apart[n] <= gate2
    return pairs


@cached
def _pair_buffers(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Uninitialised arrays for `size` pairs: rows, detections, squared distances and terms."""
    return np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size), np.empty(size)


@cached
def _likelihoods(squares: np.ndarray, terms: np.ndarray, noise: float) -> None:
    """Multiply terms by the Gaussian density, per m^2, at squared distances in m^2."""
    scale, exponent_scale = 1.0 / (2.0 * math.pi * noise * noise), 0.5 / (noise * noise)
    for p in range(len(squares)):
        terms[p] = terms[p] * (exp_minus(squares[p] * exponent_scale) * scale)


@njit
def _scans(table: np.ndarray, polygon: np.ndarray, box: tuple[float, float, float, float], halo: float) -> tuple[np.ndarray, np.ndarray]:
    """The rows of the table whose scans reach the halo of the cell, and the first detection of each.

    The rows are sorted by ascending p_d, equal ones in the order of the table. `box` is the box around the cell.
    """
    sensors, begins = np.empty(len(table), np.int64), np.empty(len(table), np.int64)
    scans = first = 0
    for s in range(len(table)):
        row = table[s]
        x, y, width = row[X], row[Y], halo + row[REACH]
        if row[KIND] != NO_SCAN and not _beyond(box, x, y, width) and distance(polygon, x, y) <= width:
            place = scans
            while place > 0 and table[sensors[place - 1], PROB] > row[PROB]:
                sensors[place], begins[place] = sensors[place - 1], begins[place - 1]
                place -= 1
            sensors[place], begins[place] = s, first
            scans += 1
        first += np.int64(row[DETECTIONS])
    return sensors[:scans], begins[:scans]


@njit
def _pick(
    row: np.ndarray,
    first: int,
    polygon: np.ndarray,
    box: tuple[float, float, float, float],
    halo: float,
    detections: np.ndarray,
    picked: np.ndarray,
    count: int,
) -> int:
    """The new count of `picked` after the detections of a scan within the halo of the cell; `box` is the box around the cell."""
    for m in range(first, first + np.int64(row[DETECTIONS])):
        x, y = detections[m, 0], detections[m, 1]
        if row[MODEL] == BEARING or (not _beyond(box, x, y, halo) and distance(polygon, x, y) <= halo):
            picked[count] = m
            count += 1
    return count


@njit
def _beyond(box: tuple[float, float, float, float], x: float, y: float, width: float) -> bool:
    """True only for a point farther than `width` m from a box, and so from all points in it."""
    west, south, east, north = box
    wide = width + 1e-6
    return x < west - wide or x > east + wide or y < south - wide or y > north + wide


@njit
def _scans_in_reach(
    table: np.ndarray, all_detections: np.ndarray, all_rays: np.ndarray, polygon: np.ndarray, settings: np.ndarray
) -> tuple:
    """The scans that reach the halo of the cell, and their detections in it, scan after scan.

    These are the rows of the scans in the table (S,), the first detections of these rows (S,), the starts (S + 1,) of the scans among the
    detections in the halo, the numbers (M,), places (M, 2) and rays of those, and how far births may lie from them, m (M,).
    """
    box, halo = around(polygon, 0.0), settings[run_columns.HALO]
    sensors, begins = _scans(table, polygon, box, halo)
    starts, picked, close = np.zeros(len(sensors) + 1, np.int64), np.empty(len(all_detections), np.int64), 0
    for s in range(len(sensors)):
        close = starts[s + 1] = _pick(table[sensors[s]], begins[s], polygon, box, halo, all_detections, picked, close)
    detections, rays = np.empty((close, 2)), np.empty((close, all_rays.shape[1]))
    for m in range(close):
        detections[m], rays[m] = all_detections[picked[m]], all_rays[picked[m]]
    spreads = np.full(close, LARGEST_DEVIATION * settings[run_columns.NOISE])
    for s in range(len(sensors)):
        if has_rays(table[sensors[s]]):
            spreads[starts[s] : starts[s + 1]] = rays[starts[s] : starts[s + 1], 3]
    return sensors, begins, starts, picked[:close], detections, rays, spreads


@njit
def _gated_terms(
    seen: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    weights: np.ndarray,
    probabilities: np.ndarray,
    sensor: np.ndarray,
    points: np.ndarray,
    rays: np.ndarray,
    noise: Noise,
    settings: np.ndarray,
    found: tuple,
) -> tuple[int, tuple]:
    """The number of pairs of a particle in view, `seen`, and a detection within its gate, and the arrays that hold these pairs.

    The arrays are `found`, or longer ones: row of the particle, number of the detection, squared distance, and term w p_d g(z).
    """
    seen_x, seen_y, seen_weights, seen_probabilities = x[seen], y[seen], weights[seen], probabilities[seen]
    with_rays, pairs = has_rays(sensor), -1
    while pairs < 0:
        if with_rays:
            pairs = ray_pairs(seen_x, seen_y, seen_probabilities, sensor, points, rays, noise, settings[run_columns.GATE], found)
        else:
            pairs = _pairs(seen_x, seen_y, seen_weights, seen_probabilities, points, settings[run_columns.GATE2], found)
        if pairs < 0:
            found = _pair_buffers(4 * len(found[0]))
    rows, _, squares, terms = found
    if with_rays:
        for p in range(pairs):
            terms[p] = seen_weights[rows[p]] * seen_probabilities[rows[p]] * (exp_minus(squares[p] * 0.5) * terms[p])
    else:
        _likelihoods(squares[:pairs], terms[:pairs], settings[run_columns.LIKELIHOOD_NOISE])
    for p in range(pairs):
        rows[p] = seen[rows[p]]
    return pairs, found


@njit
def _normalisers(
    points: np.ndarray,
    columns: np.ndarray,
    terms: np.ndarray,
    born: np.ndarray,
    sensor: np.ndarray,
    sigma_rows: np.ndarray,
    settings: np.ndarray,
) -> np.ndarray:
    """The sums N(z) (M,) of clutter, births and terms at the detections of a scan; weights of births replace the masses in `born` (M,).

    A term belongs to the detection whose number is in `columns`.
    """
    norms = np.zeros(len(points))
    for p in range(len(terms)):
        norms[columns[p]] += terms[p]
    if settings[run_columns.BIRTHS] != 0.0:
        birth_densities(points, norms, sensor, born, settings)
    for m in range(len(points)):
        fresh = _seen(points[m, 0], points[m, 1], sigma_rows) * born[m]
        norm = sensor[CLUTTER_DENSITY] + fresh + norms[m]
        norms[m] = norm if norm > 0.0 else 1.0
        born[m] = fresh / norms[m]
    return norms


@cached
def correct(
    particles: tuple,
    table: np.ndarray,
    salts: np.ndarray,
    all_detections: np.ndarray,
    all_rays: np.ndarray,
    polygon: np.ndarray,
    settings: np.ndarray,
    births_key: np.uint64,
    directions: np.ndarray,
    stamp: np.uint64,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Twin of `regions.correct` for wedges: states, weights, ids and labels of the particles after all scans, the births last.

    `all_rays` has no columns if all detections are exact positions; a scan of these never uses its rays. `births_key` is the key of the
    births in this tick, and `stamp` that of the labels which they found.
    """
    states, weights, ids, labels = particles
    on, each, side = (
        settings[run_columns.BIRTHS] != 0.0,
        np.int64(settings[run_columns.BIRTHS_PER_DETECTION]),
        settings[run_columns.MISS_BIN],
    )
    sensors, begins, starts, picked, detections, rays, spreads = _scans_in_reach(table, all_detections, all_rays, polygon, settings)
    count = len(weights)
    capacity = count + (len(picked) * each if on else 0)
    new_states, new_weights, new_ids, new_labels = blank(capacity)
    new_states[:count], new_weights[:count], new_ids[:count], new_labels[:count] = states, weights, ids, labels
    x, y, probabilities = np.empty(capacity), np.empty(capacity), np.empty(capacity)
    x[:count], y[:count] = states[:, 0], states[:, 1]
    densities = np.zeros(len(picked))
    if on:
        densities = nearby(x[:count], y[:count], weights, detections, settings[run_columns.BIRTH_RADIUS])
    found, gained, in_view = _pair_buffers(2 * count + 256), np.empty(capacity), np.empty(capacity + 1, np.int64)
    raster = _raster(x[:count], y[:count], detections, spreads, table, sensors, settings)
    at_columns, at_rows = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    for n in range(count):
        at_columns[n], at_rows[n] = _bin(x[n], y[n], side, raster[0], raster[1])
    for s in range(len(sensors)):
        sensor, part = table[sensors[s]], slice(starts[s], starts[s + 1])
        points, point_rays, born, sigma_rows = detections[part], rays[part], densities[part], sigma_sensors(sensor)
        seen = in_view[: _probabilities(x[:count], y[:count], sigma_rows, probabilities, in_view)]
        for n in seen:
            gained[n] = 0.0
        if len(points) == 0:  # nobody gains by a detection
            _missed(at_columns, at_rows, new_weights, probabilities, gained, seen, points, born, settings, raster)
            continue
        noise = noise_of(sensor, settings[run_columns.NOISE], settings[run_columns.KERNEL])
        pairs, found = _gated_terms(seen, x, y, new_weights, probabilities, sensor, points, point_rays, noise, settings, found)
        rows, columns, terms = found[0][:pairs], found[1][:pairs], found[3][:pairs]
        norms = _normalisers(points, columns, terms, born, sensor, sigma_rows, settings)
        for p in range(pairs):
            gained[rows[p]] += terms[p] / norms[columns[p]]
        _missed(at_columns, at_rows, new_weights, probabilities, gained, seen, points, born, settings, raster)
        for n in seen:
            new_weights[n] += gained[n]
        salt, numbers, given = scramble(salts[sensors[s]], births_key), np.empty(len(points), np.uint64), np.zeros(len(points), np.uint64)
        if on:
            for m in range(len(points)):
                numbers[m] = np.uint64(picked[starts[s] + m] - begins[s]) * np.uint64(each)
                given[m] = birth_label(scramble(numbers[m], salt), stamp)
        label_scan(new_labels, new_weights, rows, columns, terms, norms, given)
        if on:
            new, known = (new_states, new_weights, new_ids, new_labels), count
            count = add_births(new, count, points, point_rays, numbers, salt, born, given, sensor, noise, settings, directions)
            for birth in range(known, count):
                x[birth], y[birth] = new_states[birth, 0], new_states[birth, 1]
                at_columns[birth], at_rows[birth] = _bin(x[birth], y[birth], side, raster[0], raster[1])
    return new_states, new_weights, new_ids, new_labels
