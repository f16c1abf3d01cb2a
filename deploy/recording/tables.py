"""A recording in the forms of other tools: tables as CSV or Parquet.

Five tables: `scores` (a row per tick), `agents` (per agent and tick), `targets` (true), `estimates`, `detections`. Lengths in m,
times in s, angles in rad. A label of 0 is none. The drawing for Foxglove is in `deploy.recording.foxglove`.
"""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import csv, parquet

from deploy.recording.recording import Recording
from deploy.recording.rescore import rescore_slowly
from deploy.scenario import Scenario
from deploy.scoring.scorer import Scorer
from deploy.scoring.scores import COLUMNS
from protocol.geometry import polygon_area
from protocol.measuring import to_places
from protocol.messages import Gossip, Hello
from protocol.node import Event, messages_of
from protocol.observer_messages import Estimate, Truth
from protocol.sensing import SensorModel, measurement_of
from protocol.settings import BadSetting, sensor_of
from protocol.whole_file import whole_file

TableRow = tuple[Any, ...]
NUMBER, WHOLE, WORD = pyarrow.float64(), pyarrow.int64(), pyarrow.string()
WHOLE_SCORES = ("tick", "targets", "in_view", "estimated")
SCHEMAS: dict[str, list[tuple[str, pyarrow.DataType]]] = {
    "agents": [
        ("tick", WHOLE),
        ("time", NUMBER),
        ("agent", WORD),
        ("incarnation", WHOLE),
        *((name, NUMBER) for name in ("x", "y", "heading", "cod_x", "cod_y", "power_radius", "unused", "load", "mass", "cell_area")),
        ("targets", WHOLE),
        ("neighbours", WHOLE),
        ("round_seconds", NUMBER),
    ],
    "targets": [("tick", WHOLE), ("time", NUMBER), ("target", pyarrow.uint64()), ("x", NUMBER), ("y", NUMBER)],
    "estimates": [
        ("tick", WHOLE),
        ("time", NUMBER),
        ("agent", WORD),
        ("x", NUMBER),
        ("y", NUMBER),
        ("label", WHOLE),
        *((name, NUMBER) for name in ("vx", "vy", "xx", "xy", "yy", "existence")),
    ],
    "detections": [("tick", WHOLE), ("time", NUMBER), ("agent", WORD), ("x", NUMBER), ("y", NUMBER)],
}


def tables(recording: Recording) -> dict[str, pyarrow.Table]:
    """All five tables by name."""
    scorer = Scorer(recording.scenario, recorded=True)
    dt = recording.scenario.run.dt
    sensors = {name: sensor_of(recording.scenario, sensor_class) for name, sensor_class in recording.scenario.members.items()}
    rows: dict[str, list[TableRow]] = {name: [] for name in SCHEMAS}

    def hear(event: Event, now: float) -> None:
        for message in messages_of(event):
            if isinstance(message, Truth):
                rows["targets"] += [(message.tick, message.time, int(n), x, y) for n, (x, y) in zip(message.ids, message.targets.tolist())]
            elif isinstance(message, Estimate):
                rows["agents"].append(_agent_row(message, dt))
                said = zip(message.targets.tolist(), message.labels.tolist(), message.details.tolist())
                rows["estimates"] += [
                    (message.tick, message.tick * dt, message.sender, *place, label, *rest) for place, label, rest in said
                ]
            elif isinstance(message, Hello):
                _note_sensor(sensors, message, recording.scenario)
            elif isinstance(message, Gossip):
                places = _places(message, sensors.get(message.sender))
                rows["detections"] += [(message.tick, message.tick * dt, message.sender, x, y) for x, y in places.tolist()]

    scorer.on_event = hear
    for _ in rescore_slowly(recording, scorer):
        pass
    found = {name: _table(schema, rows[name]) for name, schema in SCHEMAS.items()}
    schema = [(name, WHOLE if name in WHOLE_SCORES else NUMBER) for name in COLUMNS]
    return {"scores": _table(schema, [tuple(getattr(score, name) for name in COLUMNS) for score in scorer.scores]), **found}


def _note_sensor(sensors: dict[str, SensorModel], hello: Hello, scenario: Scenario) -> None:
    """Remember the sensor that a guest announces; one of an unknown class has none."""
    if hello.role == "agent" and hello.sender not in sensors:
        with contextlib.suppress(BadSetting):
            sensors[hello.sender] = hello.sensor or sensor_of(scenario, hello.sensor_class)


def _places(gossip: Gossip, sensor: SensorModel | None) -> np.ndarray:
    """The places of the detections of a gossip (M, 2), m; as they came where the sensor is not known."""
    if sensor is None:
        return gossip.detections
    return to_places(measurement_of(sensor), sensor.reach, gossip.pose, gossip.detections)


def _agent_row(one: Estimate, dt: float) -> TableRow:
    place = (*one.pose, *one.cod, one.power_radius)
    figures = (one.unused, one.load, one.mass, polygon_area(one.cell), len(one.targets), len(one.neighbours), one.round_seconds)
    return one.tick, one.tick * dt, one.sender, one.incarnation, *place, *figures


def _table(schema: list[tuple[str, pyarrow.DataType]], rows: list[TableRow]) -> pyarrow.Table:
    columns = list(zip(*rows)) if rows else [()] * len(schema)
    arrays = [pyarrow.array(column, kind) for column, (_, kind) in zip(columns, schema)]
    return pyarrow.Table.from_arrays(arrays, names=[name for name, _ in schema])


def write_tables(recording: Recording, folder: Path, form: str) -> list[Path]:
    """Write the tables as `csv` or `parquet` files into a folder; the files."""
    found, files = tables(recording), []
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in found.items():
        file = folder / f"{name}.{form}"
        with whole_file(file) as new:
            if form == "csv":
                csv.write_csv(table, new)
            else:
                parquet.write_table(table, new)
        files.append(file)
    return files
