"""The messages: frozen msgspec structs, one per kind, on the wire as msgpack maps (docs/reference/protocol.md specifies them).

Arrays are raw little-endian bytes on the wire; attributes are read-only numpy views of them. The types hold the limits of single
numbers, and `check` the other rules of a message alone. Rules that need the context are checked elsewhere: the sender against the key in
`codec`, the limits of the announced sensor in the agent. All lengths in m, times in s, angles in rad.
"""

import struct
from math import cos, hypot, pi, sin

import msgspec
import numpy as np

from protocol.cached_attribute import cached_attribute
from protocol.fields import (
    CLAIM,
    DETECTIONS,
    F4,
    F8,
    IDS,
    LARGEST_LABEL,
    LARGEST_NUMBER,
    MAX_SETTINGS,
    OBSTACLES,
    STATES,
    VALUE_SIZE,
    LabelPart,
    Malformed,
    Name,
    are_labels,
    array_field,
    ascend,
    check_label_numbers,
    check_rows,
    read_labels,
)
from protocol.gaussian_components import check_components, check_mass, read_components
from protocol.message import (
    Area,
    LagNumber,
    Magnitude,
    Message,
    Names,
    Natural,
    Number,
    PaceNumber,
    RowsOf8Bytes,
    RowsOf16Bytes,
    RowsOf24Bytes,
    SharedSettings,
    StatedPose,
    Tick,
    TileNumber,
    Time,
    Vector,
)
from protocol.observer_messages import Estimate, Truth
from protocol.sensing import WedgeSensor
from protocol.settings_digest import settings_digest


def check_settings(settings: SharedSettings) -> None:
    """Refuse settings that are too many; names and texts count their characters, other values `VALUE_SIZE`."""
    size = 0
    for section, values in settings.items():
        size += len(section)
        for name, value in values.items():
            size += len(name) + (len(value) if isinstance(value, str) else VALUE_SIZE)
    if size > MAX_SETTINGS:
        raise Malformed("size", f"settings: {size} characters, at most {MAX_SETTINGS} are allowed")


class Hello(Message, frozen=True, kw_only=True, dict=True, tag="hello"):
    """The announcement of a participant: its sensor, its settings, and the peers from which it receives Hellos."""

    role: Name = "agent"
    software: str = ""
    sensor_class: str = ""  # a name from the scenario, "A" to "H" for those of the paper
    sensor: WedgeSensor | None = None  # the numbers of a wedge; None: the receiver looks the class up in its own scenario
    heard: Names = ()
    neighbours_only: bool = False  # True: the sender receives the world's Hello alone and knows its peers by their beacons
    settings: SharedSettings = {}  # those on which all agree; a setting that is missing is not compared

    @cached_attribute
    def digest(self) -> int:
        """The hash of the settings, as in a Beacon."""
        return settings_digest(self.settings)

    def check(self) -> None:
        if self.settings:
            check_settings(self.settings)


class Beacon(Message, frozen=True, kw_only=True, dict=True, tag="beacon"):
    """The position and reach of an agent, at a low rate: enough to decide whether to subscribe to its Gossip."""

    tick: Tick
    position: Vector  # of the sensor
    cod: Vector  # centroid of detection
    power_radius: Magnitude
    reach: Magnitude  # of the footprint, from the position
    column: TileNumber  # of the tile to which this is addressed: the tile of the position, or one that is asked for beacons
    row: TileNumber
    sensor_class: str = ""  # as in Hello
    sensor: WedgeSensor | None = None  # as in Hello
    asks: bool = False  # True: every receiver sends a beacon soon
    settings: Natural = 0  # hash of the settings of the Hello; 0: not given
    widest_reach: Magnitude = 0.0  # the largest reach, distance from sensor to COD and power radius of all known agents and the sender
    widest_offset: Magnitude = 0.0
    widest_radius: Magnitude = 0.0

    @cached_attribute
    def table_row(self) -> bytes:
        """Position, reach, COD and power radius, as float64; a table of positions joins those of many beacons."""
        return _pack_position(*self.position, self.reach, *self.cod, self.power_radius)

    @property
    def tile(self) -> tuple[int, int]:
        """Column from the west, row from the south."""
        return self.column, self.row


UNKNOWN_AGE = 255
GOSSIP_NUMBERS = 13  # x, y, cosine and sine of the heading, COD x, y, power radius, weight, detections, particles, scanned, `pose_noise`
_pack_numbers = struct.Struct(f"<{GOSSIP_NUMBERS}d").pack
_pack_plan = struct.Struct("<3d").pack
_pack_position = struct.Struct("<6d").pack
_unpack_radius = struct.Struct("<16xd").unpack_from  # of the first row of a claim
_EXACT = (0.0, 0.0)  # noise of a pose


