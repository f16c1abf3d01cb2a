"""Compiled likelihoods and births of other measurements than positions: the bit-for-bit twin of agents/tracking/measurement_likelihood.py.

Data types: `noise` is the tuple of `measurement_likelihood.Noise`; a ray is a row as there.

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np
from numba import njit

from agents.compiled.cache import cached
from agents.compiled.particle_kernels import normal, scramble, uniform
from agents.gossip.table import BEARING_NOISE, HEADING_NOISE, MODEL, PLACE_NOISE, RANGE_NOISE, REACH, X, Y
from agents.tracking.measurement_likelihood import BEARING, POSITION, TINY


@njit
def noise_of(sensor: np.ndarray, position_noise: float, kernel: float) -> tuple[float, float, float, float]:
    """Twin of `measurement_likelihood.noise_of`; `sensor` is a row of the gossip table."""
    place = kernel + sensor[PLACE_NOISE] * sensor[PLACE_NOISE]
    turn = sensor[BEARING_NOISE] * sensor[BEARING_NOISE] + sensor[HEADING_NOISE] * sensor[HEADING_NOISE]
    if sensor[MODEL] == POSITION:
        variance = position_noise * position_noise + place
        return sensor[MODEL], variance, variance, turn
    return sensor[MODEL], sensor[RANGE_NOISE] * sensor[RANGE_NOISE] + place, place, turn


@njit
def _density(x: float, y: float, sensor: np.ndarray, point: np.ndarray, ray: np.ndarray, noise: tuple) -> tuple[float, float]:
    """Twin of `measurement_likelihood.distances_and_peaks` for a particle and a detection: squared Mahalanobis distance, peak per m^2."""
    model, along_variance, across_variance, bearing_variance = noise
    east, north, far = ray[0], ray[1], ray[2]
    if model == POSITION:
        ex, ey = x - point[0], y - point[1]
        along, across = ex * east + ey * north, east * ey - north * ex
        wide = across_variance + bearing_variance * (far * far)
        return along * along / along_variance + across * across / wide, 1.0 / (2.0 * math.pi * math.sqrt(along_variance * wide))
    dx, dy = x - sensor[X], y - sensor[Y]
    range2 = dx * dx + dy * dy
    distance = math.sqrt(range2)
    along, across = dx * east + dy * north, east * dy - north * dx
    angle = 2.0 * across / max(distance + along, TINY)
    wide = bearing_variance + across_variance / max(range2, TINY)
    squared = angle * angle / wide
    if model == BEARING:
        return squared, 1.0 / (math.sqrt(2.0 * math.pi * wide) * (0.5 * sensor[REACH] * sensor[REACH]))
    apart = distance - far
    peak = 1.0 / (2.0 * math.pi * math.sqrt(along_variance * wide) * max(far, TINY))
    return squared + apart * apart / along_variance, peak


@cached
def pairs(
    x: np.ndarray,
    y: np.ndarray,
    probabilities: np.ndarray,
    sensor: np.ndarray,
    points: np.ndarray,
    rays: np.ndarray,
    noise: tuple,
    gate: float,
    found: tuple,
) -> int:
    """The number of pairs of a particle in view and a detection within its gate, or -1 if `found` may be too small.

    Each pair is written into `found`: row of the particle, number of the detection, squared Mahalanobis distance, peak of the density.
    """
    rows, columns, squares, peaks = found
    number, count = len(x), 0
    for m in range(len(points)):
        if count + number > len(rows):
            return -1
        for n in range(number):
            if probabilities[n] > 0.0:
                squared, peak = _density(x[n], y[n], sensor, points[m], rays[m], noise)
                if squared <= gate * gate:
                    rows[count], columns[count], squares[count], peaks[count] = n, m, squared, peak
                    count += 1
    return count


@njit
def birth_place(new_id: np.uint64, sensor: np.ndarray, point: np.ndarray, ray: np.ndarray, noise: tuple) -> tuple[float, float]:
    """Twin of `measurement_likelihood.birth_places` for one birth."""
    model, along_variance, across_variance, bearing_variance = noise
    east, north, far = ray[0], ray[1], ray[2]
    first, second = normal(scramble(new_id, np.uint64(1))), normal(scramble(new_id, np.uint64(2)))
    if model == POSITION:
        along = first * math.sqrt(along_variance)
        across = second * math.sqrt(across_variance + bearing_variance * (far * far))
        return point[0] + (along * east - across * north), point[1] + (along * north + across * east)
    if model == BEARING:
        distance = sensor[REACH] * math.sqrt(uniform(scramble(new_id, np.uint64(4))))
    else:
        distance = far + first * math.sqrt(along_variance)
    half = 0.5 * (second * math.sqrt(bearing_variance + across_variance / max(distance * distance, TINY)))
    half = min(max(half, -1.0), 1.0)
    cos, sin = (1.0 - half * half) / (1.0 + half * half), 2.0 * half / (1.0 + half * half)
    return sensor[X] + distance * (cos * east - sin * north), sensor[Y] + distance * (sin * east + cos * north)
