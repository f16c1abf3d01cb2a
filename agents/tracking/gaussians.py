"""Gaussian mixtures, and the operations that keep their order.

Data types: a `Mixture` holds weighted Gaussians of place and velocity side by side.

Rules. The canonical order is by ascending id. Each number is computed from its own component, by operations that treat all rows alike,
so that a component has the same bits in every set.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.tracking import particles
from agents.tracking.particles import Particles, canonical
from protocol.gaussian_components import COMPONENT
from protocol.random_streams import scramble
from protocol.settings import ArenaSettings

LARGEST_HALF = 65504.0  # that 16 bits hold
LEAST_VARIANCE = 1.0e-8  # of each axis given the ones before, m^2 or m^2/s^2
KERNEL_SHARE = 0.2  # of the covariance, that lies around each quadrature point; these hold the rest
_AXIS = (-1.0, 0.0, 1.0)
QUADRATURE_OFFSETS = math.sqrt(3.0 * (1.0 - KERNEL_SHARE)) * np.array([(i, j) for i in _AXIS for j in _AXIS])  # standard deviations
QUADRATURE_WEIGHTS = np.array([(1.0, 4.0, 1.0)[i] * (1.0, 4.0, 1.0)[j] / 36.0 for i in range(3) for j in range(3)])
LOWER = [(row, column) for row in range(4) for column in range(row + 1)]  # the entries of a factor on the wire, in order


class Mixture(NamedTuple):
    """Weights (N,): expected targets; means (N, 4): x, y in m and vx, vy in m/s; covariances (N, 4, 4); ids and labels (N,) uint64."""

    weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray
    ids: np.ndarray
    labels: np.ndarray  # 0: none (agents/tracking/labels.py)

    @property
    def states(self) -> np.ndarray:
        """The means: the place of a component is that of its mean, as the place of a particle is in its state."""
        return self.means


EMPTY = Mixture(np.empty(0), np.empty((0, 4)), np.empty((0, 4, 4)), np.empty(0, dtype=np.uint64), np.empty(0, dtype=np.uint64))


def unlabelled(weights: np.ndarray, means: np.ndarray, covariances: np.ndarray, ids: np.ndarray) -> Mixture:
    """Components without labels."""
    return Mixture(weights, means, covariances, ids, np.zeros(len(ids), dtype=np.uint64))


def clamped(mixture: Mixture, arena: ArenaSettings) -> Mixture:
    """The components with their means in the arena, those outside on its border; the border is rounded inwards as on the wire."""
    sides = np.array([arena.width, arena.height])
    rounded = sides.astype(np.float32)
    border = np.where(rounded > sides, np.nextafter(rounded, np.float32(0.0)), rounded)
    means = mixture.means.copy()
    means[:, :2] = np.clip(means[:, :2], 0.0, border)
    return mixture._replace(means=means)


def factors(covariances: np.ndarray) -> np.ndarray:
    """The lower Cholesky factors (N, 4, 4); a variance that rounding has made too small becomes `LEAST_VARIANCE`."""
    found = np.zeros_like(covariances)
    for row, column in LOWER:
        rest = covariances[:, row, column].copy()
        for before in range(column):
            rest = rest - found[:, row, before] * found[:, column, before]
        found[:, row, column] = np.sqrt(np.maximum(rest, LEAST_VARIANCE)) if row == column else rest / found[:, column, column]
    return found


def packed(mixture: Mixture) -> np.ndarray:
    """The rows (N,) of `COMPONENT` that state a mixture on the wire; what 16 bits cannot hold becomes the largest number that they can.

    A measurement of no exactness, or a false gossip, may found components of any width. A row beyond the range would be refused.
    """
    rows, factor = np.empty(len(mixture.ids), COMPONENT), np.clip(factors(mixture.covariances), -LARGEST_HALF, LARGEST_HALF)
    velocities = np.clip(mixture.means[:, 2:], -LARGEST_HALF, LARGEST_HALF)
    rows["weight"], rows["place"], rows["velocity"] = mixture.weights, mixture.means[:, :2], velocities
    rows["id"], rows["label"] = mixture.ids, mixture.labels
    for number, (row, column) in enumerate(LOWER):
        rows["factor"][:, number] = factor[:, row, column]
    return rows


def unpacked(rows: np.ndarray) -> Mixture:
    """The mixture that rows (N,) of `COMPONENT` state."""
    factor = np.zeros((len(rows), 4, 4))
    for number, (row, column) in enumerate(LOWER):
        factor[:, row, column] = rows["factor"][:, number]
    covariances = np.zeros_like(factor)
    for row, column in LOWER:
        for before in range(column + 1):
            covariances[:, row, column] += factor[:, row, before] * factor[:, column, before]
        covariances[:, column, row] = covariances[:, row, column]
    weights, means = rows["weight"].astype(float), np.concatenate([rows["place"], rows["velocity"]], axis=1, dtype=float)
    return Mixture(weights, means, covariances, rows["id"].astype(np.uint64), rows["label"].astype(np.uint64))


def quadrature_points(mixture: Mixture) -> np.ndarray:
    """Gauss-Hermite points (N, 9, 2), m: with `QUADRATURE_WEIGHTS` they give mean and covariance of a component, but for `KERNEL_SHARE`."""
    xx, xy, yy = mixture.covariances[:, 0, 0], mixture.covariances[:, 0, 1], mixture.covariances[:, 1, 1]
    east = np.sqrt(np.maximum(xx, LEAST_VARIANCE))
    north = xy / east
    rest = np.sqrt(np.maximum(yy - north * north, LEAST_VARIANCE))
    x = mixture.means[:, 0, None] + east[:, None] * QUADRATURE_OFFSETS[None, :, 0]
    y = mixture.means[:, 1, None] + (north[:, None] * QUADRATURE_OFFSETS[None, :, 0] + rest[:, None] * QUADRATURE_OFFSETS[None, :, 1])
    return np.stack([x, y], axis=2)


def quadrature_mean(values: np.ndarray) -> np.ndarray:
    """The means (N,) of values at the quadrature points (N, 9)."""
    found = values[:, 0] * QUADRATURE_WEIGHTS[0]
    for number in range(1, len(QUADRATURE_WEIGHTS)):
        found = found + values[:, number] * QUADRATURE_WEIGHTS[number]
    return found


def weighted_points(mixture: Mixture) -> Particles:
    """The density as the weighted quadrature points of each component, by ascending id."""
    count, size = len(mixture.ids), len(QUADRATURE_WEIGHTS)
    states = np.repeat(mixture.means, size, axis=0)
    states[:, :2] = quadrature_points(mixture).reshape(-1, 2)
    ids = scramble(np.repeat(mixture.ids, size), np.tile(np.arange(size, dtype=np.uint64), count)) if count else mixture.ids
    return canonical(particles.unlabelled(states, (mixture.weights[:, None] * QUADRATURE_WEIGHTS[None, :]).reshape(-1), ids))


def largest_variances(mixture: Mixture) -> np.ndarray:
    """The larger principal variance (N,) of each place, m^2."""
    xx, xy, yy = mixture.covariances[:, 0, 0], mixture.covariances[:, 0, 1], mixture.covariances[:, 1, 1]
    half = 0.5 * (xx - yy)
    return 0.5 * (xx + yy) + np.sqrt(half * half + xy * xy)
