"""What the gossips of a round say, side by side: one row of numbers each, and their detections and particles end to end.

A row is packed once per gossip (`learn`), so that a round over many gossips is a few operations on whole arrays.
"""

import hashlib
import struct
from collections import deque
from collections.abc import Callable
from math import cos, sin
from typing import Any, NamedTuple

import numpy as np

from agents.births import Scan
from agents.config import AgentConfig
from agents.particles import Particles
from protocol.messages import Gossip
from protocol.once import once
from protocol.sensing import Pose, SensorModel, WedgeSensor
from protocol.streams import key

ROW = struct.Struct("<15dQ")
COLUMNS = ROW.size // 8
_pack = ROW.pack
X, Y, COS, SIN, REACH, COS_HALF, PROB, KAPPA, KIND, DETECTIONS, WEIGHT, EAST, NORTH, RADIUS, PARTICLES, SALT = range(16)  # columns
SILENT, WEDGE, OTHER = 0.0, 1.0, 2.0  # kinds of scan: none in this tick, of a wedge, of another sensor


class Eye(NamedTuple):
    """What a row says of a sensor in any pose and at any tick."""

    sensor: SensorModel
    clutter: float  # expected per scan
    numbers: tuple[float, float, float, float]  # reach m, cos of half the angle, p_d, clutter density per m^2
    kind: float  # of its scans
    salt: int  # key of its name


def eye_of(name: str, sensor: SensorModel, clutter: float) -> Eye:
    """The sensor of an agent as its rows say it."""
    kappa = clutter / sensor.area
    if isinstance(sensor, WedgeSensor):
        return Eye(sensor, clutter, (sensor.reach, sensor.cos_half_angle, sensor.prob_detection, kappa), WEDGE, key("sensor", name))
    return Eye(sensor, clutter, (sensor.reach, 0.0, 0.0, kappa), OTHER, key("sensor", name))


def pack_row(
    eye: Eye, pose: Pose, generator: tuple[float, float, float], detections: int, weight: float, particles: int, scanned: bool
) -> bytes:
    """A row: posed sensor, kind and size of its scan, weight of a particle, generator, number of particles, key of the name; in m."""
    x, y, heading = pose
    east, north, radius = generator
    kind = eye.kind if scanned else SILENT
    return _pack(x, y, cos(heading), sin(heading), *eye.numbers, kind, detections, weight, east, north, radius, particles, eye.salt)


_EYES: dict[str, Eye] = {}  # the last that was used, by name
_MOST_EYES = 20000


def learn(gossip: Gossip, sensor: SensorModel, config: AgentConfig) -> None:
    """Note with a gossip what its sender's sensor makes of it: its row, and the sensor.

    The generator is COD and power radius, COD alone ("voronoi-cod"), or position alone ("voronoi").
    """
    name, clutter, diagram = gossip.sender, config.detection.clutter, config.partition.kind
    eye = _EYES.get(name)
    if eye is None or (eye.sensor is not sensor and eye.sensor != sensor) or eye.clutter != clutter:
        if len(_EYES) >= _MOST_EYES:
            _EYES.clear()
        eye = _EYES[name] = eye_of(name, sensor, clutter)
    pose, memo = gossip.pose, gossip.memo
    x, y = pose[:2] if diagram == "voronoi" else gossip.cod
    generator = (x, y, gossip.power_radius if diagram == "power" else 0.0)
    detections, particles = len(gossip.detections_bytes) // 8, len(gossip.ids_bytes) // 8
    memo["row"] = pack_row(eye, pose, generator, detections, gossip.weight, particles, gossip.scanned)
    memo["sensor"] = sensor


def _table(rows: bytearray) -> np.ndarray:
    return np.frombuffer(rows, dtype=float).reshape(-1, COLUMNS)


Stated = tuple[np.ndarray, np.ndarray]  # states (N, 4) float32 and ids (N,) uint64


