"""Compiled target extraction: the bit-for-bit twin of agents/tracking/extraction.py.

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np

from agents.compiled.cache import cached


@cached
def block(masses: np.ndarray, row: int, column: int) -> float:
    """Twin of `extraction.block_sums` for one bin: the mass of the 5 x 5 bins around it, column after column."""
    total = 0.0
    for c in range(column - 2, column + 3):
        line = 0.0
        for r in range(row - 2, row + 3):
            line += masses[r, c]
        total += line
    return total


@cached
def _peaks(masses: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Rows, columns and masses of the blocks of at least `threshold`, in the order of the grid, and their number.

    No other block becomes a peak later: removing mass from the grid only makes blocks lighter.
    """
    height, width = masses.shape
    rows, columns, blocks, number = np.empty(masses.size, np.int64), np.empty(masses.size, np.int64), np.empty(masses.size), 0
    line = np.empty(width)
    for r in range(2, height - 2):
        for c in range(width):
            line[c] = masses[r - 2, c] + masses[r - 1, c] + masses[r, c] + masses[r + 1, c] + masses[r + 2, c]
        for c in range(2, width - 2):
            rows[number], columns[number] = r, c
            blocks[number] = line[c - 2] + line[c - 1] + line[c] + line[c + 1] + line[c + 2]
            number += blocks[number] >= threshold
    return rows, columns, blocks, number


@cached
def _window(grid: np.ndarray, row: int, column: int, half: int) -> float:
    """Twin of `extraction._window_sum`."""
    total = 0.0
    for r in range(row - half, row + half + 1):
        for c in range(column - half, column + half + 1):
            total += grid[r, c]
    return total


@cached
def estimate_targets(states: np.ndarray, weights: np.ndarray, size: float, threshold: float) -> np.ndarray:
    """Twin of `extraction.estimate_targets`: estimated positions (M, 2) in m, heaviest first; bins of side `size` m."""
    left = low = np.int64(1 << 60)
    right = high = -left
    for n in range(len(weights)):
        column, row = np.int64(math.floor(states[n, 0] / size)), np.int64(math.floor(states[n, 1] / size))
        left, right, low, high = min(left, column), max(right, column), min(low, row), max(high, row)
    left, low = left - 4, low - 4
    height, width = high - low + 5, right - left + 5
    masses, east, north = np.zeros((height, width)), np.zeros((height, width)), np.zeros((height, width))
    for n in range(len(weights)):
        column = np.int64(math.floor(states[n, 0] / size)) - left
        row = np.int64(math.floor(states[n, 1] / size)) - low
        masses[row, column] += weights[n]
        east[row, column] += weights[n] * states[n, 0]
        north[row, column] += weights[n] * states[n, 1]
    rows, columns, blocks, number = _peaks(masses, threshold)
    found, targets = np.empty((len(weights) + 1, 2)), 0
    while number > 0:
        peak = np.argmax(blocks[:number])
        row, column = rows[peak], columns[peak]
        if blocks[peak] < threshold:
            break
        if targets == len(found):
            found = np.concatenate((found, np.empty_like(found)))
        best, core_row, core_column = -1.0, row, column
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                mass = _window(masses, r, c, 1)
                if mass > best:
                    best, core_row, core_column = mass, r, c
        mass = _window(masses, core_row, core_column, 1)
        found[targets, 0] = _window(east, core_row, core_column, 1) / mass
        found[targets, 1] = _window(north, core_row, core_column, 1) / mass
        targets += 1
        unit = 1.0
        for stage in range(2):
            r0, c0, half = (core_row, core_column, 1) if stage == 0 else (row, column, 2)
            mass = _window(masses, r0, c0, half)
            if mass > 0.0:
                keep = max(0.0, 1.0 - unit / mass)
                masses[r0 - half : r0 + half + 1, c0 - half : c0 + half + 1] *= keep
                east[r0 - half : r0 + half + 1, c0 - half : c0 + half + 1] *= keep
                north[r0 - half : r0 + half + 1, c0 - half : c0 + half + 1] *= keep
                unit -= min(unit, mass)
        for peak in range(number):
            if abs(rows[peak] - row) <= 4 and abs(columns[peak] - column) <= 4:
                blocks[peak] = block(masses, rows[peak], columns[peak])
    return found[:targets]
