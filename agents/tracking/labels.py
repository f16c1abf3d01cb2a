"""Labels: the identities of targets, carried by the particles.

Data types: a label is an integer below 2^53, so that a float64 and JSON hold it; arrays of labels are uint64. 0 means none.

Rules. A detection that founds a label gives it to its births, and all copies of a particle inherit it. A label is a pure function of (seed,
sensor, tick, detection), and older labels are smaller numbers until the tick passes 2^24 and counts anew. The particles of the prior and of
background births have none. Such a particle takes the label of the detection from which more than the share `ADOPTED_SHARE` of its weight
comes. A detection founds no label if a living label explains at least the share `EXPLAINED_SHARE` of it: its births then carry that label.
So births beside a living track belong to it.

A label stands for one target, so estimates and labels go together one to one (`name_peaks`). Two targets that meet exchange particles,
and when they part, each keeps some of the other's label. The owner of a cell then renames these particles in it (`renamed`), and its gossip
states the result. It reads the particles in its cell after all scans, and around it the stated particles as predicted: both have the same
bits in every filter. Weights and states never change.
"""

from collections import Counter

import numpy as np

from agents.tracking.particles import Particles, squared_distances, total
from protocol.random_streams import scramble

NO_LABEL = 0
HASH_BITS, TICK_BITS = 29, 24  # of a label: a hash in the low bits, the tick plus one above; 2^24 ticks are 48 days at 4 Hz
EXPLAINED_SHARE = 0.02  # share of N(z) that the particles of one label must make up
ADOPTED_SHARE = 0.5  # share of a particle's weight
YOUNG_TICKS = 4  # ticks after which a label is no longer young
# Lengths are in bins of `extraction.bin`, the scale on which targets are told apart.
ADOPTION_RADIUS = 5.0  # between a peak and the mean of the label that it takes although none of its particles bear it
FAINT_MASS = 0.02  # mass below which a label is not taken so, expected targets
ALONE_RADIUS = 3.0  # around an estimate without another estimate
INNER_RADIUS, OUTER_RADIUS = 2.5, 6.0  # around an estimate: its particles are nearer than the first, those around it nearer than the second
INTRUDER_MASS = 0.5  # that a label must have around an estimate to be an intruder there, expected targets


