"""What a world consists of: targets, bodies and what the sensors return, simulated or recorded.

Data types: `Sources` holds the three. Each has one interface, and the world node does not know which kind it has.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from protocol.messages import Command
from protocol.sensing import Pose, SensorModel
from protocol.settings import BadSetting
from world.bodies import Bodies
from world.config import RecordedSettings, WorldConfig
from world.detector import Detector, Sightings
from world.recorded.mrclam import read_mrclam
from world.recorded.pedestrians import read_pedestrians
from world.recorded.robots import ReplayedBodies, ReplayedScans, frames_by_tick
from world.recorded.ships import read_ships
from world.recorded.targets import RecordedTargets
from world.recorded.tracks import RecordedWorld
from world.targets import Targets


class TargetSource(Protocol):
    """The targets at the current tick; arrays are replaced by a step, never changed in place."""

    tick: int
    positions: np.ndarray  # (T, 2), m
    ids: np.ndarray  # (T,) uint64

    def step(self) -> None:
        """Go on to the next tick."""


class BodySource(Protocol):
    """The poses of all bodies by name, in team order."""

    poses: dict[str, Pose]

    def place(self, name: str, pose: Pose) -> None:
        """Put a body somewhere; a new one goes to the end of the order."""

    def move(self, commands: dict[str, Command]) -> None:
        """Go on to the next tick."""


class ScanSource(Protocol):
    """What the sensors of a tick return."""

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
        """The detections (M, 2) float32 of each sensor."""


class Sources(NamedTuple):
    """The targets, the bodies and the scans of a run."""

    targets: TargetSource
    bodies: BodySource
    detector: ScanSource


READERS: dict[str, Callable[[Path, RecordedSettings], RecordedWorld]] = {
    "pedestrians": read_pedestrians,
    "ships": read_ships,
    "mrclam": read_mrclam,
}


def sources_of(config: WorldConfig) -> Sources:
    """The sources that a configuration describes; raises BadSetting naming the file and the line, or the field."""
    run = config.run
    bodies, detector = body_source(config), Detector(config.detection, run.seed)
    if config.recorded.kind == "none":
        return Sources(Targets(config.targets, config.arena, run.dt, run.seed), bodies, detector)
    recording = recording_of(config)
    targets = RecordedTargets(recording.visits, config.arena, run.dt, config.recorded.start)
    if not recording.bodies:
        return Sources(targets, bodies, detector)
    robots = dict(zip(config.members, recording.bodies))
    if len(config.members) != len(recording.bodies):
        raise BadSetting(f"members: {len(config.members)} agents for a recording of {len(recording.bodies)} robots; should be as many")
    return Sources(targets, ReplayedBodies(robots, targets), ReplayedScans(robots, run.dt, config.recorded.start, run.ticks))


def body_source(config: WorldConfig) -> BodySource:
    """No bodies yet, of the model that a configuration names; raises BadSetting where it cannot be had."""
    if config.bodies.model == "point":
        return Bodies(config.run.dt, config.limits)
    from world.physical_bodies import PhysicalBodies  # an extra

    return PhysicalBodies(config.run.dt, config.limits)


def recorded_files(settings: RecordedSettings) -> list[Path]:
    """The files of a recorded world; none where the targets are simulated, or where there are none."""
    data = Path(settings.data)
    if settings.kind == "none":
        return []
    return sorted(path for path in (data.iterdir() if data.is_dir() else [data]) if path.is_file())


@lru_cache(maxsize=1)
def _read(settings: RecordedSettings, stamps: tuple[tuple[Path, int, int], ...]) -> RecordedWorld:
    """What the files hold, read once as long as the `stamps` of all of them are the same: checks, remarks and the run ask for it."""
    return READERS[settings.kind](Path(settings.data), settings)


def recording_of(config: WorldConfig) -> RecordedWorld:
    """The recording that a configuration names; raises BadSetting for a wrong file, a run that is longer than it, and too long ticks."""
    settings, run = config.recorded, config.run
    if not settings.data:
        raise BadSetting("recorded.data: is missing; `--data PATH` says where the files of this world are")
    stamps: tuple[tuple[Path, int, int], ...] = ()
    with suppress(OSError):  # the reader says what is wrong
        stamps = tuple((file, file.stat().st_mtime_ns, file.stat().st_size) for file in recorded_files(settings))
    recording = _read(settings, stamps)
    if settings.start > recording.seconds:
        raise BadSetting(f"recorded.start = {settings.start:g}: the recording ends before; should be at most {recording.seconds:.1f}")
    end = settings.start + (run.ticks - 1) * run.dt
    if end > recording.seconds:
        most = recording.seconds - settings.start
        raise BadSetting(f"run.seconds = {run.seconds:g}: the recording ends before; should be at most {most:.1f}")
    for robot in recording.bodies:
        frames_by_tick(robot, run.dt, settings.start, run.ticks)
    _check_arena(config, recording)
    return recording


def _check_arena(config: WorldConfig, recording: RecordedWorld) -> None:
    """Raise BadSetting where no target is ever in the arena, which says that the origin is wrong, or the arena."""
    settings, arena = config.recorded, config.arena
    moments = settings.start + np.arange(config.run.ticks) * config.run.dt
    places = [np.empty((0, 2))]
    for visit in recording.visits:
        there = moments[(visit.times[0] <= moments) & (moments <= visit.times[-1])]
        path = np.column_stack([np.interp(there, visit.times, column) for column in visit.places.T])
        if arena.holds(*path.T).any():
            return
        places.append(path)
    spread = np.vstack(places)
    where = f"no target is in the arena of {arena.width:g} x {arena.height:g} m between {moments[0]:g} s and {moments[-1]:g} s"
    if not len(spread):
        raise BadSetting(f"recorded.start = {settings.start:g}: {where}, nor anywhere else")
    (west, south), (east, north) = spread.min(axis=0), spread.max(axis=0)
    found = f"seen from there they lie at x from {west:.6g} to {east:.6g} m and y from {south:.6g} to {north:.6g} m"
    raise BadSetting(f"recorded.origin = {list(settings.origin)}: {where}; {found}, and should lie within the arena")
