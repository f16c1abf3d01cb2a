"""Scores of tracks: how well estimates keep the identities of targets; pure functions of what was true and reported, tick by tick.

Data types: a `TrackTick` holds the targets and the estimates of a tick with their identities, a `Compared` their similarities. That of
positions is 1 - distance / cut-off, at least 0. An estimate can match a target from the similarity 1/2 on, that is up to half the cut-off.

The definitions are those of TrackEval (Luiten and others, IJCV 129, 2021), so that its numbers come out.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from world.assignment import linear_sum_assignment

EPSILON = float(np.finfo(float).eps)
ALPHAS = np.arange(0.05, 0.99, 0.05)  # the thresholds over which HOTA is the mean
MATCHED = 0.5  # least similarity of a match in MOTA and IDF1
KEPT = 1000.0  # weight by which a match of the tick before is preferred


class TrackTick(NamedTuple):
    """A tick: ids (T,) and positions (T, 2) of targets, labels (M,) and positions (M, 2) of estimates, m; no id or label twice."""

    ids: np.ndarray
    targets: np.ndarray
    labels: np.ndarray
    estimates: np.ndarray


class Compared(NamedTuple):
    """A tick whose targets and estimates are compared already: ids (T,), labels (M,) and similarities (T, M) from 0 to 1."""

    ids: np.ndarray
    labels: np.ndarray
    similar: np.ndarray


class TrackScore(NamedTuple):
    """The scores of a run; shares from 0 to 1, except MOTA, which has no lower bound."""

    id_switches: int  # matches of a target whose estimate bears another label than in its match before
    idf1: float
    hota: float
    mota: float


@dataclass(frozen=True)
class _Indexed:
    """Ticks with identities as indices."""

    rows: np.ndarray  # of all ticks, one behind the other: their targets
    columns: np.ndarray  # and their estimates
    sizes: list[tuple[int, int]]  # how many targets and estimates each tick has
    similar: Callable[[int], np.ndarray]  # the similarities (T, M) of the tick at an index; of a long run all would not fit in memory
    target_ticks: np.ndarray  # (G,): the number of ticks of each target
    label_ticks: np.ndarray  # (K,): the same of each label

    @property
    def ticks(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Rows (T,), columns (M,) and similarities (T, M) of each tick."""
        row = column = 0
        for place, (targets, estimates) in enumerate(self.sizes):
            yield self.rows[row : row + targets], self.columns[column : column + estimates], self.similar(place)
            row, column = row + targets, column + estimates


def track_score(ticks: Sequence[TrackTick], cutoff: float) -> TrackScore:
    """All scores of a run.

    >>> place = np.array([[1.0, 2.0]])
    >>> track_score([TrackTick(np.array([7]), place, np.array([label]), place) for label in (3, 3, 4, 4)], 10.0)
    TrackScore(id_switches=1, idf1=0.5, hota=0.707..., mota=0.75)
    """
    return _scores(_of_places(ticks, cutoff))


def score_of(ticks: Sequence[Compared]) -> TrackScore:
    """All scores of a run from any similarities, such as overlaps of boxes; tests compare these with published figures."""
    return _scores(_indexed(ticks, lambda place: ticks[place].similar))


def _scores(indexed: _Indexed) -> TrackScore:
    switches, mota = _clear(indexed)
    return TrackScore(switches, _idf1(indexed), _hota(indexed), mota)


def similarity(targets: np.ndarray, estimates: np.ndarray, cutoff: float) -> np.ndarray:
    """max(0, 1 - d / cutoff) of each target and estimate (T, M)."""
    (x, y), (to_x, to_y) = (np.asarray(places, dtype=float).reshape(-1, 2).T for places in (targets, estimates))
    dx, dy = np.subtract.outer(x, to_x), np.subtract.outer(y, to_y)
    return np.maximum(0.0, 1.0 - np.sqrt(dx * dx + dy * dy) / cutoff)


def _of_places(ticks: Sequence[TrackTick], cutoff: float) -> _Indexed:
    """Ticks with the similarities of their positions."""
    return _indexed(ticks, lambda place: similarity(ticks[place].targets, ticks[place].estimates, cutoff))


def _indexed(ticks: Sequence[TrackTick] | Sequence[Compared], similar: Callable[[int], np.ndarray]) -> _Indexed:
    nothing = np.empty(0, dtype=np.uint64)
    ids, rows = np.unique(np.concatenate([nothing, *(tick.ids.astype(np.uint64) for tick in ticks)]), return_inverse=True)
    labels, columns = np.unique(np.concatenate([nothing, *(tick.labels.astype(np.uint64) for tick in ticks)]), return_inverse=True)
    sizes = [(len(tick.ids), len(tick.labels)) for tick in ticks]
    return _Indexed(rows, columns, sizes, similar, np.bincount(rows, minlength=len(ids)), np.bincount(columns, minlength=len(labels)))


