"""The gossips of a round side by side: a row of numbers for each, and their detections and particles end to end.

Rows are in the order of names. A row holds the numbers of a gossip and those of its sender's sensor. A round over many gossips is a few
operations on whole arrays.
"""

import hashlib
import struct
from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from agents.config import AgentConfig
from agents.coverage.capacity import SensorFacts, sensor_facts
from agents.tracking.births import Scan
from agents.tracking.particles import Particles
from protocol.messages import GOSSIP_NUMBERS, Gossip
from protocol.once import once
from protocol.sensing import SensorModel, WedgeSensor
from protocol.streams import key

COLUMNS = 16
X, Y, COS, SIN, REACH, COS_HALF, PROB, KAPPA, KIND, DETECTIONS, WEIGHT, EAST, NORTH, RADIUS, PARTICLES, SALT = range(COLUMNS)
SILENT, WEDGE, OTHER = 0.0, 1.0, 2.0  # kinds of scan: none in this tick, of a wedge, of another sensor

_SENSOR = struct.Struct("<5dQ")
_SENSOR_COLUMNS = [REACH, COS_HALF, PROB, KAPPA, KIND, SALT]
_MOST_ANNOUNCED = 20000


class AnnouncedSensor(NamedTuple):
    """The sensor that an agent announced."""

    sensor: SensorModel
    facts: SensorFacts
    columns: bytes  # its part of a row: reach m, cosine of the half angle, p_d, clutter density per m^2, kind of scan, key of the name


def announced_sensor(name: str, sensor: SensorModel, clutter: float) -> AnnouncedSensor:
    """The sensor of an agent, with `clutter` expected points a scan. Equal arguments give the same object within a process."""
    return _announced(name, sensor, clutter)  # type: ignore[arg-type]  # a sensor model is hashable


@lru_cache(maxsize=_MOST_ANNOUNCED)
def _announced(name: str, sensor: SensorModel, clutter: float) -> AnnouncedSensor:
    """`announced_sensor`, a pure memo."""
    half, probability, kind = 0.0, 0.0, OTHER
    if isinstance(sensor, WedgeSensor):
        half, probability, kind = sensor.cos_half_angle, sensor.prob_detection, WEDGE
    packed = _SENSOR.pack(sensor.reach, half, probability, clutter / sensor.area, kind, key("sensor", name))
    return AnnouncedSensor(sensor, _facts(sensor), packed)  # type: ignore[arg-type]


@lru_cache(maxsize=1024)
def _facts(sensor: SensorModel) -> SensorFacts:
    """`sensor_facts`, a pure memo: many agents carry sensors of one class."""
    return sensor_facts(sensor)


Stated = tuple[np.ndarray, np.ndarray]  # states (N, 4) float32 and ids (N,) uint64


