"""The compiled corrector: the loops of `phd.update` and `births` for numba, bit for bit; rules as in `kernels`.

What can be done for several particles at once stands in loops of its own without branches, because the compiler then does so.
"""

import math

import numpy as np
from numba import njit

from agents.cell_kernels import around, distance
from agents.kernels import normal, scramble, wedge
from agents.numba_cache import cached

_S52 = np.uint64(52)
_TAYLOR = (1.0 / 362880, 1.0 / 40320, 1.0 / 5040, 1.0 / 720, 1.0 / 120, 1.0 / 24, 1.0 / 6, 0.5, 1.0, 1.0)


@njit
def _exp_minus(value: float) -> float:
    small = value * (1.0 / 64.0)
    result = 1.0 / 3628800.0
    for coefficient in _TAYLOR:
        result = result * -small + coefficient
    for _ in range(6):
        result = result * result
    return result


@cached
def _birth_densities(
    x: np.ndarray, y: np.ndarray, weights: np.ndarray, detections: np.ndarray, kappas: np.ndarray, radius: float, least: float, most: float
) -> np.ndarray:
    """Twin of `births.birth_density` for the detections (M, 2) of all scans; kappas (M,)."""
    number, area = len(detections), math.pi * radius * radius
    at_x, at_y, found = detections[:, 0].copy(), detections[:, 1].copy(), np.zeros(number)
    for n in range(len(weights)):  # one particle after the other for the sake of the sums, and without branches
        px, py, weight = x[n], y[n], weights[n]
        for m in range(number):
            dx, dy = px - at_x[m], py - at_y[m]
            found[m] += weight if dx * dx + dy * dy <= radius * radius else 0.0
    for m in range(number):
        found[m] = min(max(found[m] / area, least * kappas[m]), most)
    return found


@cached
def _mark_view(x: np.ndarray, y: np.ndarray, sensor: np.ndarray, seen: np.ndarray) -> None:
    """Mark which points lie in a wedge (a row of `words`), without branches, so that it is done for several at once."""
    eye_x, eye_y, cos, sin, reach2, cos_half = sensor[0], sensor[1], sensor[2], sensor[3], sensor[4] * sensor[4], sensor[5]
    for n in range(len(x)):
        dx, dy = x[n] - eye_x, y[n] - eye_y
        range2 = dx * dx + dy * dy
        seen[n] = (range2 <= reach2) & (dx * cos + dy * sin >= cos_half * math.sqrt(range2))


@cached
def _pairs(
    x: np.ndarray,
    y: np.ndarray,
    weights: np.ndarray,
    seen: np.ndarray,
    probability: float,
    detections: np.ndarray,
    gate2: float,
    found: tuple,
) -> int:
    """Every particle in view within the gate of a detection, into `found`: its row, the detection, squared distance m^2, weight times
    p_d. Weights become those of the undetected. The number of pairs, or -1 when `found` may be too small, weights as they were."""
    rows, columns, squares, shares = found
    number, pairs = len(x), 0
    apart, hits = np.empty(number), np.empty(number, np.bool_)
    for m in range(len(detections)):
        at_x, at_y = detections[m, 0], detections[m, 1]
        for n in range(number):
            dx, dy = x[n] - at_x, y[n] - at_y
            apart[n] = dx * dx + dy * dy
            hits[n] = seen[n] & (apart[n] <= gate2)
        if pairs + number > len(rows):
            return -1
        for n in range(number):  # what is no hit is written over
            rows[pairs], columns[pairs], squares[pairs], shares[pairs] = n, m, apart[n], weights[n] * probability
            pairs += hits[n]
    for n in range(number):
        weights[n] = weights[n] * (1.0 - probability) if seen[n] else weights[n]
    return pairs


@cached
def _room(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size), np.empty(size)


@cached
def _likelihoods(squares: np.ndarray, shares: np.ndarray, noise: float) -> None:
    """Multiply shares by the Gaussian density at squared distances m^2."""
    scale, exponent_scale = 1.0 / (2.0 * math.pi * noise * noise), 0.5 / (noise * noise)
    for p in range(len(squares)):
        shares[p] = shares[p] * (_exp_minus(squares[p] * exponent_scale) * scale)


@njit
def _scan_of(
    row: np.ndarray,
    first: int,
    polygon: np.ndarray,
    box: tuple[float, float, float, float],
    halo: float,
    detections: np.ndarray,
    picked: np.ndarray,
    count: int,
) -> int:
    """Append to `picked` the detections of a scan within the halo of the cell, whose box this is; the new count, or -1 when the sensor
    is too far away."""
    if row[8] == 0.0 or _beyond(box, row[0], row[1], halo + row[4]) or distance(polygon, row[0], row[1]) > halo + row[4]:
        return -1
    for m in range(first, first + np.int64(row[9])):
        x, y = detections[m, 0], detections[m, 1]
        if not _beyond(box, x, y, halo) and distance(polygon, x, y) <= halo:
            picked[count] = m
            count += 1
    return count