class Words:
    """Gossips of one round that have been `learn`ed, in the order of names."""

    def __init__(self, names: tuple[str, ...], table: np.ndarray, told: Callable[[], list[Gossip]], known: dict[str, Any]) -> None:
        """`table`: a row each (N, columns). `told`: asked when somebody wants them one by one. `known`: attributes known already."""
        self.names, self.table = names, table
        self._told = told
        self.chorus: Any = None  # who asked first for what all who hear this share, or what they share (`chorus`)
        self.__dict__.update(known)

    @classmethod
    def of_gossips(cls, gossips: list[Gossip], rows: bytearray) -> "Words":
        """The gossips themselves, and their rows end to end."""
        return cls(tuple([gossip.sender for gossip in gossips]), _table(rows), lambda: gossips, {"gossips": gossips})

    @classmethod
    def of_scans(cls, rows: bytearray, detections: np.ndarray) -> "Words":
        """Scans that nobody has put into a gossip: their rows, and all detections (D, 2)."""
        return cls((), _table(rows), list, {"detections": detections})

    @once
    def gossips(self) -> list[Gossip]:
        """One by one."""
        return self._told()

    @once
    def salts(self) -> np.ndarray:
        """Keys of the sensors' names (N,) uint64."""
        return self.table[:, SALT].copy().view(np.uint64)

    @once
    def everyone(self) -> frozenset[str]:
        """The names once more, to look them up."""
        return frozenset(self.names)

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
        if not self.gossips:
            return None
        tick, view = self.gossips[0].claim_tick, self.gossips[0].view
        for gossip in self.gossips:
            if gossip.view != view or gossip.claim_tick != tick:
                return None
        return tick, view

    @property
    def stated(self) -> Stated:
        """States (N, 4) float32 and ids (N,) of all their particles, gossip after gossip, as they were stamped.

        It is most of what a round reads, and nobody else asks before the next one: so only the last that was asked keeps it.
        """
        if self.stands_ready:
            return _LATEST[0][1]
        return self.remember(*self.stated_by([*range(len(self.gossips))]))

    @property
    def stands_ready(self) -> bool:
        """Whether what is `stated` has been put together already."""
        return bool(_LATEST) and _LATEST[0][0] is self

    def stated_by(self, rows: list[int]) -> Stated:
        """What is `stated` by some of them."""
        gossips = self.gossips
        states = np.frombuffer(bytearray().join([gossips[row].states_bytes for row in rows]), dtype=np.float32)
        ids = np.frombuffer(bytearray().join([gossips[row].ids_bytes for row in rows]), dtype=np.uint64)
        return states.reshape(-1, 4), ids

    def boxes(self, box: Callable[[bytes], bytes]) -> np.ndarray:
        """West, south, east and north of the particles of each (N, 4), m; `box` finds them in bytes of states, once for each gossip."""
        found: list[bytes] = [gossip.memo.get("box", b"") for gossip in self.gossips]
        for place, gossip in enumerate(self.gossips) if b"" in found else ():
            found[place] = gossip.memo["box"] = found[place] or box(gossip.states_bytes)
        return np.frombuffer(b"".join(found), dtype=float).reshape(-1, 4)

    def remember(self, states: np.ndarray, ids: np.ndarray) -> Stated:
        """Take these as what was `stated`, until somebody else is asked."""
        _LATEST.append((self, (states, ids)))
        return states, ids

    @once
    def particles(self) -> Particles:
        """The same with their weights."""
        states, ids = self.stated
        return Particles(states.astype(float), self.table[:, WEIGHT].repeat(self.table[:, PARTICLES].astype(np.int64)), ids)

    def scans(self) -> list[Scan]:
        """The scans one by one, those of the silent left out, in the order in which they count: by ascending p_d, then by name."""
        found = []
        for gossip, numbers in zip(self.gossips, self.table):
            if numbers[KIND] != SILENT:
                detections = gossip.detections.astype(float)
                order = np.arange(len(detections), dtype=np.uint64)
                sensor = gossip.memo["sensor"]
                scan = Scan(key("sensor", gossip.sender), sensor, gossip.pose, detections, order, float(numbers[KAPPA]))
                found.append((float(numbers[PROB]), scan))
        return [scan for _, scan in sorted(found, key=lambda one: one[0])]


def particles_of(told: Words | Particles) -> Particles:
    """Particles, whether they stand in gossips or by themselves."""
    return told.particles if isinstance(told, Words) else told


_LATEST: deque[tuple[Words, Stated]] = deque(maxlen=1)  # who was asked last
_RECENT: deque[tuple[bytearray, Words]] = deque(maxlen=2)  # in a simulation all agents hear the same


def side_by_side(gossips: list[Gossip]) -> Words:
    """The gossips side by side; the same object for the same gossips, if they were the last ones asked for."""
    rows = bytearray().join([gossip.memo["row"] for gossip in gossips])
    for known, words in _RECENT:
        if known == rows and words.gossips == gossips:
            return words
    words = Words.of_gossips(gossips, rows)
    _RECENT.append((rows, words))
    return words


def forget() -> None:
    """Share nothing of what was asked for so far, as if in another process."""
    _RECENT.clear()
    _LATEST.clear()
