"""Compiled likelihoods and births of other measurements than positions, by the formulas of agents/tracking/measurement_likelihood.py.

Data types: `noise` is a `measurement_likelihood.Noise`; a ray is a row as there.

Rules as in agents/compiled/particle_kernels.py.
"""

from typing import Any

import numpy as np
from numba import njit

from agents.compiled.cache import cached
from agents.gossip.table import BEARING_NOISE, HEADING_NOISE, MODEL, PLACE_NOISE, RANGE_NOISE, REACH, X, Y
from agents.tracking import measurement_likelihood
from agents.tracking.measurement_likelihood import POSITION, Noise

# The plain functions, compiled for single numbers
_noise_of: Any = njit(measurement_likelihood.noise_of)
_distance_and_peak: Any = njit(measurement_likelihood.distance_and_peak)
birth_place: Any = njit(measurement_likelihood.birth_place)


@njit
def noise_of(sensor: np.ndarray, position_noise: float, kernel: float) -> Noise:
    """See `measurement_likelihood.noise_of`; `sensor` is a row of the gossip table."""
    model, pose_noise = (sensor[MODEL], sensor[RANGE_NOISE], sensor[BEARING_NOISE]), (sensor[PLACE_NOISE], sensor[HEADING_NOISE])
    return _noise_of(model, position_noise, kernel, pose_noise)


@njit
def has_rays(sensor: np.ndarray) -> bool:
    """Whether the detections of a scan are anything but exact positions; `sensor` is a row of the gossip table."""
    return sensor[MODEL] != POSITION or sensor[PLACE_NOISE] > 0.0 or sensor[HEADING_NOISE] > 0.0


@cached
def pairs(
    x: np.ndarray,
    y: np.ndarray,
    probabilities: np.ndarray,
    sensor: np.ndarray,
    points: np.ndarray,
    rays: np.ndarray,
    noise: Noise,
    gate: float,
    found: tuple,
) -> int:
    """The number of pairs of a particle in view and a detection within its gate, or -1 if `found` may be too small.

    Each pair is written into `found`: row of the particle, number of the detection, squared Mahalanobis distance, peak of the density.
    """
    rows, columns, squares, peaks = found
    at, number, count = (sensor[X], sensor[Y]), len(x), 0
    for m in range(len(points)):
        if count + number > len(rows):
            return -1
        for n in range(number):
            if probabilities[n] > 0.0:
                squared, peak = _distance_and_peak(x[n], y[n], at, points[m], rays[m], sensor[REACH], noise)
                if squared <= gate * gate:
                    rows[count], columns[count], squares[count], peaks[count] = n, m, squared, peak
                    count += 1
    return count