def birth_labels(hashes: np.ndarray, tick: int) -> np.ndarray:
    """The labels (M,) of births at `tick`; `hashes` (M,) uint64 are functions of (seed, sensor, tick, detection).

    The hash of a birth of particles is the id of the first one at its detection.
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
    """The label other than 0 with the most weight, the smallest of equals, and its weight; (0, 0.0) if there is none."""
    found = weight_by_label(labels, weights)
    label = heaviest_label(found)
    return label, found.get(label, 0.0)


def heaviest_label(weights: dict[int, float]) -> int:
    """The label with the most weight, the smallest of equals; 0 without any."""
    return max(weights, key=lambda label: (weights[label], -label), default=NO_LABEL)


def mean_positions(particles: Particles) -> dict[int, tuple[float, float]]:
    """The mean position in m of the particles of each label that has a mass of at least `FAINT_MASS`."""
    known, places = np.unique(particles.labels, return_inverse=True)
    masses, east, north = (
        np.bincount(places, particles.weights * factors, len(known)) for factors in (1.0, particles.states[:, 0], particles.states[:, 1])
    )
    rows = np.flatnonzero((masses >= FAINT_MASS) & (known != NO_LABEL))
    return {int(known[row]): (float(east[row] / masses[row]), float(north[row] / masses[row])) for row in rows}


def given_labels(labels: np.ndarray, terms: np.ndarray, norms: np.ndarray, founded: np.ndarray) -> np.ndarray:
    """The labels (M,) that detections give: of a living label that explains them, or the `founded` ones (M,).

    `labels` (N,) are those of what the PHD is made of, `terms` (N, M) the terms w p_d g(z) of it, and `norms` (M,) the sums N(z).
    """
    given = founded.copy()
    for number in range(len(norms)):
        rows = np.flatnonzero(terms[:, number])
        label, weight = heaviest(labels[rows], terms[rows, number])
        if label != NO_LABEL and weight >= EXPLAINED_SHARE * norms[number]:
            given[number] = label
    return given


def name_peaks(
    peaks: list[dict[int, float]], places: np.ndarray, known: dict[int, tuple[float, float]], tick: int, size: float
) -> list[int]:
    """One label for each peak, no label twice; a peak is the weight of each label in it, 0 left out.

    `places` (M, 2) are the peaks and `known` the `mean_positions` of labels around, m; bins have the side `size` m. The pair of peak and
    label with the largest weight comes first, then the next of the peaks and labels that are left; of equals the older label, then the
    first peak. A peak that is left then takes the nearest label without a peak within `ADOPTION_RADIUS`. So does a peak whose label is
    young, if the other label is older: most peaks of young labels are clutter beside a target that was missed. A peak that is still left
    takes a label derived from its heaviest one, and a peak without any label has none.
    """
    given, taken = [NO_LABEL] * len(peaks), {NO_LABEL}
    for _, label, number in sorted((-weight, label, number) for number, peak in enumerate(peaks) for label, weight in peak.items()):
        if given[number] == NO_LABEL and label not in taken:
            given[number] = label
            taken.add(label)
    free = {label: middle for label, middle in sorted(known.items()) if label not in taken}
    for number, place in enumerate(places):
        if given[number] == NO_LABEL or is_young(given[number], tick):
            label = _beside(place, free, ADOPTION_RADIUS * size)
            if label != NO_LABEL and (given[number] == NO_LABEL or label < given[number]):
                given[number] = label
                del free[label]
    taken, derived = {*given}, Counter[int]()
    for number, peak in enumerate(peaks):
        old = heaviest_label(peak)
        while given[number] == NO_LABEL and peak:  # what was derived from a label before is taken
            derived[old] += 1
            label = derived_label(old, derived[old])
            if label not in taken:
                given[number] = label
                taken.add(label)
    return given


def is_young(label: int, tick: int) -> bool:
    """Whether a label was founded at most `YOUNG_TICKS` ticks before a tick."""
    return (tick + 1 - (label >> HASH_BITS)) % (1 << TICK_BITS) <= YOUNG_TICKS


def _beside(place: np.ndarray, free: dict[int, tuple[float, float]], reach: float) -> int:
    """The label whose middle is nearest to a place, less than `reach` m away, the first of equals; 0: none."""
    found, least = NO_LABEL, reach * reach
    for label, (x, y) in free.items():
        dx, dy = x - place[0], y - place[1]
        apart = dx * dx + dy * dy
        if apart < least:
            found, least = label, apart
    return found


def renamed(updated: Particles, owned: np.ndarray, predicted: Particles, places: np.ndarray, size: float) -> np.ndarray:
    """The labels (N,) of `updated` after the owner of the particles marked in `owned` (N,) has renamed some of them.

    `predicted` are the first rows of `updated` before the scans, and `places` (M, 2) the estimates in the cell, m. Bins have the side
    `size` m. A label is an intruder at an estimate if it has more mass around than here, and at least `INTRUDER_MASS`. Where an estimate is
    alone, the owned particles of intruders take the heaviest label here that is none. If all are intruders, they take a label
    derived from the heaviest.
    """
    labels, count = updated.labels.copy(), len(predicted.ids)
    if not len(places) or not len(labels):
        return labels
    weights, before = np.where(owned, updated.weights, 0.0), updated.labels.copy()
    weights[:count] = np.where(owned[:count], weights[:count], predicted.weights)
    before[:count] = np.where(owned[:count], before[:count], predicted.labels)
    between, away = squared_distances(places, places), squared_distances(updated.states, places)
    alone, inner, outer = ALONE_RADIUS * size, INNER_RADIUS * size, OUTER_RADIUS * size
    np.fill_diagonal(between, np.inf)
    for number in np.flatnonzero(between.min(axis=1) > alone * alone):
        here, near = away[:, number] <= inner * inner, away[:, number] <= outer * outer
        known = np.unique(before[here & owned & (before != NO_LABEL)])
        masses = [(total(weights[here & (before == label)]), total(weights[near & ~here & (before == label)])) for label in known]
        strange = np.array([around > inside and around >= INTRUDER_MASS for inside, around in masses], dtype=bool)
        if not strange.any():
            continue
        at_home = [(-inside, int(label)) for (inside, _), label, is_strange in zip(masses, known, strange) if not is_strange]
        label = min(at_home)[1] if at_home else derived_label(min((-inside, int(label)) for (inside, _), label in zip(masses, known))[1], 1)
        labels[here & owned & np.isin(before, known[strange])] = label
    return labels
