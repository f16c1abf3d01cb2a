"""Compiled labels: the bit-for-bit twin of agents/tracking/labels.py.

Rules as in agents/compiled/particle_kernels.py.
"""

import numpy as np
from numba import njit

from agents.compiled.cache import cached
from agents.compiled.cell_kernels import sorted_by
from agents.compiled.particle_kernels import scramble
from agents.tracking.labels import (
    ADOPTED_SHARE,
    ADOPTION_RADIUS,
    ALONE_RADIUS,
    EXPLAINED_SHARE,
    FAINT_MASS,
    HASH_BITS,
    INNER_RADIUS,
    INTRUDER_MASS,
    OUTER_RADIUS,
    TICK_BITS,
    YOUNG_TICKS,
)
from agents.tracking.labels import NO_LABEL as NONE

NO_LABEL, _HASH_BITS, _TICK_BITS = np.uint64(NONE), np.uint64(HASH_BITS), np.uint64(TICK_BITS)  # ids and shifts are of one type
_ONE, _CUT = np.uint64(1), np.uint64(64 - HASH_BITS)


@njit
def stamp_of(tick: np.uint64) -> np.uint64:
    """The bits of a tick in the labels that are founded in it."""
    return ((tick + _ONE) % (_ONE << _TICK_BITS)) << _HASH_BITS


@njit
def birth_label(bits: np.uint64, stamp: np.uint64) -> np.uint64:
    """Twin of `labels.birth_labels` for one detection."""
    return stamp | (bits >> _CUT) | _ONE


