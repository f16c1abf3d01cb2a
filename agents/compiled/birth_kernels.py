"""Compiled births: the bit-for-bit twins of agents/tracking/births.py for wedges, without a temporary array for each operation.

Data types: the settings of a run are an array (agents/compiled/run_columns.py).

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np
from numba import njit

from agents.compiled import run_columns
from agents.compiled.cache import cached
from agents.compiled.measuring_kernels import birth_place, has_rays
from agents.compiled.particle_kernels import normal, scramble, uniform
from agents.gossip.table import CLUTTER_DENSITY, MODEL, REACH, X, Y
from agents.tracking.measurement_likelihood import BEARING, Noise

_S52 = np.uint64(52)


@cached
def background(
    count: int, on_border: int, salt: np.uint64, width: float, height: float, speed: float, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """States (count, 4) and ids (count,) of the births of the tick with key `salt`; the first `on_border` start on the border."""
    states, ids = np.empty((count, 4)), np.empty(count, np.uint64)
    perimeter = 2.0 * (width + height)
    for row in range(count):
        new_id = ids[row] = scramble(np.uint64(row), salt)
        along = uniform(scramble(new_id, np.uint64(1))) * perimeter
        if row < on_border:
            sideways = 2.0 * uniform(scramble(new_id, np.uint64(2))) - 1.0
            inward = math.sqrt(1.0 - sideways * sideways)
            if along < width:  # south, then counter-clockwise: a corner, the tangent from it, and the normal inwards
                rest, corner, tangent, across = along, (0.0, 0.0), (1.0, 0.0), (0.0, 1.0)
            elif along < width + height:
                rest, corner, tangent, across = along - width, (width, 0.0), (0.0, 1.0), (-1.0, 0.0)
            elif along < 2.0 * width + height:
                rest, corner, tangent, across = along - (width + height), (width, height), (-1.0, 0.0), (0.0, -1.0)
            else:
                rest, corner, tangent, across = along - (2.0 * width + height), (0.0, height), (0.0, -1.0), (1.0, 0.0)
            x, y = corner[0] + tangent[0] * rest, corner[1] + tangent[1] * rest
            vx, vy = tangent[0] * sideways + across[0] * inward, tangent[1] * sideways + across[1] * inward
        else:
            x, y = along / perimeter * width, uniform(scramble(new_id, np.uint64(4))) * height
            direction = directions[np.int64(scramble(new_id, np.uint64(3)) >> _S52)]
            vx, vy = direction[0], direction[1]
        states[row, 0], states[row, 1], states[row, 2], states[row, 3] = x, y, vx * speed, vy * speed
    return states, ids


@njit
def close_by(x: float, y: float, settings: np.ndarray) -> tuple[float, float]:
    """Twin of `births.close_by` for one place."""
    width, height = settings[run_columns.WIDTH], settings[run_columns.HEIGHT]
    return min(max(x, -width), 2.0 * width), min(max(y, -height), 2.0 * height)


@cached
def nearby(x: np.ndarray, y: np.ndarray, weights: np.ndarray, detections: np.ndarray, radius: float) -> np.ndarray:
    """The masses (M,) within `radius` m of the detections (M, 2) of all scans, for `birth_densities`."""
    number = len(detections)
    at_x, at_y, found = detections[:, 0].copy(), detections[:, 1].copy(), np.zeros(number)
    for n in range(len(weights)):  # one particle after the other, as the order of the sums demands; without branches
        px, py, weight = x[n], y[n], weights[n]
        for m in range(number):
            dx, dy = px - at_x[m], py - at_y[m]
            found[m] += weight if dx * dx + dy * dy <= radius * radius else 0.0
    return found


@njit
def birth_densities(points: np.ndarray, sums: np.ndarray, sensor: np.ndarray, masses: np.ndarray, settings: np.ndarray) -> None:
    """Twin of `births.birth_density` for the detections (M, 2) of a scan: densities per m^2 replace the masses in `masses` (M,).

    `sums` (M,) are the sums of w p_d g(z) of the particles for each detection.
    """
    least, least_share, most = settings[run_columns.LEAST_DENSITY], settings[run_columns.LEAST_SHARE], settings[run_columns.MOST_DENSITY]
    clutter_density, radius = sensor[CLUTTER_DENSITY], settings[run_columns.BIRTH_RADIUS]
    lowest, area = max(least, min(least_share * clutter_density, 0.5 * most)), math.pi * radius * radius
    for m in range(len(points)):
        if sensor[MODEL] == BEARING:  # the place along the beam is not known
            masses[m] = min(lowest, most)
            continue
        known = 0.0
        for other in range(len(points)):
            dx, dy = points[other, 0] - points[m, 0], points[other, 1] - points[m, 1]
            if dx * dx + dy * dy <= radius * radius and sums[other] > 0.0:
                known += sums[other] / (clutter_density + sums[other])
        masses[m] = min(max((masses[m] - known) / area, lowest), most)


@njit
def add_births(
    particles: tuple,
    count: int,
    points: np.ndarray,
    rays: np.ndarray,
    numbers: np.ndarray,
    salt: np.uint64,
    born: np.ndarray,
    given: np.ndarray,
    sensor: np.ndarray,
    noise: Noise,
    settings: np.ndarray,
    directions: np.ndarray,
) -> int:
    """Twin of `births.measurement_births`: write the births of a scan behind the first `count` particles, and return the new count.

    Each detection has the number of its first birth (M,), the weight `born` of all its births, and their label `given`.
    """
    states, weights, ids, labels = particles
    each, speed, deviation = np.int64(settings[run_columns.BIRTHS_PER_DETECTION]), settings[run_columns.SPEED], settings[run_columns.NOISE]
    at, with_rays = (sensor[X], sensor[Y]), has_rays(sensor)
    for m in range(len(points)):
        for copy in range(each):
            new_id = scramble(numbers[m] + np.uint64(copy), salt)
            first, second = normal(scramble(new_id, np.uint64(1))), normal(scramble(new_id, np.uint64(2)))
            if with_rays:
                share = uniform(scramble(new_id, np.uint64(4)))
                x, y = birth_place((first, second), share, at, points[m], rays[m], sensor[REACH], noise)
            else:
                x, y = points[m, 0] + first * deviation, points[m, 1] + second * deviation
            direction = np.int64(scramble(new_id, np.uint64(3)) >> _S52)
            states[count, 0], states[count, 1] = close_by(x, y, settings)
            states[count, 2], states[count, 3] = directions[direction, 0] * speed, directions[direction, 1] * speed
            ids[count], weights[count], labels[count] = new_id, born[m] / np.float64(each), given[m]
            count += 1
    return count
