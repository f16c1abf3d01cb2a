"""Labels: the identities of targets, carried by the particles.

Data types: a label is an integer below 2^53, so that a float64 and JSON hold it; arrays of labels are uint64. 0 means none.

Rules. A detection that founds a label gives it to its births, and all copies of a particle inherit it. A label is a pure function of
(seed, sensor, tick, detection), and older labels are smaller numbers. The particles of the prior and of background births have none. Such a
particle takes the label of the detection from which more than the share `CLAIMED` of its weight comes. A detection founds no label if a
living label explains at least the share `EXPLAINED` of it: its births then carry that label. So births beside a living track belong to it.

A label stands for one target. After the scans of a tick the owner of a cell settles the labels in it (agents/tracking/settling.py).
"""

from collections.abc import Collection

import numpy as np

from protocol.streams import scramble

NO_LABEL = 0
HASH_BITS, TICK_BITS = 29, 24  # of a label: a hash in the low bits, the tick plus one above; 2^24 ticks are 48 days at 4 Hz
EXPLAINED = 0.02  # share of N(z) that the particles of one label must make up
CLAIMED = 0.5  # share of a particle's weight
HELD, OLDEST = 0.1, 10.0  # in a peak the oldest label of at least this share of the heaviest weight counts so many times
GROWN = 1e-9  # least growth of a sum of worths


def birth_labels(hashes: np.ndarray, tick: int) -> np.ndarray:
    """The labels (M,) of births at `tick`; `hashes` (M,) uint64 are functions of (seed, sensor, tick, detection).

    Particles take the id of the first copy at a detection for its hash.
    """
    stamp = np.uint64(((tick + 1) % (1 << TICK_BITS)) << HASH_BITS)
    return stamp | (hashes >> np.uint64(64 - HASH_BITS)) | np.uint64(1)


def derived_label(label: int, number: int) -> int:
    """The label of the peak number `number` (from 1) that has no label left but `label`: of the same tick, with another hash."""
    word = int(scramble(np.array([label], dtype=np.uint64), number)[0])
    return label >> HASH_BITS << HASH_BITS | word >> (64 - HASH_BITS) | 1


def weight_by_label(labels: np.ndarray, weights: np.ndarray) -> dict[int, float]:
    """The weight of each label other than 0, added up in the order of the rows."""
    known, places = np.unique(labels, return_inverse=True)
    sums = np.bincount(places, weights, len(known))
    return {label: weight for label, weight in zip(known.tolist(), sums.tolist()) if label != NO_LABEL}


def heaviest(labels: np.ndarray, weights: np.ndarray) -> tuple[int, float]:
    """The label other than 0 with the most weight, the smallest of equals, and its weight; (0, 0.0) if there is none.

    Weights add up in the order of the rows.
    """
    known, places = np.unique(labels, return_inverse=True)
    sums = np.bincount(places, weights, len(known))
    sums[known == NO_LABEL] = 0.0
    if not len(known) or sums.max() <= 0.0:
        return NO_LABEL, 0.0
    first = int(sums.argmax())
    return int(known[first]), float(sums[first])


def given_labels(labels: np.ndarray, shares: np.ndarray, norms: np.ndarray, founded: np.ndarray) -> np.ndarray:
    """The labels (M,) that detections give: of a living label that explains them, or the `founded` ones (M,).

    `labels` (N,) are those of what the PHD is made of, `shares` (N, M) the terms w p_d g(z) of it, and `norms` (M,) the sums N(z).
    """
    given = founded.copy()
    for number in range(len(norms)):
        rows = np.flatnonzero(shares[:, number])
        label, weight = heaviest(labels[rows], shares[rows, number])
        if label != NO_LABEL and weight >= EXPLAINED * norms[number]:
            given[number] = label
    return given


def assign_labels(peaks: list[dict[int, float]]) -> list[int]:
    """One label for each peak, no label twice; a peak is the weight of each label in it, 0 left out.

    The oldest label of a peak with at least `HELD` of its heaviest weight counts `OLDEST` times. The pair of a peak and a label with the
    largest worth comes first, then the next of the peaks and labels that are left; of equals the older label, then the first peak. A peak
    then takes a label from another one as long as the sum of all worths grows: the other takes its best free label. A peak without a free
    label takes a label derived from its heaviest one; a peak without any label has none.
    """
    worths, given = [_worths(peak) for peak in peaks], [NO_LABEL] * len(peaks)
    for value, label, number in sorted((-value, label, number) for number, worth in enumerate(worths) for label, value in worth.items()):
        if value < 0.0 and given[number] == NO_LABEL and label not in given:
            given[number] = label
    while _exchanged(worths, given):
        pass
    taken = {*given, NO_LABEL}
    for number, peak in enumerate(peaks):
        if given[number] == NO_LABEL and peak:
            given[number] = _derived(_best(peak, {NO_LABEL}), taken)
            taken.add(given[number])
    return given


def _worths(peak: dict[int, float]) -> dict[int, float]:
    """The weights of the labels in a peak, that of the oldest important one multiplied."""
    least = HELD * max(peak.values(), default=0.0)
    oldest = min([label for label, weight in peak.items() if weight >= least], default=NO_LABEL)
    return {label: weight * (OLDEST if label == oldest else 1.0) for label, weight in peak.items()}


def _best(worth: dict[int, float], taken: Collection[int]) -> int:
    """The label of the largest worth that is not taken, the oldest of equals; 0: none."""
    return min([(-value, label) for label, value in worth.items() if label not in taken], default=(0.0, NO_LABEL))[1]


def _exchanged(worths: list[dict[int, float]], given: list[int]) -> bool:
    """Whether a peak took the label of another one, because the sum grew by more than rounding; the first such pair exchanges."""
    for number, worth in enumerate(worths):
        for other, label in enumerate(given):
            if other == number or label not in worth:
                continue
            free = _best(worths[other], given)
            now = worth.get(given[number], 0.0) + worths[other][label]
            if worth[label] + worths[other].get(free, 0.0) > now + GROWN:
                given[number], given[other] = label, free
                return True
    return False


def _derived(label: int, taken: set[int]) -> int:
    """The first label derived from `label` that is not taken."""
    number = 1
    while derived_label(label, number) in taken:
        number += 1
    return derived_label(label, number)
