"""Compiled target extraction: the bit-for-bit twin of agents/tracking/extraction.py.

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np

from agents.compiled.cache import cached
from agents.compiled.label_kernels import name_peaks, number_labels

ESTIMATE = 8  # columns of an estimate: x, y in m, then those of `extraction.TargetEstimates.details`


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
    line, sums = np.empty(width), np.empty(width)
    for r in range(2, height - 2):
        heavy = 0
        for c in range(width):  # without branches, for several bins at once
            line[c] = masses[r - 2, c] + masses[r - 1, c] + masses[r, c] + masses[r + 1, c] + masses[r + 2, c]
        for c in range(2, width - 2):
            sums[c] = line[c - 2] + line[c - 1] + line[c] + line[c + 1] + line[c + 2]
            heavy += sums[c] >= threshold
        for c in range(2, width - 2 if heavy > 0 else 2):
            rows[number], columns[number], blocks[number] = r, c, sums[c]
            number += sums[c] >= threshold
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
def estimate_targets(
    states: np.ndarray, weights: np.ndarray, labels: np.ndarray, size: float, threshold: float, beside: float, stamp: np.uint64
) -> tuple[np.ndarray, np.ndarray]:
    """Twin of `extraction.estimate_targets`: estimates (M, ESTIMATE), heaviest first, and their labels.

    Bins have the side `size` m. `stamp` holds the bits of the tick (`label_kernels.stamp_of`).
    """
    left = low = np.int64(1 << 60)
    right = high = -left
    bins = np.empty((2, len(weights)), np.int64)  # column and row of each particle
    for n in range(len(weights)):
        column, row = np.int64(math.floor(states[n, 0] / size)), np.int64(math.floor(states[n, 1] / size))
        left, right, low, high = min(left, column), max(right, column), min(low, row), max(high, row)
        bins[0, n], bins[1, n] = column, row
    left, low = left - 4, low - 4
    height, width = high - low + 5, right - left + 5
    masses, east, north = np.zeros((height, width)), np.zeros((height, width)), np.zeros((height, width))
    for n in range(len(weights)):
        column, row = bins[0, n] - left, bins[1, n] - low
        masses[row, column] += weights[n]
        east[row, column] += weights[n] * states[n, 0]
        north[row, column] += weights[n] * states[n, 1]
    rows, columns, blocks, number = _peaks(masses, threshold)
    found, targets = np.empty((len(weights) + 1, ESTIMATE)), 0
    cores = np.empty((len(found), 2), np.int64)
    while number > 0:
        peak = np.argmax(blocks[:number])
        row, column = rows[peak], columns[peak]
        if blocks[peak] < threshold:
            break
        if targets == len(found):
            found, cores = np.concatenate((found, np.empty_like(found))), np.concatenate((cores, np.empty_like(cores)))
        best, core_row, core_column = -1.0, row, column
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                mass = _window(masses, r, c, 1)
                if mass > best:
                    best, core_row, core_column = mass, r, c
        mass = _window(masses, core_row, core_column, 1)
        found[targets, 0] = _window(east, core_row, core_column, 1) / mass
        found[targets, 1] = _window(north, core_row, core_column, 1) / mass
        found[targets, 7] = min(blocks[peak], 1.0)
        cores[targets, 0], cores[targets, 1] = core_row + low, core_column + left
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
                mass = block(masses, rows[peak], columns[peak])
                blocks[peak] = mass if mass >= beside else 0.0
    return found[:targets], _describe((states, weights, labels), bins, size, cores[:targets], found, stamp)


@cached
def _describe(particles: tuple, bins: np.ndarray, size: float, cores: np.ndarray, found: np.ndarray, stamp: np.uint64) -> np.ndarray:
    """Twin of `extraction._described`: write velocities and covariances of estimates with these cores, and return their labels.

    `particles` are states, weights and labels (N,), and `bins` (2, N) their columns and rows of bins with the side `size` m.
    """
    states, weights, labels = particles
    numbers, known = number_labels(labels)
    sums, votes, masses, pairs = np.zeros(len(known)), np.empty(len(known), np.int64), np.empty(len(known)), 0
    starts, core_of, number = np.zeros(len(cores) + 1, np.int64), np.empty(len(cores), np.int64), 0
    firsts = np.empty(len(cores), np.int64)  # the first peak of each core
    for peak in range(len(cores)):
        row, column, x, y, mass = cores[peak, 0], cores[peak, 1], found[peak, 0], found[peak, 1], 0.0
        vx = vy = xx = xy = yy = 0.0
        core = 0
        while core < number and (cores[firsts[core], 0] != row or cores[firsts[core], 1] != column):
            core += 1
        is_new, core_of[peak] = core == number, core
        if is_new and pairs + len(known) > len(votes):
            votes, masses = (
                np.concatenate((votes, np.empty(pairs + len(known), np.int64))),
                np.concatenate((masses, np.empty(pairs + len(known)))),
            )
        for n in range(len(weights)):
            if abs(bins[1, n] - row) > 1 or abs(bins[0, n] - column) > 1 or not weights[n] > 0.0:
                continue
            weight, dx, dy, k = weights[n], states[n, 0] - x, states[n, 1] - y, numbers[n]
            mass += weight
            vx += weight * states[n, 2]
            vy += weight * states[n, 3]
            xx += weight * (dx * dx)
            xy += weight * (dx * dy)
            yy += weight * (dy * dy)
            if is_new and k >= 0:
                if sums[k] == 0.0:
                    votes[pairs], pairs = k, pairs + 1
                sums[k] += weight
        if is_new:
            for p in range(starts[number], pairs):
                masses[p], sums[votes[p]] = sums[votes[p]], 0.0
            firsts[number], number = peak, number + 1
            starts[number] = pairs
        for place, moment in enumerate((vx, vy, xx, xy, yy)):
            found[peak, 2 + place] = moment / mass
    shares = votes[:pairs], masses[:pairs], starts[: number + 1], core_of
    return name_peaks(shares, known, found, (states, weights, numbers), stamp, size)
