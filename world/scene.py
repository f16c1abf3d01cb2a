"""The scene: targets, and what sensors detect of them, at one tick. A pure function of the scenario, its seed, the tick and the poses.

The world has one scene for all bodies. A body process has one for itself. All of them hold the same targets, so no process owns the truth.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from protocol.fields import pack
from protocol.observer_messages import Truth
from protocol.sensing import Pose, SensorModel
from world.config import WorldConfig
from world.detector import Sightings, count_in_view, sightings
from world.sources import sources_of


class Scene:
    """The targets of a run, and the sensors by name."""

    def __init__(self, config: WorldConfig) -> None:
        self.targets, self.bodies, self._detector = sources_of(config)
        self.sensors: dict[str, SensorModel] = {}
        self._dt = config.run.dt

    def step_until(self, tick: int) -> None:
        """Bring the targets to a later tick."""
        while self.targets.tick < tick:
            self.targets.step()

    def scans(self, poses: Mapping[str, Pose]) -> tuple[list[np.ndarray], int]:
        """The detections (M, 2) float32 of the sensor of each name at its pose, and the number of targets in view of any."""
        names = list(poses)
        sensors, seen = self._see(poses)
        targets = self.targets
        scans = self._detector.scans(sensors, list(poses.values()), names, targets.positions, targets.ids, targets.tick, seen)
        return scans, count_in_view(seen)

    def in_view(self, poses: Mapping[str, Pose]) -> int:
        """The number of targets in view of the sensor of any of these names at its pose."""
        return count_in_view(self._see(poses)[1])

    def _see(self, poses: Mapping[str, Pose]) -> tuple[Sequence[SensorModel], Sightings]:
        sensors = [self.sensors[name] for name in poses]
        return sensors, sightings(sensors, list(poses.values()), self.targets.positions)

    def truth(self, poses: Mapping[str, Pose], in_view: int, alive: Iterable[str], sender: str, incarnation: int) -> Truth:
        """The Truth of this tick with bodies at these poses."""
        return Truth(
            sender=sender,
            incarnation=incarnation,
            tick=self.targets.tick,
            time=self.targets.tick * self._dt,
            targets_bytes=pack(self.targets.positions, "<f8"),
            ids_bytes=pack(self.targets.ids, "<u8"),
            bodies=tuple(poses),
            poses_bytes=pack(np.array(list(poses.values())), "<f8"),
            in_view=in_view,
            alive=tuple(alive),
        )
