"""Likelihoods and births of sensors that measure range and bearing, or bearing alone, and of poses that are not exact.

Data types: `Noise` holds the variances of a scan. A *ray* is a row (unit vector x, y from the sensor to the detection, range m, how far
births may lie from the detection's place, m).

Rules. Only operations that round exactly: a difference of angles e enters as 2 tan(e / 2), which is e within 1 % up to 18 degrees. A
density of measurements is stated per m^2 of the plane, so that clutter and births have one unit for all sensors: that of a range and
a bearing is divided by the range, that of a bearing alone by half the squared radius. `noise_of`, `distance_and_peak` and `birth_place`
are compiled for single numbers (agents/compiled/measuring_kernels.py).
"""

import math
from typing import NamedTuple

import numpy as np

from agents.config import FilterSettings
from protocol.measuring import MeasurementModel
from protocol.random_streams import normal, scramble, uniform

POSITION, RANGE_BEARING, BEARING = 0.0, 1.0, 2.0  # models of a scan, a column of the gossip table
MODELS = {"range-bearing": RANGE_BEARING, "bearing": BEARING}  # by `MeasurementModel.kind`
LARGEST_DEVIATION = 3.47  # deviations: above all keyed normal numbers (`protocol.random_streams.NORMAL_BOUND`)
TINY = 1e-12
EXACT_POSE = (0.0, 0.0)  # the noise of a pose that is exact
POSE_SPREAD = math.sqrt(3.0)  # deviations of `sigma_poses`


class Noise(NamedTuple):
    """The model of a scan and its variances."""

    model: float
    along: float  # of the distance from the sensor, m^2
    across: float  # of the place across the ray, m^2
    bearing: float  # of the bearing, rad^2


def model_of(measurement: MeasurementModel | None) -> tuple[float, float, float]:
    """Model, standard deviation of a range in m and of a bearing in rad; 0 for a sensor of positions."""
    if measurement is None:
        return POSITION, 0.0, 0.0
    return MODELS[measurement.kind], measurement.range_noise, measurement.bearing_noise


def kernel_variance(settings: FilterSettings) -> float:
    """The variance of a particle's kernel on each axis, m^2 (`phd.likelihood_noise`)."""
    width = settings.roughening * settings.position_noise * math.pow(settings.particles_per_target, -1.0 / 6.0)
    return width * width


def sigma_poses(pose: tuple[float, float, float], pose_noise: tuple[float, float]) -> list[tuple[float, float, float]]:
    """The sigma points of a pose, whose equal mixture has its mean and variances: six, or the pose alone if it is exact.

    They lie sqrt(3) standard deviations away on each axis and to each side: the third-degree cubature of Arasaratnam and Haykin (2009).
    """
    if pose_noise == EXACT_POSE:
        return [pose]
    (x, y, heading), away, turned = pose, POSE_SPREAD * pose_noise[0], POSE_SPREAD * pose_noise[1]
    sides = [(x + away, y, heading), (x - away, y, heading), (x, y + away, heading), (x, y - away, heading)]
    return [*sides, (x, y, heading + turned), (x, y, heading - turned)]


def noise_of(model: tuple[float, float, float], position_noise: float, kernel: float, pose_noise: tuple[float, float]) -> Noise:
    """The variances of a scan: those of the sensor, of a particle's kernel and of the sensor's pose together.

    `pose_noise` are standard deviations of the pose, m on each axis and rad.
    """
    (kind, range_noise, bearing_noise), (place_noise, heading_noise) = model, pose_noise
    place = kernel + place_noise * place_noise
    turn = bearing_noise * bearing_noise + heading_noise * heading_noise
    if kind == POSITION:
        variance = position_noise * position_noise + place
        return Noise(kind, variance, variance, turn)
    return Noise(kind, range_noise * range_noise + place, place, turn)


def distances_and_peaks(
    states: np.ndarray, pose: tuple[float, ...], points: np.ndarray, rays: np.ndarray, radius: float, noise: Noise
) -> tuple[np.ndarray, np.ndarray]:
    """Squared Mahalanobis distances (N, M) of detections at `points` (M, 2) from particles, and peaks (N, M) of the densities, per m^2."""
    x, y = states[:, 0, None], states[:, 1, None]
    squared, peaks = np.broadcast_arrays(*distance_and_peak(x, y, pose, points.T[:, None], rays.T[:, None], radius, noise))
    return squared, peaks