@njit
def _beyond(box: tuple[float, float, float, float], x: float, y: float, width: float) -> bool:
    """Whether a point is farther than `width` m from a box for certain, and so from all that lies in it."""
    west, south, east, north = box
    wide = width + 1e-6
    return x < west - wide or x > east + wide or y < south - wide or y > north + wide


@cached
def update(
    states: np.ndarray,
    weights: np.ndarray,
    ids: np.ndarray,
    table: np.ndarray,
    salts: np.ndarray,
    all_detections: np.ndarray,
    polygon: np.ndarray,
    halo: float,
    noise: float,
    gate2: float,
    birth: tuple,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Twin of `arithmetic.update` for wedges; `birth` is (on, copies, radius, least, most, speed, key of the births, directions)."""
    on, copies, radius, least, most, speed, births_key, directions = birth
    sensors, starts = np.empty(len(table), np.int64), np.zeros(len(table) + 1, np.int64)
    picked, begins = np.empty(len(all_detections), np.int64), np.empty(len(table), np.int64)
    scans = first = close = 0
    box = around(polygon, 0.0)
    for s in range(len(table)):
        reached = _scan_of(table[s], first, polygon, box, halo, all_detections, picked, close)
        if reached >= 0:
            sensors[scans], begins[scans], close = s, first, reached
            scans += 1
            starts[scans] = close
        first += np.int64(table[s, 9])
    count = len(weights)
    room = count + (close * copies if on else 0)
    new_states, new_weights, new_ids = np.empty((room, 4)), np.empty(room), np.empty(room, np.uint64)
    new_states[:count], new_weights[:count], new_ids[:count] = states, weights, ids
    x, y, seen = np.empty(room), np.empty(room), np.empty(room, np.bool_)
    x[:count], y[:count] = states[:, 0], states[:, 1]
    detections, kappas, densities = np.empty((close, 2)), np.empty(close), np.zeros(close)
    for s in range(scans):
        for m in range(starts[s], starts[s + 1]):
            detections[m], kappas[m] = all_detections[picked[m]], table[sensors[s], 7]
    if on:
        densities = _birth_densities(x[:count], y[:count], weights, detections, kappas, radius, least, most)
    found = _room(2 * count + 256)
    for s in range(scans):
        sensor, points = table[sensors[s]], detections[starts[s] : starts[s + 1]]
        _mark_view(x[:count], y[:count], sensor, seen)
        pairs = _pairs(x[:count], y[:count], new_weights, seen, sensor[6], points, gate2, found)
        while pairs < 0:
            found = _room(4 * len(found[0]))
            pairs = _pairs(x[:count], y[:count], new_weights, seen, sensor[6], points, gate2, found)
        rows, columns, squares, shares = found
        _likelihoods(squares[:pairs], shares[:pairs], noise)
        norms = np.zeros(len(points))
        for p in range(pairs):
            norms[columns[p]] += shares[p]
        for m in range(len(points)):
            fresh = wedge(points[m, 0], points[m, 1], sensor) * densities[starts[s] + m]
            norm = sensor[7] + fresh + norms[m]
            norms[m] = norm if norm > 0.0 else 1.0
            densities[starts[s] + m] = fresh / norms[m] / np.float64(copies)
        for p in range(pairs):
            new_weights[rows[p]] += shares[p] / norms[columns[p]]
        if on:
            salt = scramble(salts[sensors[s]], births_key)
            for m in range(len(points)):
                number = np.uint64(picked[starts[s] + m] - begins[s])
                for copy in range(copies):
                    word = scramble(number * np.uint64(copies) + np.uint64(copy), salt)
                    x[count] = points[m, 0] + normal(scramble(word, np.uint64(1))) * noise
                    y[count] = points[m, 1] + normal(scramble(word, np.uint64(2))) * noise
                    direction = np.int64(scramble(word, np.uint64(3)) >> _S52)
                    new_states[count, 0], new_states[count, 1] = x[count], y[count]
                    new_states[count, 2], new_states[count, 3] = directions[direction, 0] * speed, directions[direction, 1] * speed
                    new_ids[count], new_weights[count] = word, densities[starts[s] + m]
                    count += 1
    return new_states, new_weights, new_ids
