"""The last known positions of peers, for an agent that hears neighbours only: a row of numbers for each, by its newest message."""

import struct
from collections.abc import Iterator
from itertools import compress
from typing import NamedTuple

import numpy as np

from agents.config import AgentConfig
from agents.gossip.table import AnnouncedSensor
from agents.interest.tiles import Rectangle
from agents.membership.peer import Peer, same_sensor
from protocol.messages import Beacon, Gossip

POSITION_ROW = struct.Struct("<6d")
SIZE = POSITION_ROW.size  # bytes
_NO_RADIUS = bytes(8)
# columns, all in m: the sensor and its reach, and the generator
SENSOR_X, SENSOR_Y, SENSOR_REACH, GENERATOR_X, GENERATOR_Y, POWER_RADIUS = range(6)


def gossip_row(gossip: Gossip, sensor: AnnouncedSensor, partition_kind: str) -> bytes:
    """The row of the sender of a gossip, whose generator is that of a diagram."""
    row = gossip.table_row
    return _row(row[:16] + sensor.columns[:8] + row[32:56], partition_kind)  # place, reach, COD and power radius


def beacon_row(beacon: Beacon, partition_kind: str) -> bytes:
    """The row of the sender of a beacon, whose generator is that of a diagram."""
    return _row(beacon.table_row, partition_kind)


def _row(row: bytes, partition_kind: str) -> bytes:
    """The row with the generator of a diagram in place of COD and power radius."""
    if partition_kind == "power":
        return row
    point = row[:16] if partition_kind == "voronoi" else row[24:40]
    return row[:24] + point + _NO_RADIUS


class UnsubscribedGenerators(NamedTuple):
    """The last generators (N, 3) of the known peers outside the interest set: x, y and power radius in m."""

    generators: np.ndarray
    known_names: tuple[str, ...]  # the names of all known peers
    chosen: np.ndarray  # for each of these: whether it is in the interest set, bool

    def names(self) -> tuple[str, ...]:
        """The names of these peers, in the order of the generators."""
        return tuple(compress(self.known_names, (~self.chosen).tolist()))


NO_GENERATORS = UnsubscribedGenerators(np.empty((0, 3)), (), np.zeros(0, dtype=bool))


class PositionTable:
    """Rows of peers with a known position, in no particular order."""

    def __init__(self, config: AgentConfig) -> None:
        self.silence_limit = config.ticks_of_silence  # rounds; the peer table keeps it equal to its own
        self.needed: Rectangle | None = None  # outside of this no new peer matters before the next selection
        self.names: list[str] = []  # the names of the rows
        self.version = 0  # changes whenever a peer comes or goes
        self._ticks: list[int] = []  # the tick in which each row was stated
        self._oldest = 0  # no tick of a row is smaller
        self._rows: dict[str, int] = {}
        self._numbers = bytearray(SIZE * 8)
        self._diagram = config.partition.kind
        self._pending: dict[str, Gossip] = {}  # the newest gossip of each peer in closed rounds, not noted yet

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def note(self, peer: Peer, beacon: Beacon) -> None:
        """Note the position in a beacon, if the peer is live."""
        if self._has_position(peer):
            self.put(peer.name, beacon.tick, beacon_row(beacon, self._diagram))

    def note_all(self, beacons: list[Beacon], peers: dict[str, Peer]) -> Iterator[Beacon]:
        """Note the beacons that change nothing but the position of a live, known peer; yield each other one, to be taken at once."""
        for beacon in beacons:
            peer = peers.get(beacon.sender)
            if (
                peer is None
                or peer.beacon is None
                or peer.suspected
                or not self._has_position(peer)
                or peer.incarnation != beacon.incarnation
                or beacon.tick < peer.beacon.tick
                or not same_sensor(beacon, peer.beacon)
            ):
                yield beacon
            else:
                peer.beacon = beacon
                self.put(beacon.sender, beacon.tick, beacon_row(beacon, self._diagram))

    def matters(self, beacon: Beacon) -> bool:
        """Whether a new peer with this beacon could change the selection before the next one is due."""
        x, y = beacon.position
        return self.needed is None or self.needed.contains(Rectangle(x, y, x, y))

    def close(self, gossips: dict[str, Gossip]) -> None:
        """Keep the gossips of a closed round. Their positions are noted by `catch_up`, which not every round needs."""
        self._pending.update(gossips)

    def catch_up(self, peers: dict[str, Peer], *, all_live: bool = False) -> None:
        """Note the positions in the gossips of closed rounds. `all_live`: all their senders are live."""
        gossips, self._pending = self._pending, {}
        for name, gossip in gossips.items():
            peer = peers.get(name)
            if peer is not None and peer.announced is not None and (all_live or self._has_position(peer)):
                self.put(name, gossip.tick, gossip_row(gossip, peer.announced, self._diagram))

    def put(self, name: str, tick: int, packed: bytes) -> None:
        """Set the row of a peer, stated in a tick. A row older than the last one is ignored."""
        row = self._rows.get(name)
        if row is None:
            row = self._rows[name] = len(self.names)
            self.names.append(name)
            self._ticks.append(tick)
            self._oldest = min(self._oldest, tick)
            self.version += 1
            if SIZE * (row + 2) > len(self._numbers):  # there is always room for one more row
                self._numbers = self._numbers + bytes(len(self._numbers))
        elif tick < self._ticks[row]:
            return
        else:
            self._ticks[row] = tick
        self._numbers[SIZE * row : SIZE * (row + 1)] = packed

    def name_set(self) -> frozenset[str]:
        """All names at present."""
        return frozenset(self._rows)

    def remove(self, name: str) -> None:
        """Remove the row of a peer, if there is one. The last row moves into the free place."""
        row = self._rows.pop(name, None)
        if row is None:
            return
        last, tick = self.names.pop(), self._ticks.pop()
        self.version += 1
        if row < len(self.names):
            self.names[row], self._ticks[row], self._rows[last] = last, tick, row
            end = SIZE * len(self.names)
            self._numbers[SIZE * row : SIZE * (row + 1)] = self._numbers[end : end + SIZE]

    def forget_outside(self, since: int, until: int) -> list[str]:
        """Remove the rows older than the tick `since`, and with them those later than `until`, whose ticks are wrong; return their names.

        Without a row that old all stay: a wrong tick is worth no search in every round.
        """
        if since <= self._oldest:
            return []
        self._oldest = min(self._ticks, default=since)
        if self._oldest >= since and max(self._ticks, default=until) <= until:
            return []
        self._oldest = min([tick for tick in self._ticks if since <= tick <= until], default=since)
        old = [name for name, tick in zip(self.names, self._ticks) if not since <= tick <= until]
        for name in old:
            self.remove(name)
        return old

    def table(self, own: bytes) -> np.ndarray:
        """All rows (N, 6) and, last, the own one. The array is valid until the next `put`."""
        end = SIZE * len(self.names)
        self._numbers[end : end + SIZE] = own
        return np.frombuffer(self._numbers, dtype=float, count=6 * (len(self.names) + 1)).reshape(-1, 6)

    def _has_position(self, peer: Peer) -> bool:
        """Whether a peer has a position: it has not gone, its sensor is known, and it has not been silent for long."""
        return not peer.is_gone and peer.announced is not None and peer.silent_rounds < self.silence_limit
