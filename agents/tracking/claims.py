"""Claims: cells stated by their generators; the points of a claimed cell, points in no claim, and conflicts between claims.

Data types: a `Claim` holds the generators that bound a cell, the owner's first; `Claims` hold those of several claims end to end.

Rules. A receiver decides with the same arithmetic as the owner which particles lie in a claimed cell. A tie goes to the generator
that comes first in the order of names.
"""

import math
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from agents.coverage.cells import Cell
from agents.tracking.particles import squared_distances
from protocol.keys import order
from protocol.settings import ArenaSettings


class Claim(NamedTuple):
    """A cell as its owner states it: generators (G, 3) of x, y and power radius, the owner's first."""

    names: tuple[str, ...]
    generators: np.ndarray
    wins_ties: np.ndarray  # (G,) bool: this generator comes before the owner in the order of names


NO_CLAIM = Claim((), np.empty((0, 3)), np.empty(0, dtype=bool))


def make_claim(names: tuple[str, ...], generators: np.ndarray) -> Claim:
    """The claim of the owner `names[0]`; without names it claims nothing."""
    if not names:
        return NO_CLAIM
    ranks = [order(name) for name in names]
    return Claim(names, generators, np.array([rank < ranks[0] for rank in ranks], dtype=bool))


def claim_of(cell: Cell, names: tuple[str, ...], generators: np.ndarray) -> Claim:
    """A cell as generators, the own one first; `names` and `generators` (N, 3) are those of the diagram."""
    return make_claim(tuple([names[index] for index in cell.bounding]), generators[[*cell.bounding]])


class Claims(NamedTuple):
    """Several claims, and their generators end to end."""

    each: Sequence[Claim]
    generators: np.ndarray  # (G, 3)
    wins_ties: np.ndarray  # (G,) bool
    ends: np.ndarray  # (C,): the end of each claim in these arrays


def end_to_end(claims: Sequence[Claim]) -> Claims:
    """The claims, at least one, with their generators end to end."""
    generators, wins = np.concatenate([claim.generators for claim in claims]), np.concatenate([claim.wins_ties for claim in claims])
    return Claims(claims, generators, wins, np.array(list(accumulate([len(claim.names) for claim in claims]))))


def power_distances(points: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """Power distances |x - p|^2 - r^2 in m^2 (15) of points (N, 2) to generators (G, 3): (N, G)."""
    return squared_distances(points, generators) - generators[None, :, 2] * generators[None, :, 2]


def owned(points: np.ndarray, claim: Claim, arena: ArenaSettings) -> np.ndarray:
    """True for the points (N, 2 or more columns) in the arena and in the claimed cell: (N,) bool."""
    if not claim.names:
        return np.zeros(len(points), dtype=bool)
    distances = power_distances(points, claim.generators)
    mine = distances[:, :1]
    inside: np.ndarray = np.all(np.where(claim.wins_ties[None, :], mine < distances, mine <= distances), axis=1)
    return inside & arena.holds(points[:, 0], points[:, 1])


def depths(points: np.ndarray, claim: Claim) -> np.ndarray:
    """Depths in m of points (N, 2) inside a claimed cell: (N,), the distance to the nearest bisector, negative outside."""
    if len(claim.names) < 2:
        return np.full(len(points), math.inf)
    distances = power_distances(points, claim.generators)
    offsets = claim.generators[1:, :2] - claim.generators[0, :2]
    spans = np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    return ((distances[:, 1:] - distances[:, :1]) / (2.0 * np.maximum(spans, 1e-9))).min(axis=1)


def orphaned(points: np.ndarray, claims: Claims, arena: ArenaSettings) -> np.ndarray:
    """True for the points (N, 2 or more columns) in none of the claimed cells: (N,) bool."""
    free = np.arange(len(points))
    for claim in claims.each:
        free = free[~owned(points[free], claim, arena)]
    found = np.zeros(len(points), dtype=bool)
    found[free] = True
    return found


def resolve_conflicts(points: np.ndarray, sizes: Sequence[int], claims: Claims, hashes: Sequence[int], overlap: float) -> np.ndarray:
    """True for the stated points (N, 2 or more columns) that count: (N,) bool.

    The points stand claim after claim, `sizes` of each. A point does not count if it lies more than `overlap` m deep inside a rival
    claim. A rival claim is cut from another diagram, by `hashes`, and its owner is nearer to the point in power distance.
    """
    keep, start = np.ones(len(points), dtype=bool), 0
    for size, claim, hashed in zip(sizes, claims.each, hashes):
        first, start = start, start + size
        rivals = [other for other, another in zip(claims.each, hashes) if another != hashed and other.names]
        if not size or not rivals:
            continue
        stated = points[first:start]
        own = power_distances(stated, claim.generators[:1])
        nearer = power_distances(stated, np.array([rival.generators[0] for rival in rivals])) < own
        for number in np.flatnonzero(nearer.any(axis=0)).tolist():
            there = np.flatnonzero(nearer[:, number] & keep[first:start])
            keep[first + there] = depths(stated[there], rivals[number]) <= overlap
    return keep
