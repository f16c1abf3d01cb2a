"""The last known positions of peers: a row of numbers for each, updated by every message that states one."""

import struct
from itertools import compress
from typing import NamedTuple

import numpy as np

from agents.gossip.table import AnnouncedSensor
from protocol.messages import Beacon, Gossip

POSITION_ROW = struct.Struct("<6d")
SIZE = POSITION_ROW.size  # bytes
_NO_RADIUS = bytes(8)
# columns, all in m: the sensor and its reach, and the generator
SENSOR_X, SENSOR_Y, SENSOR_REACH, GENERATOR_X, GENERATOR_Y, POWER_RADIUS = range(6)


def gossip_row(gossip: Gossip, sensor: AnnouncedSensor, partition_kind: str) -> bytes:
    """The row of the sender of a gossip, whose generator is that of a diagram."""
    numbers = gossip.numbers
    return _row(numbers[:16] + sensor.columns[:8] + numbers[32:56], partition_kind)  # place, reach, COD and power radius


def beacon_row(beacon: Beacon, partition_kind: str) -> bytes:
    """The row of the sender of a beacon, whose generator is that of a diagram."""
    return _row(beacon.numbers, partition_kind)


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

    def __init__(self) -> None:
        self.names: list[str] = []  # the names of the rows
        self.version = 0  # changes whenever a peer comes or goes
        self._ticks: list[int] = []  # the tick in which each row was stated
        self._oldest = 0  # no tick of a row is smaller
        self._rows: dict[str, int] = {}
        self._numbers = bytearray(SIZE * 8)

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: str) -> bool:
        return name in self._rows

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
        """Remove the rows older than the tick `since`, and those later than `until`, whose ticks are wrong; return their names."""
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
