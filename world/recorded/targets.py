"""Recorded targets: the same interface as `world.targets.Targets`, with places that were measured by others."""

from collections.abc import Sequence

import numpy as np

from protocol.settings import ArenaSettings
from world.recorded.tracks import Visit


class RecordedTargets:
    """All targets in the arena at the current tick; outside of it, or silent, a target is away."""

    def __init__(self, visits: Sequence[Visit], arena: ArenaSettings, dt: float, start: float) -> None:
        """`start`: s of the recording at tick 0."""
        self._arena, self._dt, self._start = arena, dt, start
        self._visits = sorted(visits, key=lambda visit: (visit.target, visit.times[0]))
        self._first = np.array([visit.times[0] for visit in self._visits])
        self._last = np.array([visit.times[-1] for visit in self._visits])
        self.tick = 0
        self.positions, self.ids = self._now()

    def step(self) -> None:
        """Go on to the next tick."""
        self.tick += 1
        self.positions, self.ids = self._now()

    @property
    def time(self) -> float:
        """The time of the recording at this tick, s."""
        return self._start + self.tick * self._dt

    def _now(self) -> tuple[np.ndarray, np.ndarray]:
        present = np.flatnonzero((self._first <= self.time) & (self.time <= self._last)).tolist()
        places = np.array([self._visits[number].at(self.time) for number in present]).reshape(-1, 2)
        ids = np.array([self._visits[number].target for number in present], dtype=np.uint64)
        kept = self._arena.holds(*places.T)
        return places[kept], ids[kept]
