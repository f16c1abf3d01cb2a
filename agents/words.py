"""What the gossips of a round say, side by side: one row of numbers each, and their detections and particles end to end.

A row is packed once per gossip (`row`), so that a round over many gossips is a few operations on whole arrays.
"""

import hashlib
import math
import struct
from collections import deque

import numpy as np

from agents.births import Scan
from agents.config import AgentConfig
from agents.particles import NONE, Particles
from protocol.messages import Gossip
from protocol.once import once
from protocol.sensing import Pose, SensorModel, WedgeSensor
from protocol.streams import key

ROW = struct.Struct("<14dQ")
X, Y, COS, SIN, REACH, COS_HALF, PROB, KAPPA, KIND, DETECTIONS, WEIGHT, EAST, NORTH, RADIUS, SALT = range(15)  # columns
SILENT, WEDGE, OTHER = 0.0, 1.0, 2.0  # kinds of scan: none in this tick, of a wedge, of another sensor


def pack_row(
    name: str,
    pose: Pose,
    sensor: SensorModel,
    clutter: float,
    detections: int,
    weight: float,
    generator: tuple[float, float, float],
    scanned: bool = True,
) -> bytes:
    """A row: posed sensor, clutter density, kind and size of the scan, weight of the particles, generator, key of the name; in m."""
    x, y, heading = pose
    wedge = sensor if isinstance(sensor, WedgeSensor) else None
    return ROW.pack(
        x,
        y,
        math.cos(heading),
        math.sin(heading),
        sensor.reach,
        wedge.cos_half_angle if wedge else 0.0,
        wedge.prob_detection if wedge else 0.0,
        clutter / sensor.area,
        SILENT if not scanned else WEDGE if wedge else OTHER,
        detections,
        weight,
        *generator,
        key("sensor", name),
    )


def row(gossip: Gossip, sensor: SensorModel, config: AgentConfig) -> bytes:
    """The row of a gossip; the generator is COD and power radius, COD alone ("voronoi-cod"), or position alone ("voronoi")."""
    kind = config.partition.kind
    point = gossip.pose[:2] if kind == "voronoi" else gossip.cod
    detections, clutter = len(gossip.detections_bytes) // 8, config.detection.clutter
    generator = (*point, gossip.power_radius if kind == "power" else 0.0)
    return pack_row(gossip.sender, gossip.pose, sensor, clutter, detections, gossip.weight, generator, gossip.scanned)


def learn(gossip: Gossip, sensor: SensorModel, config: AgentConfig) -> None:
    """Note with a gossip what its sender's sensor makes of it."""
    gossip.memo["row"] = row(gossip, sensor, config)
    gossip.memo["sensor"] = sensor


class Words:
    """Gossips of one round that have been `learn`ed, in the order of names."""

    def __init__(self, gossips: list[Gossip], rows: bytearray) -> None:
        self.gossips, self.rows = gossips, rows
        self.names = tuple([gossip.sender for gossip in gossips])
        self.table = np.frombuffer(rows, dtype=float).reshape(-1, ROW.size // 8)  # (N, columns)

    @classmethod
    def of_scans(cls, rows: bytearray, detections: np.ndarray) -> "Words":
        """Scans that nobody has put into a gossip: their rows, and all detections (D, 2)."""
        words = cls([], rows)
        words.__dict__["detections"] = detections
        return words

    @once
    def salts(self) -> np.ndarray:
        """Keys of the sensors' names (N,) uint64."""
        return self.table[:, SALT].copy().view(np.uint64)

    @once
    def generators(self) -> np.ndarray:
        """(N, 3): point x, y and power radius, m."""
        return self.table[:, EAST : RADIUS + 1].copy()

    @once
    def points(self) -> np.ndarray:
        """Of the generators (N, 2), m."""
        return self.generators[:, :2].copy()

    @once
    def radii(self) -> np.ndarray:
        """Of the generators (N,), m."""
        return self.generators[:, 2].copy()

    @once
    def view(self) -> int:
        """The hash of all generators: agents with equal hashes cut the same diagram; never 0."""
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
        """Whether one of them has no cell yet."""
        return True in [gossip.listening for gossip in self.gossips]

    @once
    def all_wedges(self) -> bool:
        """Whether no other sensor has spoken."""
        return OTHER not in self.table[:, KIND].tolist()

    @once
    def claimed(self) -> tuple[int, int] | None:
        """The stamp and the view that all these claims share, if they do."""
        shared = {(gossip.claim_tick, gossip.view) for gossip in self.gossips}
        return shared.pop() if len(shared) == 1 else None

    @once
    def particles(self) -> Particles:
        """All their particles, gossip after gossip, as they were stamped."""
        if not self.gossips:
            return NONE
        states = np.frombuffer(bytearray().join([gossip.states_bytes for gossip in self.gossips]), dtype="<f4")
        ids = np.frombuffer(bytearray().join([gossip.ids_bytes for gossip in self.gossips]), dtype="<u8")
        counts = [len(gossip.ids_bytes) // 8 for gossip in self.gossips]
        return Particles(states.reshape(-1, 4).astype(float), self.table[:, WEIGHT].repeat(counts), ids)

    def scans(self) -> list[Scan]:
        """The scans one by one, those of the silent left out."""
        found = []
        for gossip, numbers in zip(self.gossips, self.table):
            if numbers[KIND] != SILENT:
                detections = gossip.detections.astype(float)
                order = np.arange(len(detections), dtype=np.uint64)
                sensor = gossip.memo["sensor"]
                found.append(Scan(key("sensor", gossip.sender), sensor, gossip.pose, detections, order, float(numbers[KAPPA])))
        return found


_RECENT: deque[Words] = deque(maxlen=2)  # in a simulation all agents hear the same


def side_by_side(gossips: list[Gossip]) -> Words:
    """The gossips side by side; the same object for the same gossips, if they were the last ones asked for."""
    rows = bytearray().join([gossip.memo["row"] for gossip in gossips])
    for words in _RECENT:
        if words.rows == rows and words.gossips == gossips:
            return words
    _RECENT.append(Words(gossips, rows))
    return _RECENT[-1]