class GossipTable:
    """Gossips of one round in the order of names. A table never changes; derived arrays are computed once."""

    def __init__(self, gossips: Sequence[Gossip], sensors: Sequence[AnnouncedSensor], diagram: str) -> None:
        """`sensors`: of the senders. `diagram`: "power", "voronoi-cod" or "voronoi"; it determines the generators."""
        self.gossips, self.sensors, self.diagram = gossips, sensors, diagram
        self.names = tuple([gossip.sender for gossip in gossips])
        self.shared: Any = None  # the results that all agents with this table share (`shared_round`)

    @once
    def table(self) -> np.ndarray:
        """A row for each (N, COLUMNS): posed sensor, kind and size of its scan, weight of a particle, generator, number of particles."""
        numbers = np.frombuffer(b"".join([gossip.numbers for gossip in self.gossips])).reshape(-1, GOSSIP_NUMBERS)
        table = np.empty((len(numbers), COLUMNS))
        table[:, : SIN + 1] = numbers[:, :4]
        table[:, _SENSOR_COLUMNS] = np.frombuffer(b"".join([sensor.columns for sensor in self.sensors])).reshape(-1, 6)
        table[:, KIND] *= numbers[:, 11]
        table[:, DETECTIONS], table[:, WEIGHT], table[:, PARTICLES] = numbers[:, 9], numbers[:, 8], numbers[:, 10]
        table[:, EAST : NORTH + 1] = numbers[:, :2] if self.diagram == "voronoi" else numbers[:, 4:6]
        table[:, RADIUS] = numbers[:, 6] if self.diagram == "power" else 0.0
        return table

    @once
    def salts(self) -> np.ndarray:
        """Keys of the sensors' names (N,) uint64."""
        return self.table[:, SALT].copy().view(np.uint64)

    @once
    def everyone(self) -> frozenset[str]:
        """The names as a set."""
        return frozenset(self.names)

    @once
    def generators(self) -> np.ndarray:
        """The generators (N, 3): point x, y and power radius, m."""
        return self.table[:, EAST : RADIUS + 1].copy()

    @once
    def points(self) -> np.ndarray:
        """The points of the generators (N, 2), m."""
        return self.generators[:, :2].copy()

    @once
    def radii(self) -> np.ndarray:
        """The power radii of the generators (N,), m."""
        return self.generators[:, 2].copy()

    @once
    def view(self) -> int:
        """The hash of all generators; never 0. Agents with equal hashes cut the same diagram."""
        digest = hashlib.blake2b("\n".join(self.names).encode(), digest_size=7)
        digest.update(self.generators.tobytes())
        return int.from_bytes(digest.digest(), "little") | 1

    @once
    def detections(self) -> np.ndarray:
        """All detections (D, 2) float64, scan after scan, m."""
        joined = bytearray().join([gossip.detections_bytes for gossip in self.gossips])
        return np.frombuffer(joined, dtype="<f4").reshape(-1, 2).astype(float)

    @once
    def listening(self) -> bool:
        """Whether a sender listens, and has no cell yet."""
        return True in [gossip.listening for gossip in self.gossips]

    @once
    def all_wedges(self) -> bool:
        """Whether every scan is that of a wedge sensor."""
        return OTHER not in self.table[:, KIND].tolist()

    @once
    def claimed(self) -> tuple[int, int] | None:
        """The tick and the view that all claims share; None when they differ."""
        shared = {(gossip.claim_tick, gossip.view) for gossip in self.gossips}
        return shared.pop() if len(shared) == 1 else None

    @property
    def stated(self) -> Stated:
        """States (N, 4) float32 and ids (N,) uint64 of all particles, gossip after gossip, at the tick of their claims.

        These arrays are the largest of a round, and no later round reads them. Only the last table that computed them keeps them.
        """
        if not self.stands_ready:
            _LATEST.append((self, self.stated_by([*range(len(self.gossips))])))
        return _LATEST[0][1]

    @property
    def stands_ready(self) -> bool:
        """Whether `stated` is already computed."""
        return bool(_LATEST) and _LATEST[0][0] is self

    def stated_by(self, rows: list[int]) -> Stated:
        """The part of `stated` that comes from some rows."""
        gossips = self.gossips
        states = np.frombuffer(bytearray().join([gossips[row].states_bytes for row in rows]), dtype=np.float32)
        ids = np.frombuffer(bytearray().join([gossips[row].ids_bytes for row in rows]), dtype=np.uint64)
        return states.reshape(-1, 4), ids

    @once
    def boxes(self) -> np.ndarray:
        """The bounding box of each gossip's particles (N, 4): west, south, east and north, m."""
        return np.frombuffer(b"".join([gossip.box for gossip in self.gossips])).reshape(-1, 4)

    @once
    def particles(self) -> Particles:
        """The particles of `stated` with their weights."""
        states, ids = self.stated
        return Particles(states.astype(float), self.table[:, WEIGHT].repeat(self.table[:, PARTICLES].astype(np.int64)), ids)

    def scans(self) -> list[Scan]:
        """The scans of this tick, in the order of the update: by ascending p_d, then by name."""
        found, ends = [], np.cumsum(self.table[:, DETECTIONS]).astype(np.int64)
        for gossip, announced_sensor, numbers, end in zip(self.gossips, self.sensors, self.table, ends):
            if numbers[KIND] != SILENT:
                detections = self.detections[end - np.int64(numbers[DETECTIONS]) : end]
                order = np.arange(len(detections), dtype=np.uint64)
                scan = Scan(key("sensor", gossip.sender), announced_sensor.sensor, gossip.pose, detections, order, float(numbers[KAPPA]))
                found.append((float(numbers[PROB]), scan))
        return [scan for _, scan in sorted(found, key=lambda one: one[0])]


def received_particles(received: GossipTable | Particles) -> Particles:
    """The particles of a table, or the particles themselves."""
    return received.particles if isinstance(received, GossipTable) else received


_LATEST: deque[tuple[GossipTable, Stated]] = deque(maxlen=1)  # the table whose `stated` was computed last
_RECENT: deque[GossipTable] = deque(maxlen=2)  # a pure memo: in a simulation all agents hear the same gossips


def gossip_table(gossips: list[Gossip], sensors: list[AnnouncedSensor], config: AgentConfig) -> GossipTable:
    """The table of some gossips and the sensors of their senders. Equal arguments give a table of one of the last two calls."""
    diagram = config.partition.kind
    for known in _RECENT:
        if known.diagram == diagram and known.sensors == sensors and known.gossips == gossips:
            return known
    table = GossipTable(gossips, sensors, diagram)
    _RECENT.append(table)
    return table


def newest_table() -> GossipTable:
    """The table that was made last, for measurements."""
    return _RECENT[-1]


def forget() -> None:
    """Drop the memos of this file, so that a measurement is that of a process of its own."""
    _RECENT.clear()
    _LATEST.clear()
