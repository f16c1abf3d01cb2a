"""The tracks of a run: what the agents reported under each label, tick by tick, and the scores of it.

Rules. A label counts once in a tick. Of several estimates with one label, which only agents far apart can report, the one nearest to where
the label was last keeps it; when it is new, the one of the largest existence; of equals the first in the order of the team. The others, and
estimates without a label, are named by their place among those of the tick: derived from the label, or from 0.
"""

import math
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
    """The targets and estimates of all scored ticks."""

    def __init__(self, scenario: Scenario) -> None:
        self.ticks: list[TrackTick] = []
        self.labelled: list[np.ndarray] = []  # (M,) of each tick: whether the agent gave the estimate a label
        self._names = UniqueLabels()
        self._cutoff = scenario.study.cutoff
        self._window = max(1, round(WINDOW / scenario.run.dt))

    def see(self, truth: Truth, estimates: Sequence[Estimate], positions: np.ndarray) -> None:
        """Take a scored tick; `positions` (M, 2) are those of all estimates, m."""
        labels = [label for estimate in estimates for label in estimate.labels.tolist()]
        existence = [value for estimate in estimates for value in estimate.details[:, 5].tolist()]
        self.ticks.append(TrackTick(truth.ids, truth.targets, self._names.of(labels, existence, positions), positions))
        self.labelled.append(np.array(labels, dtype=np.uint64) != NO_LABEL)

    def figures(self) -> dict[str, Any]:
        """The scores, by the names of the fields of `Result`."""
        found = track_score(self.ticks, self._cutoff)
        windows = [self.ticks[start : start + self._window] for start in range(0, len(self.ticks), self._window)]
        ospa = sum(track_ospa(window, self._cutoff) * len(window) for window in windows) / max(1, len(self.ticks))
        return {**found._asdict(), "track_ospa": ospa}


class UniqueLabels:
    """Gives each label to one estimate of a tick, tick after tick, by the rule of this file."""

    def __init__(self) -> None:
        self._last: dict[int, np.ndarray] = {}  # where each label was when it was last reported, m

    def of(self, labels: Sequence[int], existence: Sequence[float], positions: np.ndarray) -> np.ndarray:
        """The labels (M,) uint64 of the estimates of the next tick at `positions` (M, 2) m, none twice."""

        def rank(number: int) -> float:
            last = self._last.get(labels[number])
            return -existence[number] if last is None else math.dist(positions[number], last)

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
        self._last.update({label: positions[number] for label, number in kept.items()})
        return np.array(given, dtype=np.uint64)