class Gossip(Message, frozen=True, kw_only=True, dict=True, tag="gossip"):
    """The round of one agent: its pose and scan at `tick`, and its cell and particles after round `claim_tick`."""

    sender: str  # a Name; checked by comparison with the key, which is parsed once and not in every round
    tick: Tick
    pose: StatedPose  # x, y, heading
    cod: Vector  # centroid of detection (14); the generator of the cell, but with `voronoi` the position is
    power_radius: Magnitude  # g(U) (13)
    unused: Area  # U, m^2 (11)
    detections_bytes: RowsOf8Bytes = msgspec.field(name="detections", default=b"")  # (M, 2) float32, as the sensor measures
    scanned: bool = True  # False: no scan in this tick, unlike an empty scan
    listening: bool = False  # True: a new incarnation without a cell
    claim_tick: Tick = 0  # the round in which the claim was cut
    claim_names: Names = ()  # the generators that bound the cell, the sender first; empty: no cell
    claim_bytes: RowsOf24Bytes = msgspec.field(name="claim", default=b"")  # (G, 3) float64: their generators, x, y and power radius
    diagram_hash: Natural = 0  # hash of all generators from which the claim was cut
    weight: Magnitude = 0.0  # of each particle, expected targets
    states_bytes: RowsOf16Bytes = msgspec.field(name="states", default=b"")  # (N, 4) float32: x, y, vx, vy
    ids_bytes: RowsOf8Bytes = msgspec.field(name="ids", default=b"")  # (N,) uint64
    components_bytes: bytes = msgspec.field(name="components", default=b"")  # (N,) of `COMPONENT`, from a tracker of Gaussian mixtures
    labels_bytes: RowsOf8Bytes = msgspec.field(name="labels", default=b"")  # (K,) uint64: a table of labels, strictly ascending
    label_numbers_bytes: bytes = msgspec.field(name="label_numbers", default=b"")  # (N,) uint8, uint16 if K > 256: places in the table
    particles: bytes = b""  # in place of states and ids, which are empty then: the same in few bytes (protocol/compact_particles.py)
    goal: Vector | None = None  # the place that the sensor goes to; None: it stays
    goal_utilisation: Magnitude = 0.0  # expected targets there, as a multiple of the number that the sensor can hold
    pace: PaceNumber = 1  # the sender has the time for the ticks that this number divides
    behind: LagNumber = 0  # the particles are so many ticks older than those of the tick before: later rounds wait for late gossips
    lag: LagNumber = 0  # rounds must be played so many ticks late, so that the sender hears most gossips
    pose_noise: tuple[Magnitude, Magnitude] | None = None  # standard deviations of the pose, m on each axis and rad; None: it is exact
    claim_ages: bytes = b""  # ticks before `claim_tick` of each generator of the claim; empty: all are of it

    detections = array_field("detections_bytes", DETECTIONS)  # (M, 2) float32
    claim = array_field("claim_bytes", CLAIM)  # (G, 3) float64
    states = array_field("states_bytes", STATES)  # (N, 4) float32
    ids = array_field("ids_bytes", IDS)  # (N,) uint64, ascending

    def __hash__(self) -> int:
        """A hash that reads no arrays, for pure memos."""
        return hash((self.sender, self.incarnation, self.tick, self.pose))

    @cached_attribute
    def claim_ticks(self) -> list[int]:
        """The tick of each generator of the claim; -1: it is unknown."""
        ages = self.claim_ages or bytes(len(self.claim_names))
        return [-1 if age == UNKNOWN_AGE else self.claim_tick - age for age in ages]

    @cached_attribute
    def components(self) -> np.ndarray:
        """(N,) of `COMPONENT`, by ascending id."""
        return read_components(self.components_bytes)

    @cached_attribute
    def labels(self) -> np.ndarray:
        """The label of each particle (N,) uint64; 0: none."""
        return read_labels([self.label_part])

    @property
    def label_part(self) -> LabelPart:
        """The table of labels, the numbers in it, and the number of particles (`fields.read_labels`)."""
        return self.labels_bytes, self.label_numbers_bytes, len(self.ids_bytes) // 8

    @cached_attribute
    def table_row(self) -> bytes:
        """The single numbers of the message, `GOSSIP_NUMBERS` of float64; a gossip table joins those of many gossips."""
        (x, y, heading), (east, north), noise = self.pose, self.cod, self.pose_noise or _EXACT
        pose, generator = (x, y, cos(heading), sin(heading)), (east, north, self.power_radius)
        detections, particles = len(self.detections_bytes) // 8, len(self.ids_bytes) // 8
        return _pack_numbers(*pose, *generator, self.weight, detections, particles, self.scanned, *noise)

    @cached_attribute
    def extent(self) -> tuple[float, float]:
        """What the announced sensor must allow: an area in m^2, and the distance of the COD from the sensor in m.

        The area is the largest of U and of the discs with the power radius and with that in the own claim.
        """
        (x, y, _), (east, north), radius = self.pose, self.cod, self.power_radius
        if self.claim_bytes:
            (claimed,) = _unpack_radius(self.claim_bytes)
            radius = max(radius, abs(claimed))
        return max(self.unused, pi * radius * radius), hypot(east - x, north - y)

    @cached_attribute
    def plan(self) -> bytes:
        """The goal, or the place of the sensor without one, and its utilisation, as float64."""
        x, y = self.goal if self.goal is not None else self.pose[:2]
        return _pack_plan(x, y, self.goal_utilisation)

    def check(self) -> None:
        self.check_lengths()
        self.check_contents()

    def check_lengths(self) -> None:
        """Refuse arrays that do not fit each other, and what no array states."""
        DETECTIONS.count(self.detections_bytes)
        self._check_claim()
        count = IDS.count(self.ids_bytes)
        if len(self.states_bytes) != STATES.size * count:
            raise Malformed("shape", f"ids: {count} ids for {STATES.count(self.states_bytes)} states")
        check_mass("weight: the particles", self.weight * count)
        check_label_numbers(self.labels_bytes, self.label_numbers_bytes, count)

    def check_contents(self) -> None:
        """Refuse numbers of an array that are out of range, and ids and labels that do not ascend."""
        check_rows(DETECTIONS, self.detections_bytes)
        check_rows(CLAIM, self.claim_bytes)
        check_rows(STATES, self.states_bytes)
        if not ascend([self.ids_bytes]):
            raise Malformed("range", "ids: should be strictly ascending")
        if not are_labels([self.labels_bytes]):
            raise Malformed("range", f"labels: should be strictly ascending and at most {LARGEST_LABEL}")
        check_components(self.components_bytes)

    def _check_claim(self) -> None:
        names, generators = self.claim_names, len(self.claim_names)
        if len(self.claim_bytes) != CLAIM.size * generators:
            raise Malformed("shape", f"claim_names: {generators} names for {CLAIM.count(self.claim_bytes)} generators")
        if self.claim_ages and len(self.claim_ages) != generators:
            raise Malformed("shape", f"claim_ages: {len(self.claim_ages)} ages for {generators} generators")
        if names and names[0] != self.sender:
            raise Malformed("sender", f"claim_names: the first should be the sender, not {names[0][:64]!r}")
        if self.states_bytes and not names:
            raise Malformed("shape", "states: particles without a claim")
        if self.components_bytes and not names:
            raise Malformed("shape", "components: a mixture without a claim")
        if self.claim_tick and self.claim_tick >= self.tick:
            raise Malformed("range", f"claim_tick = {self.claim_tick}: should be earlier than tick = {self.tick}")


