"""Where OSPA and GOSPA of a run come from: targets that no sensor ever saw, lost ones, those in view, and false estimates.

Data types: `Parts` are shares of the OSPA or the GOSPA of one tick, in m; they add up to it.

Rules. A target is *in view* inside the footprint of a living member's body; guests do not count. It is *lost* when it was in view
before, and *never seen* otherwise. Only watchers compute this: it needs the true targets.
"""

from typing import NamedTuple

import numpy as np

from deploy.scenario import Scenario
from protocol.observer_messages import Truth
from protocol.sensing import SensorModel
from protocol.settings import sensor_of
from world.assignment import linear_sum_assignment


class Parts(NamedTuple):
    """The parts of the OSPA or the GOSPA of a tick, m."""

    never_seen: float
    lost: float
    in_view: float
    false: float


class ErrorParts:
    """Splits OSPA and GOSPA of each tick; `see` takes the ticks in order."""

    def __init__(self, scenario: Scenario) -> None:
        self.parts: list[Parts] = []
        self.gospa_parts: list[Parts] = []
        self._cutoff = scenario.study.cutoff
        self._seen: set[int] = set()
        self._sensors: dict[str, SensorModel] = {name: sensor_of(scenario, kind) for name, kind in scenario.members.items()}

    def see(self, truth: Truth, estimates: np.ndarray) -> None:
        """Take the truth of a tick and the estimates (M, 2) of all agents, m."""
        visible, ids = self._in_view(truth), truth.ids.tolist()
        known = np.array([one in self._seen for one in ids], dtype=bool)
        costs, number, most = target_costs(truth.targets, estimates, self._cutoff), len(ids), max(1, len(ids), len(estimates))
        groups, found = (~visible & ~known, ~visible & known, visible), costs < self._cutoff
        never, lost, seen = (float(costs[rows].sum()) for rows in groups)
        false = self._cutoff * max(0, len(estimates) - number)
        self.parts.append(Parts(never / most, lost / most, seen / most, false / most))
        halves = np.where(found, costs, 0.5 * self._cutoff)  # of a pair at the cut-off, the other half is a false estimate
        never, lost, seen = (float(halves[rows].sum()) for rows in groups)
        self.gospa_parts.append(Parts(never, lost, seen, 0.5 * self._cutoff * float(len(estimates) - found.sum())))
        self._seen.update(one for one, sees in zip(ids, visible.tolist()) if sees)

    def mean(self) -> Parts:
        """The means of the OSPA's parts over the ticks so far; zeros before the first."""
        return _means(self.parts)

    def mean_gospa(self) -> Parts:
        """The same of the GOSPA's parts."""
        return _means(self.gospa_parts)

    def _in_view(self, truth: Truth) -> np.ndarray:
        """Which targets some living member's body has in its footprint, (T,) bool."""
        visible, alive = np.zeros(len(truth.ids), dtype=bool), set(truth.alive)
        for name, (x, y, heading) in zip(truth.bodies, truth.poses.tolist()):
            if name in alive and name in self._sensors:
                visible |= self._sensors[name].probability(truth.targets, (x, y, heading)) > 0.0
        return visible


def _means(parts: list[Parts]) -> Parts:
    """The means of parts; zeros of none."""
    return Parts(*np.mean(parts, axis=0).tolist()) if parts else Parts(0.0, 0.0, 0.0, 0.0)


def target_costs(truth: np.ndarray, estimates: np.ndarray, cutoff: float) -> np.ndarray:
    """What each target (T, 2) costs in the best assignment to the estimates (M, 2), m: its distance, at most `cutoff` m; (T,)."""
    costs = np.full(len(truth), cutoff)
    if len(truth) and len(estimates):
        apart = np.minimum(np.hypot(truth[:, 0, None] - estimates[:, 0], truth[:, 1, None] - estimates[:, 1]), cutoff)
        rows, columns = linear_sum_assignment(apart)
        costs[rows] = apart[rows, columns]
    return costs