@cached
def number_labels(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The number (N,) of the label of each row, -1 for none, and the label of each number (K,); numbers ascend from 0 by first rows.

    A hash table that is at most half full finds each label in a few steps.
    """
    size = 16
    while size < 2 * len(labels):
        size *= 2
    numbers, known, table, count = np.empty(len(labels), np.int64), np.empty(len(labels), np.uint64), np.full(size, -1), 0
    for n in range(len(labels)):
        if labels[n] == NO_LABEL:
            numbers[n] = -1
            continue
        slot = np.int64(scramble(labels[n], NO_LABEL) >> _ONE) & (size - 1)
        while table[slot] >= 0 and known[table[slot]] != labels[n]:
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot], known[count] = count, labels[n]
            count += 1
        numbers[n] = table[slot]
    return numbers, known[:count]


@cached
def label_scan(
    labels: np.ndarray,
    weights: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    terms: np.ndarray,
    norms: np.ndarray,
    given: np.ndarray,
) -> None:
    """Twin of `phd._labels_after`: write the labels of the particles (N,), and those of the births (M,) into `given`.

    The pairs (rows, columns, terms) are sorted by columns, the detections. `given` holds the labels that they found.
    """
    pairs, start = len(rows), 0
    numbers, known = number_labels(labels[rows])
    sums = np.zeros(len(known))
    while start < pairs:
        m, end, best, most = columns[start], start, NO_LABEL, 0.0
        while end < pairs and columns[end] == m:
            if numbers[end] >= 0 and terms[end] > 0.0:
                sums[numbers[end]] += terms[end]
            end += 1
        for p in range(start, end):
            k = numbers[p]
            if k >= 0 and (sums[k] > most or (sums[k] == most and known[k] < best)):
                best, most = known[k], sums[k]
        for p in range(start, end):
            if numbers[p] >= 0:
                sums[numbers[p]] = 0.0
        if best != NO_LABEL and most >= EXPLAINED_SHARE * norms[m]:
            given[m] = best
        start = end
    for p in range(pairs):  # more than half of a weight comes from one detection at most, so that no later pair changes a label again
        n = rows[p]
        if labels[n] == NO_LABEL and terms[p] / norms[columns[p]] > ADOPTED_SHARE * weights[n]:
            labels[n] = given[columns[p]]


@njit
def derived_label(label: np.uint64, number: np.uint64) -> np.uint64:
    """Twin of `labels.derived_label`."""
    return (label >> _HASH_BITS << _HASH_BITS) | (scramble(label, number) >> _CUT) | _ONE


@njit
def _name_by_weight(shares: tuple, known: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Give labels to peaks, the pair of a peak and a label with the largest weight first; returns which of `known` are given (K,).

    Peaks of one core have the same pairs. Of equal weights of a label its first peak comes first.
    """
    numbers, weights, starts, cores = shares
    pairs, peaks, taken = len(numbers), len(cores), np.zeros(len(known), np.bool_)
    labels, core_of = np.empty(pairs, np.uint64), np.empty(pairs, np.int64)
    for core in range(len(starts) - 1):
        for p in range(starts[core], starts[core + 1]):
            labels[p], core_of[p] = known[numbers[p]], core
    heads, following = np.full(len(starts), peaks), np.empty(peaks, np.int64)  # the first peak of a core without a label, and the next
    for m in range(peaks - 1, -1, -1):
        following[m], heads[cores[m]] = heads[cores[m]], m
    order = sorted_by(-weights, sorted_by(labels, np.arange(pairs)))
    first = 0
    while first < pairs:
        k, weight, peak, end = numbers[order[first]], weights[order[first]], peaks, first
        while end < pairs and numbers[order[end]] == k and weights[order[end]] == weight:
            peak = min(peak, heads[core_of[order[end]]])
            end += 1
        if peak < peaks and not taken[k]:
            given[peak], taken[k], heads[cores[peak]] = known[k], True, following[peak]
        first = end
    return taken


@njit
def _mean_positions(particles: tuple, taken: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twin of `labels.mean_positions` for the labels that are not taken (K,): their numbers (L,) and their mean positions (L, 2)."""
    states, weights, numbers = particles
    sums = np.zeros((len(taken), 3))
    for n in range(len(numbers)):
        k = numbers[n]
        if k >= 0:
            sums[k, 0] += weights[n]
            sums[k, 1] += weights[n] * states[n, 0]
            sums[k, 2] += weights[n] * states[n, 1]
    heavy = np.flatnonzero((sums[:, 0] >= FAINT_MASS) & ~taken)
    return heavy, sums[heavy, 1:] / sums[heavy, :1]


@njit
def _beside(x: float, y: float, labels: np.ndarray, mean_positions: np.ndarray, free: np.ndarray, reach: float) -> int:
    """Twin of `labels._beside` for the labels (L,) that are `free`: the place of the label in `labels`, or -1."""
    found, least = -1, reach * reach
    for k in range(len(labels)):
        dx, dy = mean_positions[k, 0] - x, mean_positions[k, 1] - y
        apart = dx * dx + dy * dy
        if free[k] and (apart < least or (apart == least and found >= 0 and labels[k] < labels[found])):
            found, least = k, apart
    return found


@cached
def name_peaks(shares: tuple, known: np.ndarray, places: np.ndarray, particles: tuple, stamp: np.uint64, size: float) -> np.ndarray:
    """Twin of `labels.name_peaks`: the label of each peak (M,).

    `shares` are numbers of labels (P,), their weights (P,), the first pair of each core (C + 1,), and the core of each peak (M,).
    The core of a peak holds the labels in it: of number c from `starts[c]` to `starts[c + 1]`. `known` (K,) are the labels by their
    numbers. `particles` are the states, weights and numbers of labels (N,) of all particles, `stamp` holds the bits of the tick
    (`stamp_of`), and bins have the side `size` m.
    """
    numbers, weights, starts, cores = shares
    given, open_to = np.zeros(len(cores), np.uint64), np.empty(len(cores), np.bool_)
    taken = _name_by_weight(shares, known, given)
    for m in range(len(cores)):
        age = ((stamp >> _HASH_BITS) + (_ONE << _TICK_BITS) - (given[m] >> _HASH_BITS)) % (_ONE << _TICK_BITS)
        open_to[m] = given[m] == NO_LABEL or age <= np.uint64(YOUNG_TICKS)
    if open_to.any():
        rows, mean_positions = _mean_positions(particles, taken)
        labels, free = known[rows], np.ones(len(rows), np.bool_)
        for m in range(len(cores)):
            if open_to[m]:
                k = _beside(places[m, 0], places[m, 1], labels, mean_positions, free, ADOPTION_RADIUS * size)
                if k >= 0 and (given[m] == NO_LABEL or labels[k] < given[m]):
                    given[m], free[k] = labels[k], False
    derived = np.zeros(len(known), np.uint64)  # how many labels have been derived from each: all of them are taken
    for m in range(len(cores)):
        heaviest = -1
        for p in range(starts[cores[m]], starts[cores[m] + 1] if given[m] == NO_LABEL else 0):
            is_first = heaviest < 0 or weights[p] > weights[heaviest]
            if is_first or (weights[p] == weights[heaviest] and known[numbers[p]] < known[numbers[heaviest]]):
                heaviest = p
        while heaviest >= 0 and given[m] == NO_LABEL:
            k = numbers[heaviest]
            derived[k] += _ONE
            label = derived_label(known[k], derived[k])
            if not (given == label).any():
                given[m] = label
    return given


@cached
def rename(updated: tuple, owned: np.ndarray, predicted: tuple, places: np.ndarray, size: float) -> np.ndarray:
    """Twin of `labels.renamed`: `updated` is states, weights and labels, `predicted` the weights and labels of the first rows."""
    states, weights, labels = updated
    alone, inner, outer = ALONE_RADIUS * size, INNER_RADIUS * size, OUTER_RADIUS * size
    new, count = labels.copy(), len(predicted[1])
    known, masses = np.empty(len(labels), np.uint64), np.empty((len(labels), 2))
    for m in range(len(places)):
        isolated, number, x, y = True, 0, places[m, 0], places[m, 1]
        for other in range(len(places)):
            dx, dy = places[other, 0] - x, places[other, 1] - y
            isolated &= other == m or dx * dx + dy * dy > alone * alone
        if not isolated:
            continue
        for n in range(len(labels)):
            dx, dy = states[n, 0] - x, states[n, 1] - y
            is_here = owned[n] and labels[n] != NO_LABEL and dx * dx + dy * dy <= inner * inner
            if is_here and _place(known, number, labels[n]) < 0:
                known[number], masses[number], number = labels[n], 0.0, number + 1
        for n in range(len(labels) if number > 0 else 0):
            dx, dy = states[n, 0] - x, states[n, 1] - y
            apart = dx * dx + dy * dy
            if apart <= outer * outer and (owned[n] or n < count):
                k = _place(known, number, labels[n] if owned[n] else predicted[1][n])
                if k >= 0:
                    masses[k, 0 if apart <= inner * inner else 1] += weights[n] if owned[n] else predicted[0][n]
        strange, home, heaviest = masses[:number, 1] > masses[:number, 0], -1, -1
        for k in range(number):
            strange[k] &= masses[k, 1] >= INTRUDER_MASS
            if heaviest < 0 or masses[k, 0] > masses[heaviest, 0] or (masses[k, 0] == masses[heaviest, 0] and known[k] < known[heaviest]):
                heaviest = k
            better = home < 0 or masses[k, 0] > masses[home, 0] or (masses[k, 0] == masses[home, 0] and known[k] < known[home])
            if not strange[k] and better:
                home = k
        if not strange.any():
            continue
        label = known[home] if home >= 0 else derived_label(known[heaviest], _ONE)
        for n in range(len(labels)):
            dx, dy = states[n, 0] - x, states[n, 1] - y
            if owned[n] and dx * dx + dy * dy <= inner * inner:
                k = _place(known, number, labels[n])
                if k >= 0 and strange[k]:
                    new[n] = label
    return new


@njit
def _place(known: np.ndarray, number: int, label: np.uint64) -> int:
    """The place of a label among the first `number`, or -1."""
    for k in range(number):
        if known[k] == label:
            return k
    return -1
