"""Target extraction: estimated positions of targets from particles.

Data types: grids (rows, columns) of bins of side `bin` m with the mass in each, and the mass-weighted sums of x and y.

Rules. Sums run in a fixed order, the same as in agents/compiled/extraction_kernels.py.
"""

import numpy as np

from agents.config import ExtractionSettings
from agents.tracking.particles import Particles


def estimate_targets(particles: Particles, settings: ExtractionSettings = ExtractionSettings()) -> np.ndarray:
    """Estimated target positions (M, 2) in m, heaviest first.

    Masses are binned. The heaviest 5 x 5 block is a peak while it holds at least `threshold` expected targets. Its estimate is the
    mean of its heaviest 3 x 3 block, the core. One expected target is then removed from the block, the core first.
    """
    if not len(particles.weights):
        return np.empty((0, 2))
    columns = np.floor(particles.states[:, 0] / settings.bin).astype(np.int64)
    rows = np.floor(particles.states[:, 1] / settings.bin).astype(np.int64)
    left, low = int(columns.min()) - 4, int(rows.min()) - 4
    shape = (int(rows.max()) - low + 5, int(columns.max()) - left + 5)
    flat = (rows - low) * shape[1] + (columns - left)

    def binned(values: np.ndarray) -> np.ndarray:
        return np.bincount(flat, values, shape[0] * shape[1]).reshape(shape)

    masses = binned(particles.weights)
    east, north = binned(particles.weights * particles.states[:, 0]), binned(particles.weights * particles.states[:, 1])
    blocks = block_sums(masses, 2)
    found: list[tuple[float, float]] = []
    while True:
        row, column = divmod(int(blocks.argmax()), shape[1])
        if blocks[row, column] < settings.threshold:
            return np.array(found).reshape(-1, 2)
        core = _heaviest_core(masses, row, column)
        mass = _window_sum(masses, *core, 1)
        found.append((_window_sum(east, *core, 1) / mass, _window_sum(north, *core, 1) / mass))
        _remove_one(masses, east, north, row, column, core)
        near = (slice(max(row - 6, 0), row + 7), slice(max(column - 6, 0), column + 7))
        fresh = block_sums(masses[near], 2)
        top, side = row - near[0].start, column - near[1].start
        blocks[max(row - 4, 0) : row + 5, max(column - 4, 0) : column + 5] = fresh[max(top - 4, 0) : top + 5, max(side - 4, 0) : side + 5]


def block_sums(masses: np.ndarray, half: int) -> np.ndarray:
    """Sums over the (2 half + 1)^2 block around each bin; the margin of `half` bins is 0 or incomplete."""
    rows = np.zeros_like(masses)
    for shift in range(-half, half + 1):
        rows[half:-half] += masses[half + shift : len(masses) - half + shift]
    sums = np.zeros_like(masses)
    for shift in range(-half, half + 1):
        sums[:, half:-half] += rows[:, half + shift : masses.shape[1] - half + shift]
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
