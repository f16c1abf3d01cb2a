"""A recording as an MCAP file that Foxglove draws: scene updates (foxglove.SceneUpdate as JSON) and the scores for its plots.

Cells and footprints are outlines, bodies arrows, true targets white balls and estimates orange ones; the dead vanish. Frame `arena`, x
east, y north, in m.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from deploy.page.picture import Picture
from deploy.recording.moments import colour_of, moments
from deploy.recording.recording import Recording
from deploy.scoring.scorer import Scorer
from deploy.scoring.scores import COLUMNS
from protocol.geometry import rectangle

Json = dict[str, Any]
SCENE_SCHEMA = Path(__file__).with_name("foxglove_scene.json")  # of the message that Foxglove knows by this name
FRAME = "arena"
LIFETIME = {"sec": 5, "nsec": 0}


def write_foxglove(recording: Recording, path: Path) -> int:
    """Write the drawing; returns the number of scenes."""
    scenes, scorer = 0, Scorer(recording.scenario, recorded=True)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("")
        scene_channel, score_channel = _channels(writer)
        for picture, truth in moments(recording, scorer):
            _say(writer, scene_channel, truth.time, scene(picture, truth.time))
            scenes += 1
        for score in scorer.scores:
            _say(writer, score_channel, score.time, {name: getattr(score, name) for name in COLUMNS})
        writer.finish()
    return scenes


def _channels(writer: Writer) -> tuple[int, int]:
    scene_schema = writer.register_schema("foxglove.SceneUpdate", "jsonschema", SCENE_SCHEMA.read_bytes())
    properties = {name: {"type": "number"} for name in COLUMNS}
    score_schema = writer.register_schema("covey.Score", "jsonschema", json.dumps({"type": "object", "properties": properties}).encode())
    return writer.register_channel("/covey/scene", "json", scene_schema), writer.register_channel("/covey/score", "json", score_schema)


def _say(writer: Writer, channel: int, time: float, data: Json) -> None:
    stamp = round(1e9 * time)
    writer.add_message(channel, stamp, json.dumps(data).encode(), stamp)


def scene(picture: Picture, time: float) -> Json:
    """The scene update of the tick that the picture shows."""
    stamp = dict(zip(("sec", "nsec"), divmod(round(1e9 * time), 10**9)))
    arena = picture.scenario.arena
    entities = [_entity("arena", stamp, lines=[_outline(rectangle(arena.width, arena.height), (0.6, 0.65, 0.7, 1.0), 0.1)])]
    gone = []
    for index, name in enumerate(picture.agents):
        known = picture.agents[name]
        pose = picture.pose(name)
        if picture.is_alive(known) and pose is not None:
            entities.append(_agent(picture, name, pose, (*colour_of(index), 1.0), stamp))
        else:
            gone.append({"timestamp": stamp, "type": 0, "id": f"agent {name}"})
    if picture.shown is not None:
        entities.append(_entity("targets", stamp, spheres=[_ball(place, 0.8, (1.0, 1.0, 1.0, 0.9)) for place in picture.shown.targets]))
    said = [picture.said(known)[1] for known in picture.agents.values() if picture.is_alive(known)]
    found = [(place, label) for one in said if one is not None for place, label in zip(one.targets.tolist(), one.labels.tolist())]
    spheres = [_ball(place, 0.55, (1.0, 0.69, 0.0, 1.0)) for place, _ in found]
    names = [_text((x, y + 0.8), str(label), 0.7) for (x, y), label in found if label]
    entities.append(_entity("estimates", stamp, spheres=spheres, texts=names))
    return {"deletions": gone, "entities": entities}


def _agent(picture: Picture, name: str, pose: tuple[float, float, float], colour: tuple[float, ...], stamp: Json) -> Json:
    known = picture.agents[name]
    _, estimate = picture.said(known)
    lines = [_outline(estimate.cell, (*colour[:3], 1.0), 0.12)] if estimate is not None and len(estimate.cell) else []
    if known.sensor is not None:
        lines.append(_outline(known.sensor.footprint(pose), (*colour[:3], 0.5), 0.06))
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(pose[2] / 2.0), "w": math.cos(pose[2] / 2.0)}
    sizes = {"shaft_length": 0.8, "shaft_diameter": 0.3, "head_length": 0.6, "head_diameter": 0.7}
    arrow = {"pose": {"position": _point(pose), "orientation": turn}, **sizes, "color": _named(colour)}
    return _entity(f"agent {name}", stamp, lines=lines, arrows=[arrow], texts=[_text((pose[0], pose[1] + 1.2), name, 1.1)])


def _text(place: tuple[float, float], text: str, size: float) -> Json:
    """White text of `size` m that faces the reader."""
    shape = {"pose": _still(place), "billboard": True, "font_size": size, "scale_invariant": False}
    return {**shape, "color": _named((1.0, 1.0, 1.0, 1.0)), "text": text}


def _entity(
    name: str,
    stamp: Json,
    lines: list[Json] | None = None,
    spheres: list[Json] | None = None,
    arrows: list[Json] | None = None,
    texts: list[Json] | None = None,
) -> Json:
    """A scene entity with all its lists, the empty ones too."""
    head = {"timestamp": stamp, "frame_id": FRAME, "id": name, "lifetime": LIFETIME, "frame_locked": True, "metadata": []}
    shapes = {"arrows": arrows or [], "cubes": [], "spheres": spheres or [], "cylinders": [], "lines": lines or []}
    return {**head, **shapes, "triangles": [], "texts": texts or [], "models": []}


def _outline(points: np.ndarray, colour: tuple[float, ...], thickness: float) -> Json:
    """A closed line (LINE_LOOP, type 1)."""
    shape = {"type": 1, "pose": _still((0.0, 0.0)), "thickness": thickness, "scale_invariant": False}
    return {**shape, "points": [_point(place) for place in points], "color": _named(colour), "colors": [], "indices": []}


def _ball(place: np.ndarray, size: float, colour: tuple[float, ...]) -> Json:
    return {"pose": _still(place), "size": {"x": size, "y": size, "z": size}, "color": _named(colour)}


def _point(place: Any) -> Json:
    return {"x": round(float(place[0]), 3), "y": round(float(place[1]), 3), "z": 0.0}


def _still(place: Any) -> Json:
    return {"position": _point(place), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def _named(colour: tuple[float, ...]) -> Json:
    return dict(zip("rgba", colour))