def distance_and_peak(
    x: np.ndarray, y: np.ndarray, at: tuple[float, ...], point: np.ndarray, ray: np.ndarray, radius: float, noise: Noise
) -> tuple[np.ndarray, np.ndarray]:
    """Squared Mahalanobis distance of a detection from a particle at x, y, and peak of its density, per m^2, for a sensor `at` x, y in m.

    `point` and `ray` are those of the detection. They, x and y hold numbers, or arrays that broadcast.
    """
    east, north, far = ray[0], ray[1], ray[2]
    if noise.model == POSITION:
        ex, ey = x - point[0], y - point[1]
        along, across = ex * east + ey * north, east * ey - north * ex
        wide = noise.across + noise.bearing * (far * far)
        return along * along / noise.along + across * across / wide, 1.0 / (2.0 * math.pi * np.sqrt(noise.along * wide))
    dx, dy = x - at[0], y - at[1]
    range2 = dx * dx + dy * dy
    distance = np.sqrt(range2)
    along, across = dx * east + dy * north, east * dy - north * dx
    angle = 2.0 * across / np.maximum(distance + along, TINY)
    wide = noise.bearing + noise.across / np.maximum(range2, TINY)
    squared = angle * angle / wide
    if noise.model == BEARING:
        return squared, 1.0 / (np.sqrt(2.0 * math.pi * wide) * (0.5 * radius * radius))
    apart = distance - far
    return squared + apart * apart / noise.along, 1.0 / (2.0 * math.pi * np.sqrt(noise.along * wide) * np.maximum(far, TINY))


def birth_places(ids: np.ndarray, pose: tuple[float, ...], points: np.ndarray, rays: np.ndarray, radius: float, noise: Noise) -> np.ndarray:
    """The places (N, 2) of births with these ids, each at a detection at `points` (N, 2) with its ray (N, 4)."""
    normals = normal(scramble(ids, 1)), normal(scramble(ids, 2))
    return np.column_stack(birth_place(normals, uniform(scramble(ids, 4)), pose, points.T, rays.T, radius, noise))


def birth_place(
    normals: tuple[np.ndarray, np.ndarray],
    share: np.ndarray,
    at: tuple[float, ...],
    point: np.ndarray,
    ray: np.ndarray,
    radius: float,
    noise: Noise,
) -> tuple[np.ndarray, np.ndarray]:
    """The place x, y of a birth at a detection, from two normal variates and one in [0, 1), for a sensor `at` x, y in m.

    A bearing alone bears particles along its ray, uniform in the area of the beam. `normals`, `share`, `point` and `ray` hold numbers, or
    arrays (N,).
    """
    (first, second), east, north, far = normals, ray[0], ray[1], ray[2]
    if noise.model == POSITION:
        along = first * np.sqrt(noise.along)
        across = second * np.sqrt(noise.across + noise.bearing * (far * far))
        return point[0] + (along * east - across * north), point[1] + (along * north + across * east)
    if noise.model == BEARING:
        distance = radius * np.sqrt(share)
    else:
        distance = far + first * np.sqrt(noise.along)
    half = 0.5 * (second * np.sqrt(noise.bearing + noise.across / np.maximum(distance * distance, TINY)))
    half = np.minimum(np.maximum(half, -1.0), 1.0)
    cos, sin = (1.0 - half * half) / (1.0 + half * half), 2.0 * half / (1.0 + half * half)
    return at[0] + distance * (cos * east - sin * north), at[1] + distance * (sin * east + cos * north)


def spread_of(model: float, ranges: float, radius: float, noise: Noise) -> float:
    """How far births may lie from the place of a detection at most, m."""
    if model == BEARING:
        return 2.0 * radius
    if model == RANGE_BEARING:
        return LARGEST_DEVIATION * math.sqrt(noise.along) + 2.0 * (ranges + LARGEST_DEVIATION * math.sqrt(noise.along))
    return 2.0 * LARGEST_DEVIATION * math.sqrt(noise.along + noise.across + noise.bearing * ranges * ranges)
