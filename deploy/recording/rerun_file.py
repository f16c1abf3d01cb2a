"""A recording as a file that the Rerun viewer draws: the arena from above, the scores as curves, the time line as a log.

Rerun is the extra `rerun`. Its time line `world` is the world's time; x east, y north, z up, in m.
"""

import importlib.util
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.installation import how_to_install
from deploy.page.picture import Picture
from deploy.recording.moments import colour_of, moments
from deploy.recording.recording import Recording
from deploy.scoring.scorer import Score, Scorer
from deploy.scoring.scores import COLUMNS
from protocol.geometry import rectangle
from protocol.settings import BadSetting

if TYPE_CHECKING:
    from rerun import RecordingStream

GONE = (107, 120, 134)
WARNINGS = ("lost", "twin", "silent", "paused", "partition", "links")


def write_rerun(recording: Recording, path: Path) -> int:
    """Write the drawing; returns the number of ticks. Raises BadSetting where Rerun is not installed, OSError."""
    if importlib.util.find_spec("rerun") is None:
        raise BadSetting("--to rerun: needs the package rerun-sdk: " + how_to_install(["rerun-sdk"], "rerun"))
    import rerun

    path.open("wb").close()  # Rerun itself only logs that it cannot write
    stream = rerun.RecordingStream("covey", recording_id=f"{recording.run}-{recording.scenario.run.seed}")
    stream.save(path)
    _log_arena(stream, recording)
    ticks, told, scorer = 0, 0, Scorer(recording.scenario, recorded=True)
    for picture, truth in moments(recording, scorer):
        stream.set_time("world", duration=truth.time)
        _log_bodies(stream, picture)
        _log_areas(stream, picture)
        _log_points(stream, picture)
        for one in [happening for happening in picture.happenings if happening.number > told]:
            stream.set_time("world", duration=one.time)
            stream.log("happenings", rerun.TextLog(one.text, level="WARN" if one.kind in WARNINGS else "INFO"))
            told = one.number
        ticks += 1
    for score in scorer.scores:
        _log_score(stream, score)
    stream.flush()
    stream.disconnect()
    return ticks


def _log_arena(stream: "RecordingStream", recording: Recording) -> None:
    import rerun

    arena = recording.scenario.arena
    stream.log("arena", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("arena/border", rerun.LineStrips3D([_ring(rectangle(arena.width, arena.height))], colors=[GONE]), static=True)


def _log_bodies(stream: "RecordingStream", picture: Picture) -> None:
    """The living as arrows with their names, the dead as grey balls."""
    import rerun

    poses = {name: picture.pose(name) for name in picture.agents}
    living = [(index, name, pose) for index, (name, pose) in enumerate(poses.items()) if pose and picture.is_alive(picture.agents[name])]
    dead = [
        (name, pose) for name, pose in poses.items() if pose and not picture.is_alive(picture.agents[name]) and picture.agents[name].seen
    ]
    arrows = rerun.Arrows3D(
        origins=_flat([pose[:2] for _, _, pose in living]),
        vectors=_flat([(1.4 * np.cos(pose[2]), 1.4 * np.sin(pose[2])) for _, _, pose in living]),
        colors=[_bytes(index) for index, _, _ in living],
        labels=[name for _, name, _ in living],
    )
    stream.log("arena/agents", arrows)
    gone = rerun.Points3D(_flat([pose[:2] for _, pose in dead]), radii=0.5, colors=[GONE] * len(dead), labels=[name for name, _ in dead])
    stream.log("arena/dead", gone)


def _log_areas(stream: "RecordingStream", picture: Picture) -> None:
    """Power cells and footprints of the living, as outlines in the colours of their owners."""
    import rerun

    cells: list[tuple[int, np.ndarray]] = []
    footprints: list[tuple[int, np.ndarray]] = []
    for index, known in enumerate(picture.agents.values()):
        estimate, pose = picture.said(known)[1], picture.pose(known.name)
        alive = picture.is_alive(known)
        if alive and estimate is not None and len(estimate.cell):
            cells.append((index, estimate.cell))
        if alive and known.sensor is not None and pose is not None:
            footprints.append((index, known.sensor.footprint(pose)))
    for name, outlines, radius in (("cells", cells, 0.08), ("footprints", footprints, 0.03)):
        rings, colours = [_ring(outline) for _, outline in outlines], [_bytes(index) for index, _ in outlines]
        stream.log(f"arena/{name}", rerun.LineStrips3D(rings, colors=colours, radii=radius))


def _log_points(stream: "RecordingStream", picture: Picture) -> None:
    """Particles, detections, true targets and estimates."""
    import rerun

    living = [(known, *picture.said(known)) for known in picture.agents.values() if picture.is_alive(known)]
    detections = [place for known, gossip, _ in living if gossip is not None for place in known.places(gossip)]
    said = [estimate for _, _, estimate in living if estimate is not None]
    estimates, labels = [place for one in said for place in one.targets], [str(label) for one in said for label in one.labels.tolist()]
    drawn: list[tuple[str, Iterable[Any], float, tuple[int, int, int]]] = [
        ("particles", picture.particles()[:, :2], 0.06, (255, 214, 120)),
        ("detections", detections, 0.15, (155, 215, 255)),
        ("targets", picture.shown.targets if picture.shown is not None else [], 0.4, (255, 255, 255)),
    ]
    for name, places, radius, colour in drawn:
        stream.log(f"arena/{name}", rerun.Points3D(_flat(places), radii=radius, colors=[colour]))
    stream.log("arena/estimates", rerun.Points3D(_flat(estimates), radii=0.28, colors=[(255, 176, 0)], labels=labels))


def _log_score(stream: "RecordingStream", score: Score) -> None:
    import rerun

    stream.set_time("world", duration=score.time)
    for name in COLUMNS:
        if name not in ("tick", "time"):
            stream.log(f"score/{name}", rerun.Scalars(float(getattr(score, name))))


def _flat(places: Iterable[Any]) -> np.ndarray:
    """Places (N, 2) on the ground, (N, 3)."""
    points = np.array(list(places), dtype=float).reshape(-1, 2)
    return np.column_stack([points, np.zeros(len(points))])


def _ring(outline: np.ndarray) -> np.ndarray:
    """A closed outline on the ground, (V + 1, 3)."""
    return _flat([*outline, *outline[:1]])


def _bytes(index: int) -> tuple[int, ...]:
    return tuple(round(255.0 * part) for part in colour_of(index))
