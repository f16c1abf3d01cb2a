"""Replayed robots: bodies that go where they went, and scans that return what their sensors returned.

Rules. A frame is what a sensor measured at one moment. Each frame goes into the scan of the tick nearest to its moment, or into the next
one that is free, so that no scan holds a target twice. Ticks that are too long for that are refused. The ranges and bearings of a frame
are stated from the pose of that tick: the robot's own motion between the two moments is taken out, and the target is taken to stand still
for so long.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from protocol.fields import MAX_DETECTIONS
from protocol.geometry import wrap_angle
from protocol.messages import Command
from protocol.sensing import Pose, SensorModel
from protocol.settings import BadSetting
from world.detector import Sightings
from world.recorded.targets import RecordedTargets
from world.recorded.tracks import ReplayedBody

MOST_LATE = 2  # ticks; frames of MRCLAM, one in 0.236 s, come up to 0.17 s late in ticks of 0.2 s, and 3 s in ticks of 0.25 s


class ReplayedBodies:
    """The poses of recorded robots at the current tick of the targets; commands move only bodies that were not recorded."""

    def __init__(self, robots: Mapping[str, ReplayedBody], targets: RecordedTargets) -> None:
        self._robots, self._targets = robots, targets
        self.poses: dict[str, Pose] = {}

    def place(self, name: str, pose: Pose) -> None:
        """A robot stands where it stood, anybody else at `pose`."""
        self.poses[name] = self._robots[name].at(self._targets.time) if name in self._robots else pose

    def move(self, commands: dict[str, Command]) -> None:
        """Go on to the tick of the targets."""
        for name, robot in self._robots.items():
            self.poses[name] = robot.at(self._targets.time)


class ReplayedScans:
    """The recorded measurements of each robot, by tick."""

    def __init__(self, robots: Mapping[str, ReplayedBody], dt: float, start: float, ticks: int) -> None:
        self._scans = {name: scans_by_tick(robot, dt, start, ticks) for name, robot in robots.items()}

    def scans(
        self,
        sensors: Sequence[SensorModel],
        poses: Sequence[Pose],
        names: Sequence[str],
        positions: np.ndarray,
        ids: np.ndarray,
        tick: int,
        seen: Sightings,
    ) -> list[np.ndarray]:
        """The detections (M, 2) float32 of each sensor: range in m and bearing in rad, sorted by range."""
        nothing = np.empty((0, 2), dtype=np.float32)
        return [self._scans.get(name, {}).get(tick, nothing) for name in names]


def scans_by_tick(robot: ReplayedBody, dt: float, start: float, ticks: int) -> dict[int, np.ndarray]:
    """The scan of each tick that a frame goes into."""
    found = {}
    for tick, number in frames_by_tick(robot, dt, start, ticks).items():
        before, after = robot.at(float(robot.frame_times[number])), robot.at(start + tick * dt)
        stated = from_other_pose(robot.frames[number], before, after).astype(np.float32)
        found[tick] = stated[np.lexsort((stated[:, 1], stated[:, 0]))][:MAX_DETECTIONS]
    return found


def frames_by_tick(robot: ReplayedBody, dt: float, start: float, ticks: int) -> dict[int, int]:
    """The number of each frame between the first and the last tick, by the tick that it goes into.

    Raises BadSetting for ticks so long that a frame would come more than `MOST_LATE` ticks after the nearest one.
    """
    found: dict[int, int] = {}
    for number, moment in enumerate(robot.frame_times.tolist()):
        tick = nearest = round((moment - start) / dt)
        while tick in found:
            tick += 1
        if tick - nearest > MOST_LATE:
            period = float(np.median(np.diff(robot.frame_times)))
            late = f"the frame that a robot measured at {moment:.2f} s would come more than {MOST_LATE} ticks late"
            raise BadSetting(f"run.dt = {dt:g}: {late}; should be less than the time between two frames, {period:.3f} s")
        if 0 <= tick < ticks:
            found[tick] = number
    return found


def from_other_pose(frame: np.ndarray, before: Pose, after: Pose) -> np.ndarray:
    """Ranges and bearings (M, 2) that were measured at one pose, as they are from another one."""
    rows = []
    for far, bearing in frame.tolist():
        dx = before[0] + far * math.cos(before[2] + bearing) - after[0]
        dy = before[1] + far * math.sin(before[2] + bearing) - after[1]
        rows.append((math.sqrt(dx * dx + dy * dy), wrap_angle(math.atan2(dy, dx) - after[2])))
    return np.array(rows).reshape(-1, 2)
