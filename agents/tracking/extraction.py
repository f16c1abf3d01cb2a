"""Target extraction: estimated targets from particles.

Data types: `TargetEstimates` are estimated targets of one tick. Grids (rows, columns) of bins of side `bin` m hold the mass in each, and
the mass-weighted sums of x and y.

Rules. Sums run in a fixed order, the same as in agents/compiled/extraction_kernels.py.
"""

from typing import NamedTuple

import numpy as np

from agents.config import ExtractionSettings
from agents.tracking.labels import mean_positions, name_peaks, weight_by_label
from agents.tracking.particles import Particles, total


class TargetEstimates(NamedTuple):
    """Estimated targets: positions (M, 2) m, details (M, 6), and labels (M,) uint64, 0 for none.

    The details are the velocity vx, vy in m/s, the covariance xx, xy, yy of the position in m^2, and the existence: the mass of the peak,
    at most 1.
    """

    positions: np.ndarray
    details: np.ndarray
    labels: np.ndarray


DETAILS = 6
NO_ESTIMATES = TargetEstimates(np.empty((0, 2)), np.empty((0, DETAILS)), np.empty(0, dtype=np.uint64))


def estimate_targets(particles: Particles, settings: ExtractionSettings = ExtractionSettings(), tick: int = 0) -> TargetEstimates:
    """Estimated targets of a tick, heaviest first.

    Masses are binned. The heaviest 5 x 5 block is a peak while it holds at least `threshold` expected targets. Its estimate is the
    mean of its heaviest 3 x 3 block, the core. One expected target is then removed from the block, the core first. What is left within
    4 bins of it is no peak below `beside`: part of a target that was half out of view. Velocity, covariance and the weights of the labels
    come from the particles in the core. `labels.name_peaks` makes one label of them.
    """
    if not len(particles.weights):
        return NO_ESTIMATES
    columns = np.floor(particles.states[:, 0] / settings.bin).astype(np.int64)
    rows = np.floor(particles.states[:, 1] / settings.bin).astype(np.int64)
    left, low = int(columns.min()) - 4, int(rows.min()) - 4
    shape = (int(rows.max()) - low + 5, int(columns.max()) - left + 5)
    flat = (rows - low) * shape[1] + (columns - left)

    def binned(values: np.ndarray) -> np.ndarray:
        return np.bincount(flat, values, shape[0] * shape[1]).reshape(shape)

    masses = binned(particles.weights)
    east, north = binned(particles.weights * particles.states[:, 0]), binned(particles.weights * particles.states[:, 1])
    blocks = block_sums(masses)
    found: list[tuple[float, float]] = []
    cores, existence = list[tuple[int, int]](), list[float]()
    while True:
        row, column = divmod(int(blocks.argmax()), shape[1])
        if blocks[row, column] < settings.threshold:
            positions = np.array(found).reshape(-1, 2)
            return _described(positions, existence, cores, particles, (rows - low, columns - left), tick, settings.bin)
        core = _heaviest_core(masses, row, column)
        mass = _window_sum(masses, *core, 1)
        cores.append(core)
        existence.append(min(float(blocks[row, column]), 1.0))
        found.append((_window_sum(east, *core, 1) / mass, _window_sum(north, *core, 1) / mass))
        _remove_one(masses, east, north, row, column, core)
        near = (slice(max(row - 6, 0), row + 7), slice(max(column - 6, 0), column + 7))
        fresh = block_sums(masses[near])
        top, side = row - near[0].start, column - near[1].start
        beside = fresh[max(top - 4, 0) : top + 5, max(side - 4, 0) : side + 5]
        blocks[max(row - 4, 0) : row + 5, max(column - 4, 0) : column + 5] = np.where(beside >= settings.beside, beside, 0.0)


def _described(
    positions: np.ndarray,
    existence: list[float],
    cores: list[tuple[int, int]],
    particles: Particles,
    bins: tuple[np.ndarray, np.ndarray],
    tick: int,
    size: float,
) -> TargetEstimates:
    """Estimates with velocity, covariance and label; `bins` are the rows and columns (N,) of the particles, `size` their side in m."""
    rows, columns = bins
    details, peaks = np.empty((len(cores), DETAILS)), list[dict[int, float]]()
    for number, (row, column) in enumerate(cores):
        near = np.flatnonzero((np.abs(rows - row) <= 1) & (np.abs(columns - column) <= 1) & (particles.weights > 0.0))
        weights, states, labels = particles.weights[near], particles.states[near], particles.labels[near]
        mass, (x, y) = total(weights), positions[number]
        dx, dy = states[:, 0] - x, states[:, 1] - y
        terms = states[:, 2], states[:, 3], dx * dx, dx * dy, dy * dy
        details[number] = (*(total(weights * term) / mass + 0.0 for term in terms), existence[number])  # no zero is negative
        peaks.append(weight_by_label(labels, weights))
    names = name_peaks(peaks, positions, mean_positions(particles), tick, size)
    return TargetEstimates(positions, details, np.array(names, dtype=np.uint64))


def forecast(estimates: TargetEstimates, seconds: float) -> TargetEstimates:
    """The estimates some seconds later: each target moves on by its velocity."""
    return estimates._replace(positions=estimates.positions + estimates.details[:, :2] * seconds)


def block_sums(masses: np.ndarray) -> np.ndarray:
    """Sums over the 5 x 5 block around each bin; the margin of two bins is 0 or incomplete."""
    rows, sums = np.zeros_like(masses), np.zeros_like(masses)
    for shift in range(5):
        rows[2:-2] += masses[shift : len(masses) - 4 + shift]
    for shift in range(5):
        sums[:, 2:-2] += rows[:, shift : masses.shape[1] - 4 + shift]
    return sums


def _window_sum(grid: np.ndarray, row: int, column: int, half: int) -> float:
    """Sum of the (2 half + 1)^2 block around a bin, added bin by bin, row after row."""
    window = grid[row - half : row + half + 1, column - half : column + half + 1]
    return float(np.add.accumulate(window.ravel())[-1])


def _heaviest_core(masses: np.ndarray, row: int, column: int) -> tuple[int, int]:
    """Centre of the heaviest 3 x 3 block inside the 5 x 5 block around a bin."""
    centres = [(r, c) for r in range(row - 1, row + 2) for c in range(column - 1, column + 2)]
    return max(centres, key=lambda centre: _window_sum(masses, centre[0], centre[1], 1))


def _remove_one(masses: np.ndarray, east: np.ndarray, north: np.ndarray, row: int, column: int, core: tuple[int, int]) -> None:
    """Remove one expected target from the 5 x 5 block around a bin, the core first."""
    left = 1.0
    for (r, c), half in ((core, 1), ((row, column), 2)):
        mass = _window_sum(masses, r, c, half)
        if mass > 0.0:
            keep = max(0.0, 1.0 - left / mass)
            for grid in (masses, east, north):
                grid[r - half : r + half + 1, c - half : c + half + 1] *= keep
            left -= min(left, mass)
