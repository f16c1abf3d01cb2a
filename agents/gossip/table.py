"""The gossips of a round side by side: a row of numbers for each, and their detections and particles end to end.

Rows are in the order of names. A row holds the numbers of a gossip and those of its sender's sensor. A round over many gossips is a few
operations on whole arrays.
"""

import hashlib
import math
import struct
from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from agents.config import AgentConfig
from agents.coverage.capacity import SensorFacts, power_radius, sensor_facts
from agents.interest.tiles import Bounds
from agents.tracking.births import Scan
from agents.tracking.measurement_likelihood import EXACT_POSE, kernel_variance, model_of, noise_of, sigma_poses, spread_of
from agents.tracking.particles import Particles
from protocol.cached_attribute import cached_attribute
from protocol.fields import read_labels
from protocol.gaussian_components import COMPONENT
from protocol.measuring import to_places
from protocol.messages import Gossip
from protocol.random_streams import random_key
from protocol.sensing import Pose, SensorModel, WedgeSensor, measurement_of

COLUMNS = 27
(
    X,
    Y,
    COS,
    SIN,
    GENERATOR_X,
    GENERATOR_Y,
    POWER_RADIUS,
    WEIGHT,
    DETECTIONS,
    PARTICLES,
    SCANNED,
    PLACE_NOISE,
    HEADING_NOISE,
    REACH,
    COS_HALF,
    PROB,
    CLUTTER_DENSITY,
    KIND,
    SALT,
    MODEL,
    RANGE_NOISE,
    BEARING_NOISE,
    FAR_PROB,
    COS_LEFT,
    SIN_LEFT,
    COS_RIGHT,
    SIN_RIGHT,
) = range(COLUMNS)  # of `Gossip.table_row`, of the sensor, and of the headings to the left and right of a pose that may err
NO_SCAN, WEDGE, OTHER = 0.0, 1.0, 2.0  # kinds of scan: none in this tick, of a wedge, of another sensor

_SENSOR = struct.Struct("<5dQ4d32x")  # the columns from REACH on; the last four are 0 where poses are exact
_MOST_ANNOUNCED = 20000
TOLERANCE = 1.0 + 1e-9  # factor by which a gossip may exceed what its sender's sensor can do: rounding of another implementation


class AnnouncedSensor(NamedTuple):
    """The sensor that an agent announced."""

    sensor: SensorModel
    facts: SensorFacts
    columns: bytes  # its part of a row, from REACH on: lengths in m, angles in rad, clutter density per m^2
    most_area: float  # of the area in a gossip's `extent`, m^2: D with `TOLERANCE`
    most_distance: float  # of the distance in it, m: the reach with `TOLERANCE`
    bounds: Bounds


@lru_cache(maxsize=_MOST_ANNOUNCED)
def announced_sensor(name: str, sensor: SensorModel, clutter: float) -> AnnouncedSensor:
    """The sensor of an agent, with `clutter` expected points a scan; a pure memo: equal arguments give the same object."""
    half, near, far, kind = 0.0, 0.0, 0.0, OTHER
    if isinstance(sensor, WedgeSensor):
        half, near, far, kind = sensor.cos_half_angle, sensor.prob_detection, sensor.far_probability, WEDGE
    measures = model_of(measurement_of(sensor))
    packed = _SENSOR.pack(sensor.reach, half, near, clutter / sensor.area, kind, random_key("sensor", name), *measures, far)
    facts = sensor_facts(sensor)
    bounds = Bounds(sensor.reach, math.hypot(*facts.cod_offset), power_radius(facts.capability))
    return AnnouncedSensor(sensor, facts, packed, facts.capability * TOLERANCE, sensor.reach * TOLERANCE, bounds)


StatedParticles = tuple[np.ndarray, np.ndarray, np.ndarray]  # states (N, 4) float32; ids and labels (N,) uint64


