"""Labels: the identities of targets, carried by the particles.

Data types: a label is an integer below 2^53, so that a float64 and JSON hold it; arrays of labels are uint64. 0 means none.

Rules. A detection that founds a label gives it to its births, and all copies of a particle inherit it. A label is a pure function of
(seed, sensor, tick, detection), and older labels are smaller numbers. The particles of the prior and of background births have none. Such a
particle takes the label of the detection from which more than the share `CLAIMED` of its weight comes. A detection founds no label if a
living label explains at least the share `EXPLAINED` of it: its births then carry that label. So births beside a living track belong to it.
"""

import numpy as np

from protocol.streams import scramble

NO_LABEL = 0
HASH_BITS, TICK_BITS = 29, 24  # of a label: a hash in the low bits, the tick plus one above; 2^24 ticks are 48 days at 4 Hz
EXPLAINED = 0.5  # share of N(z) that the particles of one label must make up
CLAIMED = 0.5  # share of a particle's weight
HELD = 0.5  # a peak keeps the oldest label of at least this share of the weight of its heaviest label


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


def assign_labels(peaks: list[dict[int, float]]) -> list[int]:
    """One label for each peak, no label twice; a peak is the weight of each label in it, 0 left out.

    Each peak asks for the oldest free label that holds at least `HELD` of the weight of its heaviest free label. Of several peaks that ask
    for one label the peak with the most of it gets it, the first of equals, and the others ask again. A peak without a free label takes a
    label derived from its heaviest one; a peak without any label has none.
    """
    given, taken = [NO_LABEL] * len(peaks), set[int]()
    open_peaks = [number for number, peak in enumerate(peaks) if peak]
    while open_peaks:
        asked: dict[int, int] = {}
        for number in open_peaks:
            wanted = _wanted(peaks[number], taken)
            if wanted != NO_LABEL and (wanted not in asked or peaks[number][wanted] > peaks[asked[wanted]][wanted]):
                asked[wanted] = number
        for label, number in asked.items():
            given[number] = label
            taken.add(label)
        if not asked:
            break
        open_peaks = [number for number in open_peaks if given[number] == NO_LABEL]
    for number in open_peaks:
        given[number] = _derived(_wanted(peaks[number], set()), taken)
        taken.add(given[number])
    return given


def _wanted(peak: dict[int, float], taken: set[int]) -> int:
    """The oldest free label that holds enough of a peak; 0 if none is free."""
    free = {label: weight for label, weight in peak.items() if label not in taken}
    most = max(free.values(), default=0.0)
    return min([label for label, weight in free.items() if weight >= HELD * most], default=NO_LABEL)


def _derived(label: int, taken: set[int]) -> int:
    """The first label derived from `label` that is not taken."""
    number = 1
    while derived_label(label, number) in taken:
        number += 1
    return derived_label(label, number)
