"""Settling: the labels of the particles in a cell after the scans of a tick, so that a label stands for one target.

Data types: a `Holding` is what the particles of one label in the cell are together.

Rules. The owner of a cell settles it, and its gossip states the result. It reads the particles in its cell after all scans, and around it
the stated particles as predicted: both have the same bits in every filter. Weights and states never change. Masses are in expected targets.
"""

from typing import NamedTuple

import numpy as np

from agents.tracking.labels import NO_LABEL, birth_labels
from agents.tracking.particles import Particles, total

TOO_MUCH = 1.4  # mass from which on a label stands for more than one target
SPLIT = 0.4  # mass that founds a label where no other one lacks any
NEAR = 3.0  # m between the middles of labels that exchange particles
FAR = 2.0  # m from the middle of a label: particles that far are another target
SAME = 1.5  # m between the middles of labels that may stand for one target
ONE = 1.1  # mass up to which they do
LEAST = 0.02  # mass below which a label is left as it is


class Holding(NamedTuple):
    """One label in a cell: the mass inside, the mass of the same label around, and the mean state, in m and m/s."""

    label: int
    inside: float
    around: float
    middle: np.ndarray  # (4,)

    @property
    def mass(self) -> float:
        """Inside and around together."""
        return self.inside + self.around


def settled(updated: Particles, owned: np.ndarray, predicted: Particles, reach: float, tick: int) -> np.ndarray:
    """The labels (N,) of `updated` after the owner of the particles marked in `owned` (N,) has settled them.

    `predicted` are the first rows of `updated` before the scans; those within `reach` m of the middle of a label count as around it.

    A label of more than `TOO_MUCH` gives what exceeds one target to labels near it that lack mass, the older first: the particles that are
    most like theirs. Where none lacks mass the rest founds a label. If more of the label lies outside the cell than inside, the inside
    gives what both together have too much. A label takes over a younger, lighter one at the same place if both together are one target.
    """
    rows = np.flatnonzero(owned & (updated.labels != NO_LABEL))
    labels = updated.labels.copy()
    if not len(rows):
        return labels
    outside = np.flatnonzero(~owned[: len(predicted.ids)] & (predicted.labels != NO_LABEL))
    held = [_holding(int(label), rows, outside, updated, predicted, reach) for label in np.unique(updated.labels[rows])]
    held = [one for one in held if one.inside >= LEAST]
    for number in range(len(held)):
        _give(number, held, labels, rows, updated, tick)
    _unite(held, labels, rows)
    return labels


def _holding(label: int, rows: np.ndarray, outside: np.ndarray, updated: Particles, predicted: Particles, reach: float) -> Holding:
    """What a label holds inside, by `rows` of the updated particles, and around, by those of the predicted ones."""
    mine = rows[updated.labels[rows] == label]
    weights, states = updated.weights[mine], updated.states[mine]
    inside = total(weights)
    middle = np.array([total(weights * column) for column in states.T]) / (inside if inside > 0.0 else 1.0)
    others = outside[predicted.labels[outside] == label]
    close = _apart(predicted.states[others], middle) <= reach * reach
    return Holding(label, inside, total(predicted.weights[others][close]), middle)


def _apart(states: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Squared distances (N,) in m^2 of states from a state."""
    dx, dy = states[:, 0] - middle[0], states[:, 1] - middle[1]
    return dx * dx + dy * dy


def _unlike(states: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """The same and the squared distances of the velocities in m^2/s^2, (N,): how unlike states are to a state."""
    east, north = states[:, 2] - middle[2], states[:, 3] - middle[3]
    return _apart(states, middle) + (east * east + north * north)


def _give(number: int, held: list[Holding], labels: np.ndarray, rows: np.ndarray, updated: Particles, tick: int) -> None:
    """Give away what a label has too much."""
    giver = held[number]
    if giver.mass <= TOO_MUCH:
        return
    rest = min(giver.inside, giver.mass - 1.0) if giver.inside < giver.around else giver.inside - 1.0
    for other, taker in enumerate(held):
        apart = giver.middle - taker.middle
        if other != number and rest > 0.0 and taker.mass < 1.0 and apart[0] * apart[0] + apart[1] * apart[1] <= NEAR * NEAR:
            moved = _move(giver, taker.middle, min(rest, 1.0 - taker.mass), taker.label, labels, rows, updated)
            held[other] = taker._replace(inside=taker.inside + moved)
            held[number] = held[number]._replace(inside=held[number].inside - moved)
            rest -= moved
    mine = rows[labels[rows] == giver.label]
    if rest > SPLIT and len(mine):
        far = _apart(updated.states[mine], giver.middle)
        first = mine[int(far.argmax())]
        if giver.around > held[number].inside or far.max() >= FAR * FAR:
            label = int(birth_labels(updated.ids[first : first + 1], tick)[0])
            moved = _move(giver, updated.states[first], rest, label, labels, rows, updated)
            held[number] = held[number]._replace(inside=held[number].inside - moved)


def _move(giver: Holding, like: np.ndarray, most: float, label: int, labels: np.ndarray, rows: np.ndarray, updated: Particles) -> float:
    """Rename particles of a label, at most a mass of `most`, those first that are more like a state than like its middle: the mass."""
    mine = rows[labels[rows] == giver.label]
    order = mine[np.argsort(_unlike(updated.states[mine], like) - _unlike(updated.states[mine], giver.middle), kind="stable")]
    sums = np.add.accumulate(updated.weights[order])
    count = int(np.searchsorted(sums, most, side="right"))
    labels[order[:count]] = label
    return float(sums[count - 1]) if count else 0.0


def _unite(held: list[Holding], labels: np.ndarray, rows: np.ndarray) -> None:
    """Let a label take over a younger and lighter one at the same place if both together are one target."""
    for number in range(len(held)):
        for other in range(number + 1, len(held)):
            old, young = held[number], held[other]
            apart = old.middle - young.middle
            is_same = apart[0] * apart[0] + apart[1] * apart[1] <= SAME * SAME
            if is_same and 0.0 < young.inside <= old.inside and old.mass + young.mass <= ONE:
                labels[rows[labels[rows] == young.label]] = old.label
                held[number] = old._replace(inside=old.inside + young.inside)
                held[other] = young._replace(inside=0.0)
