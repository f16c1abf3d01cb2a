"""Compiled settling of labels: the bit-for-bit twin of agents/tracking/settling.py.

Rules as in agents/compiled/particle_kernels.py. Arrays that describe the labels in a cell have one row a label, the oldest first.
"""

import numpy as np
from numba import njit

from agents.compiled.cache import cached
from agents.compiled.label_kernels import NO_LABEL, birth_label

# The constants of agents/tracking/settling.py, which a test compares.
TOO_MUCH, SPLIT, NEAR, FAR, SAME, ONE, LEAST = 1.4, 0.4, 3.0, 2.0, 1.5, 1.1, 0.02


@njit
def _apart(states: np.ndarray, n: int, middle: np.ndarray) -> float:
    """Twin of `settling._apart` for one state."""
    dx, dy = states[n, 0] - middle[0], states[n, 1] - middle[1]
    return dx * dx + dy * dy


@njit
def _unlike(states: np.ndarray, n: int, middle: np.ndarray) -> float:
    """Twin of `settling._unlike` for one state."""
    east, north = states[n, 2] - middle[2], states[n, 3] - middle[3]
    return _apart(states, n, middle) + (east * east + north * north)


@njit
def _known(labels: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The labels of some rows, ascending, each once."""
    found, count = np.empty(len(rows), np.uint64), 0
    for n in rows:
        place = 0
        while place < count and found[place] != labels[n]:
            place += 1
        if place == count:
            found[count] = labels[n]
            count += 1
    return np.sort(found[:count])


@njit
def _holdings(
    known: np.ndarray, rows: np.ndarray, outside: np.ndarray, updated: tuple, predicted: tuple, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Twin of `settling._holding` for all labels: masses inside (L,) and around (L,), and middles (L, 4)."""
    states, weights, _, labels = updated
    inside, around, middles = np.zeros(len(known)), np.zeros(len(known)), np.zeros((len(known), 4))
    for n in rows:
        k = np.searchsorted(known, labels[n])
        inside[k] += weights[n]
        for axis in range(4):
            middles[k, axis] += weights[n] * states[n, axis]
    for k in range(len(known)):
        middles[k] /= inside[k] if inside[k] > 0.0 else 1.0
    for n in outside:
        k = np.searchsorted(known, predicted[1][n])
        if k < len(known) and known[k] == predicted[1][n] and _apart(states, n, middles[k]) <= reach * reach:
            around[k] += predicted[0][n]
    return inside, around, middles


@njit
def _move(
    giver: np.uint64, middle: np.ndarray, like: np.ndarray, most: float, label: np.uint64, new: np.ndarray, rows: np.ndarray, updated: tuple
) -> float:
    """Twin of `settling._move`: rename particles in the labels `new`, and return their mass."""
    states, weights = updated[0], updated[1]
    mine, differences, count = np.empty(len(rows), np.int64), np.empty(len(rows)), 0
    for n in rows:
        if new[n] == giver:
            mine[count], differences[count] = n, _unlike(states, n, like) - _unlike(states, n, middle)
            count += 1
    order, moved = np.argsort(differences[:count], kind="mergesort"), 0.0
    for rank in range(count):
        n = mine[order[rank]]
        if not moved + weights[n] <= most:
            break
        moved += weights[n]
        new[n] = label
    return moved


@njit
def _give(number: int, held: tuple, new: np.ndarray, rows: np.ndarray, updated: tuple, stamp: np.uint64) -> None:
    """Twin of `settling._give`."""
    known, inside, around, middles = held
    giver, middle, mass = known[number], middles[number], inside[number] + around[number]
    if mass <= TOO_MUCH:
        return
    rest = min(inside[number], mass - 1.0) if inside[number] < around[number] else inside[number] - 1.0
    for other in range(len(known)):
        dx, dy, has = middle[0] - middles[other, 0], middle[1] - middles[other, 1], inside[other] + around[other]
        if other != number and rest > 0.0 and has < 1.0 and dx * dx + dy * dy <= NEAR * NEAR:
            moved = _move(giver, middle, middles[other], min(rest, 1.0 - has), known[other], new, rows, updated)
            inside[other] += moved
            inside[number] -= moved
            rest -= moved
    farthest, first = -1.0, -1
    for n in rows:
        if new[n] == giver and _apart(updated[0], n, middle) > farthest:
            farthest, first = _apart(updated[0], n, middle), n
    if rest > SPLIT and first >= 0 and (around[number] > inside[number] or farthest >= FAR * FAR):
        inside[number] -= _move(giver, middle, updated[0][first], rest, birth_label(updated[2][first], stamp), new, rows, updated)


@cached
def settle(updated: tuple, owned: np.ndarray, predicted: tuple, reach: float, stamp: np.uint64) -> np.ndarray:
    """Twin of `settling.settled`; `updated` is states, weights, ids and labels, `predicted` the weights and labels of the first rows.

    `stamp` holds the bits of the tick (`label_kernels.stamp_of`).
    """
    _, _, _, labels = updated
    rows, outside, some, others = np.empty(len(labels), np.int64), np.empty(len(labels), np.int64), 0, 0
    for n in range(len(labels)):
        rows[some] = n
        some += owned[n] & (labels[n] != NO_LABEL)
    for n in range(len(predicted[1])):
        outside[others] = n
        others += (not owned[n]) & (predicted[1][n] != NO_LABEL)
    rows, new = rows[:some], labels.copy()
    known = _known(labels, rows)
    inside, around, middles = _holdings(known, rows, outside[:others], updated, predicted, reach)
    heavy = inside >= LEAST
    known, inside, around, middles = known[heavy], inside[heavy], around[heavy], middles[heavy]
    for number in range(len(known)):
        _give(number, (known, inside, around, middles), new, rows, updated, stamp)
    for number in range(len(known)):
        for other in range(number + 1, len(known)):
            dx, dy = middles[number, 0] - middles[other, 0], middles[number, 1] - middles[other, 1]
            is_same = dx * dx + dy * dy <= SAME * SAME and 0.0 < inside[other] <= inside[number]
            if is_same and (inside[number] + around[number]) + (inside[other] + around[other]) <= ONE:
                new[rows] = np.where(new[rows] == known[other], known[number], new[rows])
                inside[number] += inside[other]
                inside[other] = 0.0
    return new