def are_contents_valid(gossips: list[Gossip]) -> bool:
    """Whether one pass proves that `check_contents` refuses none of these gossips (see `check_rows`); if not, each must be checked."""
    states = np.frombuffer(b"".join([gossip.states_bytes for gossip in gossips]), F4)
    claims = np.frombuffer(b"".join([gossip.claim_bytes for gossip in gossips]), F8)
    detections = np.frombuffer(b"".join([gossip.detections_bytes for gossip in gossips]), F4)
    return (
        not any(gossip.components_bytes for gossip in gossips)
        and float(np.vdot(states, states) + np.vdot(claims, claims) + np.vdot(detections, detections)) < 0.5 * LARGEST_NUMBER**2
        and ascend([gossip.ids_bytes for gossip in gossips])
        and are_labels([gossip.labels_bytes for gossip in gossips])
    )


class Observation(Message, frozen=True, kw_only=True, dict=True, tag="observation"):
    """From the world to one agent: the pose of its body and the detections of its sensor at `tick`."""

    recipient: Name
    tick: Tick
    time: Time  # world time since its start
    pose: StatedPose
    detections_bytes: RowsOf8Bytes = msgspec.field(name="detections", default=b"")  # (M, 2) float32
    obstacles_bytes: RowsOf16Bytes = msgspec.field(name="obstacles", default=b"")  # (K, 2) float64: centres of the bodies close by
    scanned: bool = True  # False: no scan in this tick, unlike an empty scan

    detections = array_field("detections_bytes", DETECTIONS)  # (M, 2) float32
    obstacles = array_field("obstacles_bytes", OBSTACLES)  # (K, 2) float64

    def check(self) -> None:
        check_rows(DETECTIONS, self.detections_bytes)
        check_rows(OBSTACLES, self.obstacles_bytes)


class BodyPose(Message, frozen=True, kw_only=True, dict=True, tag="pose"):
    """From a body of its own to the other bodies: where it is at `tick`, so that their agents keep away from it."""

    tick: Tick
    pose: StatedPose


class Command(Message, frozen=True, kw_only=True, dict=True, tag="command"):
    """From an agent to the world: the motion of its body until the next command (1)."""

    tick: Tick
    velocity: Vector  # m/s
    turn_rate: Number  # rad/s, counter-clockwise


class Halt(Message, frozen=True, kw_only=True, dict=True, tag="halt"):
    """From an operator to all bodies: stand still until a later Halt with `held` false. The larger incarnation is the later one."""

    held: bool


_TYPES: tuple[type[Message], ...] = (Hello, Beacon, Gossip, Observation, BodyPose, Command, Estimate, Truth, Halt)
KINDS = {str(message_type.__struct_config__.tag): message_type for message_type in _TYPES}  # the type of each kind, by its tag