class GossipTable:
    """Gossips of one round in the order of names. The rows of a table never change; what follows from them is computed once and kept."""

    def __init__(self, gossips: Sequence[Gossip], sensors: Sequence[AnnouncedSensor], config: AgentConfig) -> None:
        """`sensors`: of the senders. `config` states the partition, which determines the generators, and the noise of detections."""
        self.gossips, self.sensors, self.config = gossips, sensors, config
        self.names = tuple([gossip.sender for gossip in gossips])
        self.batched: Any = None  # the results for all agents of this table (`batched_round`)

    @cached_attribute
    def table(self) -> np.ndarray:
        """A row for each (N, COLUMNS): posed sensor, kind and size of its scan, weight of a particle, generator, number of particles."""
        rows = bytearray().join([part for gossip, sensor in zip(self.gossips, self.sensors) for part in (gossip.table_row, sensor.columns)])
        table = np.frombuffer(rows).reshape(-1, COLUMNS)
        table[:, KIND] *= table[:, SCANNED]
        if self.config.partition.kind == "voronoi":
            table[:, GENERATOR_X : GENERATOR_Y + 1] = table[:, X : Y + 1]
        if self.config.partition.kind != "power":
            table[:, POWER_RADIUS] = 0.0
        if self.config.pose.is_exact:
            table[:, PLACE_NOISE : HEADING_NOISE + 1] = 0.0
            return table
        for row, gossip in zip(table, self.gossips):
            # the last two turn left and right; an exact pose is one alone, which counts twice
            left, right = [heading for _, _, heading in 2 * sigma_poses(gossip.pose, gossip.pose_noise or EXACT_POSE)][-2:]
            row[COS_LEFT:] = math.cos(left), math.sin(left), math.cos(right), math.sin(right)
        return table

    @cached_attribute
    def plans(self) -> np.ndarray:
        """The goal x, y in m and its utilisation of each sender (N, 3); the place of a sender without a goal."""
        return np.frombuffer(b"".join([gossip.plan for gossip in self.gossips])).reshape(-1, 3)

    @cached_attribute
    def salts(self) -> np.ndarray:
        """Keys of the sensors' names (N,) uint64."""
        return self.table[:, SALT].copy().view(np.uint64)

    @cached_attribute
    def ages(self) -> dict[str, int]:
        """By how many ticks a generator is older than the newest one, for those that are older."""
        newest = max([gossip.tick for gossip in self.gossips], default=0)
        return {gossip.sender: newest - gossip.tick for gossip in self.gossips if gossip.tick < newest}

    @cached_attribute
    def name_set(self) -> frozenset[str]:
        """The names as a set."""
        return frozenset(self.names)

    @cached_attribute
    def generators(self) -> np.ndarray:
        """The generators (N, 3): point x, y and power radius, m."""
        return self.table[:, GENERATOR_X : POWER_RADIUS + 1].copy()

    @cached_attribute
    def diagram_hash(self) -> int:
        """The hash of all generators; never 0. Agents with equal hashes cut the same diagram."""
        digest = hashlib.blake2b("\n".join(self.names).encode(), digest_size=7)
        digest.update(self.generators.tobytes())
        return int.from_bytes(digest.digest(), "little") | 1

    @cached_attribute
    def detections(self) -> np.ndarray:
        """The places of all detections (D, 2) float64, scan after scan, m; of a bearing alone the middle of its beam."""
        joined = bytearray().join([gossip.detections_bytes for gossip in self.gossips])
        rows = np.frombuffer(joined, dtype="<f4").reshape(-1, 2).astype(float)
        if not self.table[:, MODEL].any():
            return rows
        parts = [
            to_places(measurement_of(each.sensor), each.sensor.reach, gossip.pose, gossip.detections)
            for gossip, each in zip(self.gossips, self.sensors)
        ]
        return np.concatenate(parts).astype(float)

    @cached_attribute
    def has_rays(self) -> bool:
        """Whether a sensor measures anything but positions, or poses are not exact."""
        return bool(self.table[:, MODEL].any()) or not self.config.pose.is_exact

    @cached_attribute
    def rays(self) -> np.ndarray:
        """The rays of all detections (D, 4) of agents/tracking/measurement_likelihood.py; (D, 0) if all are exact positions."""
        if not self.has_rays:
            return np.empty((len(self.detections), 0))
        rays, places = np.empty((len(self.detections), 4)), self.detections.tolist()
        kernel, number = kernel_variance(self.config.filter), 0
        for row in self.table.tolist():
            model, pose_noise = (row[MODEL], row[RANGE_NOISE], row[BEARING_NOISE]), (row[PLACE_NOISE], row[HEADING_NOISE])
            noise = noise_of(model, self.config.detection.noise, kernel, pose_noise)
            for _ in range(int(row[DETECTIONS])):
                dx, dy = places[number][0] - row[X], places[number][1] - row[Y]
                distance = math.sqrt(dx * dx + dy * dy)
                east, north = (dx / distance, dy / distance) if distance > 0.0 else (row[COS], row[SIN])
                rays[number] = east, north, distance, spread_of(noise.model, distance, row[REACH], noise)
                number += 1
        return rays

    @cached_attribute
    def listening(self) -> bool:
        """Whether a sender listens, and has no cell yet."""
        return True in [gossip.listening for gossip in self.gossips]

    @cached_attribute
    def views(self) -> list[tuple[SensorModel, Pose]]:
        """Sensor and pose of each agent that scanned."""
        return [(each.sensor, gossip.pose) for each, gossip in zip(self.sensors, self.gossips) if gossip.scanned]

    @cached_attribute
    def all_wedges(self) -> bool:
        """Whether every scan is that of a wedge sensor."""
        return OTHER not in self.table[:, KIND].tolist()

    @cached_attribute
    def common_diagram(self) -> tuple[int, int] | None:
        """The tick and the hash of the diagram that all claims share; None when they differ."""
        shared = {(gossip.claim_tick, gossip.diagram_hash) for gossip in self.gossips}
        return shared.pop() if len(shared) == 1 else None

    @property
    def stated(self) -> StatedParticles:
        """States (N, 4) float32, ids and labels (N,) uint64 of all particles, gossip after gossip, at the tick of their claims.

        These arrays are the largest of a round, and no later round reads them. Only the last table that computed them keeps them.
        """
        if not _LAST_STATED or _LAST_STATED[0][0] is not self:
            states = np.frombuffer(bytearray().join([gossip.states_bytes for gossip in self.gossips]), dtype=np.float32)
            ids = np.frombuffer(bytearray().join([gossip.ids_bytes for gossip in self.gossips]), dtype=np.uint64)
            labels = read_labels([gossip.label_part for gossip in self.gossips])
            _LAST_STATED.append((self, (states.reshape(-1, 4), ids, labels)))
        return _LAST_STATED[0][1]

    @cached_attribute
    def particles(self) -> Particles:
        """The particles of `stated` with their weights."""
        states, ids, labels = self.stated
        return Particles(states.astype(float), self.table[:, WEIGHT].repeat(self.table[:, PARTICLES].astype(np.int64)), ids, labels)

    @cached_attribute
    def components(self) -> np.ndarray:
        """The components of all Gaussian mixtures (N,), gossip after gossip (protocol/gaussian_components.py)."""
        return np.concatenate([np.empty(0, COMPONENT), *(gossip.components for gossip in self.gossips)])

    def scans(self) -> list[Scan]:
        """The scans of this tick, in the order of the update: by ascending p_d, then by name."""
        found, ends = [], np.cumsum(self.table[:, DETECTIONS]).astype(np.int64)
        for gossip, announced, numbers, salt, end in zip(self.gossips, self.sensors, self.table, self.salts.tolist(), ends):
            if numbers[KIND] != NO_SCAN:
                rows = slice(end - np.int64(numbers[DETECTIONS]), end)
                order, clutter_density = np.arange(numbers[DETECTIONS], dtype=np.uint64), float(numbers[CLUTTER_DENSITY])
                noise = float(numbers[PLACE_NOISE]), float(numbers[HEADING_NOISE])
                rays = self.rays[rows] if numbers[MODEL] or noise != EXACT_POSE else None  # whatever other sensors in the table measure
                scan = Scan(salt, announced.sensor, gossip.pose, self.detections[rows], order, clutter_density, rays, noise)
                found.append((float(numbers[PROB]), scan))
        return [scan for _, scan in sorted(found, key=lambda one: one[0])]


def as_particles(density: GossipTable | Particles) -> Particles:
    """The particles of a table, or the particles themselves."""
    return density.particles if isinstance(density, GossipTable) else density


_LAST_STATED: deque[tuple[GossipTable, StatedParticles]] = deque(maxlen=1)  # the table whose `stated` was computed last
_RECENT: deque[GossipTable] = deque(maxlen=2)  # a pure memo: in a simulation all agents hear the same gossips


def gossip_table(gossips: list[Gossip], sensors: list[AnnouncedSensor], config: AgentConfig) -> GossipTable:
    """The table of some gossips and the sensors of their senders. Equal arguments give a table of one of the last two calls."""
    for known in reversed(_RECENT):
        if known.config is config and known.sensors == sensors and known.gossips == gossips:
            return known
    table = GossipTable(gossips, sensors, config)
    _RECENT.append(table)
    return table


def newest_table() -> GossipTable:
    """The table that was made last, for measurements."""
    return _RECENT[-1]


def forget() -> None:
    """Drop the memos of this file, so that a measurement is that of a process of its own."""
    _RECENT.clear()
    _LAST_STATED.clear()