def _assigned(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the assignment with the largest sum."""
    return linear_sum_assignment(-values)


def _clear(indexed: _Indexed) -> tuple[int, float]:
    """Identity switches, and MOTA = 1 - (missed + false + switches) / target-ticks (Bernardin and Stiefelhagen, 2008)."""
    targets, estimates = int(indexed.target_ticks.sum()), int(indexed.label_ticks.sum())
    last, before = np.full(len(indexed.target_ticks), -1), np.full(len(indexed.target_ticks), -1)
    switches = matched = 0
    for rows, columns, similar in indexed.ticks:
        if not len(rows) or not len(columns):
            continue  # as in TrackEval: the matches of the tick before are kept
        values = KEPT * (columns[None, :] == before[rows][:, None]) + similar
        values[similar < MATCHED - EPSILON] = 0.0
        at, to = _assigned(values)
        kept = values[at, to] > EPSILON
        found, names = rows[at[kept]], columns[to[kept]]
        switches += int(np.count_nonzero((last[found] >= 0) & (last[found] != names)))
        matched += len(found)
        before[:] = -1
        last[found] = before[found] = names
    return switches, (matched - (estimates - matched) - switches) / max(1, targets)


def _idf1(indexed: _Indexed) -> float:
    """IDF1 (Ristani and others, 2016): twice the matches under the best one-to-one map of targets to labels, over all ticks of both."""
    together = np.zeros((len(indexed.target_ticks), len(indexed.label_ticks)))
    for rows, columns, similar in indexed.ticks:
        at, to = np.nonzero(similar >= MATCHED)
        together[rows[at], columns[to]] += 1.0
    total = int(indexed.target_ticks.sum() + indexed.label_ticks.sum())
    return 2.0 * float(together[_assigned(together)].sum()) / max(1, total)


def _hota(indexed: _Indexed) -> float:
    """HOTA (Luiten and others, 2021): the mean over thresholds of the geometric mean of detection and association accuracy."""
    targets, labels = indexed.target_ticks, indexed.label_ticks
    likely = np.zeros((len(targets), len(labels)))
    for rows, columns, similar in indexed.ticks:
        at, to = np.nonzero(similar)  # few pairs of all are near each other
        either = similar.sum(axis=0)[to] + similar.sum(axis=1)[at] - similar[at, to]
        likely[rows[at], columns[to]] += np.where(either > EPSILON, similar[at, to] / either, 0.0)
    aligned = likely / np.maximum(targets[:, None] + labels[None, :] - likely, EPSILON)
    pairs, values = [np.empty(0, dtype=np.int64)], [np.empty(0)]
    for rows, columns, similar in indexed.ticks:
        weighted, (at, to) = np.zeros_like(similar), np.nonzero(similar)
        weighted[at, to] = aligned[rows[at], columns[to]] * similar[at, to]
        at, to = _assigned(weighted)
        pairs.append(rows[at] * len(labels) + columns[to])
        values.append(similar[at, to])
    codes, found = np.concatenate(pairs), np.concatenate(values)
    return math.fsum(_hota_at(codes[found >= alpha - EPSILON], targets, labels) for alpha in ALPHAS) / len(ALPHAS)


def _hota_at(codes: np.ndarray, targets: np.ndarray, labels: np.ndarray) -> float:
    """HOTA at one threshold, from the matches as numbers row * K + column."""
    known, counts = np.unique(codes, return_counts=True)
    either = targets[known // max(1, len(labels))] + labels[known % max(1, len(labels))] - counts
    association = float((counts * (counts / np.maximum(1, either))).sum()) / max(1, len(codes))
    detection = len(codes) / max(1, int(targets.sum()) + int(labels.sum()) - len(codes))
    return math.sqrt(detection * association)


def track_ospa(ticks: Sequence[TrackTick], cutoff: float) -> float:
    """OSPA(2) of order 1, m: the OSPA distance of two sets of tracks (Beard, Vo and Vo, IEEE Trans. Signal Processing 68, 2020).

    The distance of two tracks is the mean of min(d, cutoff) over the ticks in which one of them exists, with the cut-off where only one
    does.
    """
    indexed = _of_places(ticks, cutoff)
    shape = len(indexed.target_ticks), len(indexed.label_ticks)
    both, apart = np.zeros(shape), np.zeros(shape)
    for rows, columns, similar in indexed.ticks:
        both[np.ix_(rows, columns)] += 1.0
        apart[np.ix_(rows, columns)] += (1.0 - similar) * cutoff
    if max(shape) == 0:
        return 0.0
    either = indexed.target_ticks[:, None] + indexed.label_ticks[None, :] - both
    distances = (apart + cutoff * (either - both)) / np.maximum(either, 1.0)
    at, to = _assigned(-distances)
    return (float(distances[at, to].sum()) + cutoff * (max(shape) - min(shape))) / max(shape)
