"""The tracks of a run: what the agents reported under each label, tick by tick, and the scores of it.

Rules. A label counts once in a tick. Of several estimates with one label, which only agents far apart can report, the one nearest to where
the label was last keeps it; when it is new, the one of the largest existence; of equals the first in the order of the team. The others, and
estimates without a label, are named by their place among those of the tick: derived from the label, or from 0.
"""

import math
from array import array
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.tracking.labels import NO_LABEL, derived_label
from deploy.scenario import Scenario
from protocol.observer_messages import Estimate, Truth
from world.track_score import TrackTick, track_ospa, track_score

WINDOW = 10.0  # s: OSPA(2) is the mean over windows of this length


class TrackLog:
    """The targets and estimates of all scored ticks, end to end: arrays of each tick would take three times the memory of their numbers."""

    def __init__(self, scenario: Scenario) -> None:
        self._ids, self._targets, self._labels, self._estimates, self._labelled = (bytearray() for _ in range(5))
        self._sizes = array("Q")  # of each tick: targets, estimates
        self._names = UniqueLabels()
        self._cutoff = scenario.study.cutoff
        self._window = max(1, round(WINDOW / scenario.run.dt))

    def see(self, truth: Truth, estimates: Sequence[Estimate], positions: np.ndarray) -> None:
        """Take a scored tick; `positions` (M, 2) are those of all estimates, m."""
        labels = [label for estimate in estimates for label in estimate.labels.tolist()]
        existence = [value for estimate in estimates for value in estimate.details[:, 5].tolist()]
        self._ids += truth.ids.tobytes()
        self._targets += truth.targets.tobytes()
        self._labels += self._names.of(labels, existence, positions).tobytes()
        self._estimates += positions.tobytes()
        self._labelled += bytes(label != NO_LABEL for label in labels)
        self._sizes.extend((len(truth.ids), len(positions)))

    @property
    def ticks(self) -> list[TrackTick]:
        """All ticks; the list is built anew at each call."""
        targets, estimates = np.array(self._sizes, dtype=np.int64).reshape(-1, 2).T
        ids, labels = _split(self._ids, np.uint64, targets), _split(self._labels, np.uint64, estimates)
        places = (part.reshape(-1, 2) for part in _split(self._targets, np.float64, 2 * targets))
        found = (part.reshape(-1, 2) for part in _split(self._estimates, np.float64, 2 * estimates))
        return list(map(TrackTick, ids, places, labels, found))

    @property
    def labelled(self) -> list[np.ndarray]:
        """(M,) bool of each tick: whether the agent gave the estimate a label."""
        return _split(self._labelled, np.bool_, np.array(self._sizes[1::2], dtype=np.int64))

    def figures(self) -> dict[str, Any]:
        """The scores, by the names of the fields of `Result`."""
        ticks = self.ticks
        found = track_score(ticks, self._cutoff)
        windows = [ticks[start : start + self._window] for start in range(0, len(ticks), self._window)]
        ospa = sum(track_ospa(window, self._cutoff) * len(window) for window in windows) / max(1, len(ticks))
        return {**found._asdict(), "track_ospa": ospa}


def _split(column: bytearray, kind: type[np.generic], sizes: np.ndarray) -> list[np.ndarray]:
    """A column cut into ticks; `sizes` (ticks,) says how many values each tick has."""
    return np.split(np.frombuffer(bytes(column), kind), np.cumsum(sizes))[:-1]


class UniqueLabels:
    """Gives each label to one estimate of a tick, tick after tick, by the rule of this file."""

    def __init__(self) -> None:
        self._last: dict[int, list[float]] = {}  # where each label was when it was last reported, m

    def of(self, labels: Sequence[int], existence: Sequence[float], positions: np.ndarray) -> np.ndarray:
        """The labels (M,) uint64 of the estimates of the next tick at `positions` (M, 2) m, none twice."""

        places: list[list[float]] = positions.tolist()

        def rank(number: int) -> float:
            last = self._last.get(labels[number])
            return -existence[number] if last is None else math.dist(places[number], last)

        given, taken, kept, counts = list(labels), {NO_LABEL, *labels}, dict[int, int](), Counter[int]()
        for number, label in enumerate(labels):
            if label != NO_LABEL and (label not in kept or rank(number) < rank(kept[label])):
                kept[label] = number
        for number, label in enumerate(labels):
            if kept.get(label) != number:
                while given[number] in taken:
                    counts[label] += 1  # none is tried twice: anybody may state thousands of estimates with one label
                    given[number] = derived_label(label, counts[label])
                taken.add(given[number])
        self._last.update({label: places[number] for label, number in kept.items()})
        return np.array(given, dtype=np.uint64)
