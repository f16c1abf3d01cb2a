"""Compiled labels: the bit-for-bit twin of agents/tracking/labels.py.

Rules as in agents/compiled/particle_kernels.py.
"""

import numpy as np
from numba import njit

from agents.compiled.cache import cached
from agents.compiled.particle_kernels import scramble
from agents.tracking.labels import ADOPTED, ALONE, AROUND, BESIDE, EXPLAINED, FAINT, HASH_BITS, HERE, STRANGER_MASS, TICK_BITS, YOUNG
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
    terms: np.ndarray,
    norms: np.ndarray,
    given: np.ndarray,
) -> None:
    """Twin of `phd._labels_after`: write the labels of the particles (N,), and those of the births (M,) into `given`.

    The pairs (rows, columns, terms) are sorted by columns, the detections. `given` holds the labels that they found.
    """
    pairs, start = len(rows), 0
    seen, sums = np.empty(16, np.uint64), np.empty(16)
    while start < pairs:
        m, end, number = columns[start], start, 0
        while end < pairs and columns[end] == m:
            label = labels[rows[end]]
            if label != NO_LABEL and terms[end] > 0.0:
                if number == len(seen):
                    seen, sums = np.concatenate((seen, np.empty_like(seen))), np.concatenate((sums, np.empty_like(sums)))
                number = add(seen, sums, number, label, terms[end])
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
        if labels[n] == NO_LABEL and terms[p] / norms[columns[p]] > ADOPTED * weights[n]:
            labels[n] = given[columns[p]]


@njit
def _best(labels: np.ndarray, weights: np.ndarray, taken: np.ndarray) -> int:
    """The place of the label with the largest weight that is not taken, the oldest of equals; -1: none."""
    best = -1
    for k in range(len(labels)):
        better = best < 0 or weights[k] > weights[best] or (weights[k] == weights[best] and labels[k] < labels[best])
        if better and not (taken == labels[k]).any():
            best = k
    return best


@njit
def _derived(label: np.uint64, taken: np.ndarray) -> np.uint64:
    """Twin of `labels._derived`."""
    number = _ONE
    while True:
        found = (label >> _HASH_BITS << _HASH_BITS) | (scramble(label, number) >> _CUT) | _ONE
        if not (taken == found).any():
            return found
        number += _ONE


@njit
def _middles(states: np.ndarray, weights: np.ndarray, labels: np.ndarray, given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twin of `labels.middles` for the labels that are not given: the labels (L,) and their mean positions (L, 2)."""
    known, sums, number = np.empty(16, np.uint64), np.empty((16, 3)), 0
    for n in range(len(labels)):
        if labels[n] == NO_LABEL or (given == labels[n]).any():
            continue
        k = 0
        while k < number and known[k] != labels[n]:
            k += 1
        if k == len(known):
            known, sums = np.concatenate((known, np.empty_like(known))), np.concatenate((sums, np.empty_like(sums)))
        if k == number:
            known[k], sums[k], number = labels[n], 0.0, number + 1
        sums[k, 0] += weights[n]
        sums[k, 1] += weights[n] * states[n, 0]
        sums[k, 2] += weights[n] * states[n, 1]
    heavy = sums[:number, 0] >= FAINT
    known, sums = known[:number][heavy], sums[:number][heavy]
    return known, sums[:, 1:] / sums[:, :1]


@njit
def _beside(x: float, y: float, known: np.ndarray, middles: np.ndarray, given: np.ndarray, reach: float) -> np.uint64:
    """Twin of `labels._beside` for the labels that are not given."""
    found, least = NO_LABEL, reach * reach
    for k in range(len(known)):
        dx, dy = middles[k, 0] - x, middles[k, 1] - y
        apart = dx * dx + dy * dy
        nearer = apart < least or (apart == least and found != NO_LABEL and known[k] < found)
        if nearer and not (given == known[k]).any():
            found, least = known[k], apart
    return found


@cached
def name_peaks(
    labels: np.ndarray, weights: np.ndarray, starts: np.ndarray, places: np.ndarray, particles: tuple, stamp: np.uint64, size: float
) -> np.ndarray:
    """Twin of `labels.name_peaks`: the label of each peak (M,).

    Peak number m at `places[m]` has the labels and weights from `starts[m]` to `starts[m + 1]`. `particles` are the states, weights and
    labels (N,) of all particles, `stamp` holds the bits of the tick (`stamp_of`), and bins have the side
    `size` m.
    """
    peaks, waits = len(starts) - 1, False
    given, nothing, open_to = np.zeros(peaks, np.uint64), np.empty(0, np.uint64), np.empty(peaks, np.bool_)
    while True:
        peak, place = -1, -1
        for m in range(peaks):
            if given[m] != NO_LABEL:
                continue
            part = slice(starts[m], starts[m + 1])
            k = _best(labels[part], weights[part], given)
            if k < 0:
                continue
            k += starts[m]
            if peak < 0 or weights[k] > weights[place] or (weights[k] == weights[place] and labels[k] < labels[place]):
                peak, place = m, k
        if peak < 0:
            break
        given[peak] = labels[place]
    for m in range(peaks):
        age = ((stamp >> _HASH_BITS) + (_ONE << _TICK_BITS) - (given[m] >> _HASH_BITS)) % (_ONE << _TICK_BITS)
        open_to[m] = given[m] == NO_LABEL or age <= np.uint64(YOUNG)
        waits |= open_to[m]
    if waits:
        known, middles = _middles(particles[0], particles[1], particles[2], given)
        for m in range(peaks):
            if open_to[m]:
                label = _beside(places[m, 0], places[m, 1], known, middles, given, BESIDE * size)
                if label != NO_LABEL and (given[m] == NO_LABEL or label < given[m]):
                    given[m] = label
    for m in range(peaks):
        if given[m] == NO_LABEL and starts[m + 1] > starts[m]:
            part = slice(starts[m], starts[m + 1])
            given[m] = _derived(labels[part][_best(labels[part], weights[part], nothing)], given)
    return given


@cached
def rename(updated: tuple, owned: np.ndarray, predicted: tuple, places: np.ndarray, size: float) -> np.ndarray:
    """Twin of `labels.renamed`: `updated` is states, weights and labels, `predicted` the weights and labels of the first rows."""
    states, weights, labels = updated
    alone, inner, outer = ALONE * size, HERE * size, AROUND * size
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
            strange[k] &= masses[k, 1] >= STRANGER_MASS
            if heaviest < 0 or masses[k, 0] > masses[heaviest, 0] or (masses[k, 0] == masses[heaviest, 0] and known[k] < known[heaviest]):
                heaviest = k
            better = home < 0 or masses[k, 0] > masses[home, 0] or (masses[k, 0] == masses[home, 0] and known[k] < known[home])
            if not strange[k] and better:
                home = k
        if not strange.any():
            continue
        label = known[home] if home >= 0 else _derived(known[heaviest], new[:0])
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
