"""Compiled labels: the bit-for-bit twin of agents/tracking/labels.py.

Rules as in agents/compiled/particle_kernels.py.
"""

import numpy as np
from numba import njit

from agents.compiled.cache import cached
from agents.compiled.particle_kernels import scramble

# The constants of agents/tracking/labels.py, which a test compares.
NO_LABEL, HASH_BITS, TICK_BITS, EXPLAINED, CLAIMED = np.uint64(0), np.uint64(29), np.uint64(24), 0.02, 0.5
HELD, OLDEST, GROWN = 0.1, 10.0, 1e-9
_ONE, _CUT = np.uint64(1), np.uint64(35)


@njit
def stamp_of(tick: np.uint64) -> np.uint64:
    """The bits of a tick in the labels that are founded in it."""
    return ((tick + _ONE) % (_ONE << TICK_BITS)) << HASH_BITS


@njit
def birth_label(bits: np.uint64, stamp: np.uint64) -> np.uint64:
    """Twin of `labels.birth_labels` for one detection."""
    return stamp | (bits >> _CUT) | _ONE


@njit
def add(labels: np.ndarray, sums: np.ndarray, number: int, label: np.uint64, weight: float) -> int:
    """The new number of labels after `weight` is added to the sum of a label other than 0."""
    for k in range(number):
        if labels[k] == label:
            sums[k] += weight
            return number
    labels[number], sums[number] = label, weight
    return number + 1


@cached
def label_scan(
    labels: np.ndarray,
    weights: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    shares: np.ndarray,
    norms: np.ndarray,
    given: np.ndarray,
) -> None:
    """Twin of `phd._labels_after`: write the labels of the particles (N,), and those of the births (M,) into `given`.

    The pairs (rows, columns, shares) are sorted by columns, the detections. `given` holds the labels that they found.
    """
    pairs, start = len(rows), 0
    seen, sums = np.empty(16, np.uint64), np.empty(16)
    while start < pairs:
        m, end, number = columns[start], start, 0
        while end < pairs and columns[end] == m:
            label = labels[rows[end]]
            if label != NO_LABEL and shares[end] > 0.0:
                if number == len(seen):
                    seen, sums = np.concatenate((seen, np.empty_like(seen))), np.concatenate((sums, np.empty_like(sums)))
                number = add(seen, sums, number, label, shares[end])
            end += 1
        best, most = NO_LABEL, 0.0
        for k in range(number):
            if sums[k] > most or (sums[k] == most and seen[k] < best):
                best, most = seen[k], sums[k]
        if best != NO_LABEL and most >= EXPLAINED * norms[m]:
            given[m] = best
        start = end
    for p in range(pairs):  # more than half of a weight comes from one detection at most, so that no later pair changes a label again
        n = rows[p]
        if labels[n] == NO_LABEL and shares[p] / norms[columns[p]] > CLAIMED * weights[n]:
            labels[n] = given[columns[p]]


@njit
def _worths(labels: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Twin of `labels._worths` for the labels of one peak."""
    worths, most, oldest = weights.copy(), 0.0, -1
    for k in range(len(labels)):
        most = max(most, weights[k])
    for k in range(len(labels)):
        if weights[k] >= HELD * most and (oldest < 0 or labels[k] < labels[oldest]):
            oldest = k
    if oldest >= 0:
        worths[oldest] *= OLDEST
    return worths


@njit
def _best(labels: np.ndarray, worths: np.ndarray, taken: np.ndarray) -> int:
    """Twin of `labels._best`: the place of the label, or -1."""
    best = -1
    for k in range(len(labels)):
        better = best < 0 or worths[k] > worths[best] or (worths[k] == worths[best] and labels[k] < labels[best])
        if better and worths[k] > 0.0 and not (taken == labels[k]).any():
            best = k
    return best


@njit
def _place(labels: np.ndarray, start: int, end: int, label: np.uint64) -> int:
    """The place of a label among those from `start` to `end`, or -1."""
    for k in range(start, end):
        if labels[k] == label:
            return k
    return -1


@njit
def _derived(label: np.uint64, taken: np.ndarray) -> np.uint64:
    """Twin of `labels._derived`."""
    number = _ONE
    while True:
        found = (label >> HASH_BITS << HASH_BITS) | (scramble(label, number) >> _CUT) | _ONE
        if not (taken == found).any():
            return found
        number += _ONE


@njit
def _exchanged(labels: np.ndarray, worths: np.ndarray, starts: np.ndarray, given: np.ndarray) -> bool:
    """Twin of `labels._exchanged`."""
    for number in range(len(given)):
        for other in range(len(given)):
            if other == number or given[other] == NO_LABEL:
                continue
            wanted = _place(labels, starts[number], starts[number + 1], given[other])
            if wanted < 0:
                continue
            held = _place(labels, starts[other], starts[other + 1], given[other])
            mine = _place(labels, starts[number], starts[number + 1], given[number])
            part = slice(starts[other], starts[other + 1])
            free = _best(labels[part], worths[part], given)
            now = (worths[mine] if mine >= 0 else 0.0) + worths[held]
            if worths[wanted] + (worths[part][free] if free >= 0 else 0.0) > now + GROWN:
                given[number] = given[other]
                given[other] = labels[part][free] if free >= 0 else NO_LABEL
                return True
    return False


@cached
def assign_labels(labels: np.ndarray, weights: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Twin of `labels.assign_labels`: the label of each peak (M,).

    Peak number m has the labels and weights from `starts[m]` to `starts[m + 1]`.
    """
    peaks = len(starts) - 1
    given, worths, nothing = np.zeros(peaks, np.uint64), np.empty(len(labels)), np.empty(0, np.uint64)
    for m in range(peaks):
        part = slice(starts[m], starts[m + 1])
        worths[part] = _worths(labels[part], weights[part])
    while True:
        peak, place = -1, -1
        for m in range(peaks):
            if given[m] != NO_LABEL:
                continue
            part = slice(starts[m], starts[m + 1])
            k = _best(labels[part], worths[part], given)
            if k < 0:
                continue
            k += starts[m]
            if peak < 0 or worths[k] > worths[place] or (worths[k] == worths[place] and labels[k] < labels[place]):
                peak, place = m, k
        if peak < 0:
            break
        given[peak] = labels[place]
    while _exchanged(labels, worths, starts, given):
        pass
    for m in range(peaks):
        if given[m] == NO_LABEL and starts[m + 1] > starts[m]:
            part = slice(starts[m], starts[m + 1])
            given[m] = _derived(labels[part][_best(labels[part], weights[part], nothing)], given)
    return given
