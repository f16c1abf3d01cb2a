"""Weighted particles, and the operations that keep their order.

Data types: `Particles` hold states, weights, 64-bit ids and labels (agents/tracking/labels.py) side by side. Mixtures and estimates
also are columns side by side, so `join` and `select` take them too, and `canonical` takes mixtures.

Rules. The canonical order is by ascending id. Sums run one after the other in the order of the particles, so that a particle that
contributes zero changes no bit.
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np


class Particles(NamedTuple):
    """states (N, 4): x, y in m and vx, vy in m/s; weights (N,): expected targets; ids and labels (N,) uint64."""

    states: np.ndarray
    weights: np.ndarray
    ids: np.ndarray
    labels: np.ndarray  # 0: none


NO_PARTICLES = Particles(np.empty((0, 4)), np.empty(0), np.empty(0, dtype=np.uint64), np.empty(0, dtype=np.uint64))
T = TypeVar("T", bound=NamedTuple)  # of arrays of equal length
WIRE_TYPE = np.float32  # the precision of states on the wire


def unlabelled(states: np.ndarray, weights: np.ndarray, ids: np.ndarray) -> Particles:
    """Particles without labels."""
    return Particles(states, weights, ids, np.zeros(len(ids), dtype=np.uint64))


def join(parts: Sequence[T]) -> T:
    """All rows of several sets, at least one, in order."""
    return parts[0]._make(map(np.concatenate, zip(*parts)))


def select(columns: T, chosen: np.ndarray) -> T:
    """The rows chosen by a mask (N,) bool or by an array of indices."""
    rows = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
    return columns._make([column.take(rows, axis=0) for column in columns])


def canonical(columns: T) -> T:
    """The same rows in ascending order of id, the first of equal ids only."""
    ids: np.ndarray = columns.ids  # type: ignore[attr-defined]  # of particles or of a mixture
    order = np.argsort(ids, kind="stable")
    ids = ids[order]
    if len(ids) > 1:
        order = order[np.concatenate([[True], ids[1:] != ids[:-1]])]
    return select(columns, order)


def total(values: np.ndarray) -> float:
    """The sum of an array (N,), one after the other."""
    return float(np.add.accumulate(values)[-1]) if len(values) else 0.0


def squared_distances(states: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Squared distances (N, M) in m^2 of states (N, 2 or more columns) to points (M, 2)."""
    dx = states[:, 0, None] - points[None, :, 0]
    dy = states[:, 1, None] - points[None, :, 1]
    return dx * dx + dy * dy


def column_sums(values: np.ndarray) -> np.ndarray:
    """Sums of the columns of (N, M), one row after the other: (M,)."""
    return np.add.accumulate(values, axis=0)[-1] if len(values) else np.zeros(values.shape[1])


def mass_within(places: np.ndarray, others: np.ndarray, masses: np.ndarray, radius: float) -> np.ndarray:
    """The sums (N,) of the masses (M,) of other places within `radius` m of each place; places have 2 or more columns, m."""
    return column_sums(np.where(squared_distances(others, places) <= radius * radius, masses[:, None], 0.0))


def mirrored(places: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (N,) mirrored at 0 and at `length` until they lie between, all in m, and True for an odd number of times: (N,) bool."""
    far = (places < -length) | (places > 2.0 * length)
    places = np.where(far, places % (2.0 * length), places)  # two mirrors shift by twice the length; near ones keep their bits
    low, high = places < 0.0, places > length
    return np.where(low, -places, np.where(high, 2.0 * length - places, places)), low | high
