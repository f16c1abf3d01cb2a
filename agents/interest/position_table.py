"""Where everybody was last known to be: a row of numbers for each peer, kept up as its entries arrive."""

import struct
from collections.abc import Iterable
from itertools import compress
from typing import NamedTuple

import numpy as np

from protocol.messages import Beacon

Point = tuple[float, float]  # x, y, m
POSITION_ROW = struct.Struct("<6d")
SIZE = POSITION_ROW.size  # bytes
SENSOR_X, SENSOR_Y, REACH, EAST, NORTH, RADIUS = range(6)  # columns, all in m: the sensor and its reach, and the generator


def position_row(position: Point, reach: float, cod: Point, radius: float, diagram: str) -> bytes:
    """The row of a sensor with its reach and of what is its generator in a diagram, m."""
    return POSITION_ROW.pack(*position, reach, *(position if diagram == "voronoi" else cod), radius if diagram == "power" else 0.0)


def beacon_row(beacon: Beacon, diagram: str) -> bytes:
    """The row of who says a beacon."""
    return position_row(beacon.position, beacon.reach, beacon.cod, beacon.power_radius, diagram)


class UnsubscribedGenerators(NamedTuple):
    """Generators of those who are known but not listened to, where they were last: (N, 3), x, y and power radius in m."""

    generators: np.ndarray
    everybody: tuple[str, ...]  # they and those who are listened to
    chosen: np.ndarray  # of them all: who is listened to, bool

    def names(self) -> tuple[str, ...]:
        """Theirs, in the order of the generators."""
        return tuple(compress(self.everybody, (~self.chosen).tolist()))


NO_GENERATORS = UnsubscribedGenerators(np.empty((0, 3)), (), np.zeros(0, dtype=bool))


class PositionTable:
    """Rows of those whose whereabouts are known, in no particular order."""

    def __init__(self) -> None:
        self.names: list[str] = []  # of the rows
        self.version = 0  # another one whenever somebody has come or gone
        self._ticks: list[int] = []  # of the entries
        self._oldest = 0  # none of them is older
        self._rows: dict[str, int] = {}
        self._numbers = bytearray(SIZE * 8)

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def put(self, name: str, tick: int, packed: bytes) -> None:
        """A word of that tick says where somebody is; an older one than the last is passed over."""
        row = self._rows.get(name)
        if row is None:
            row = self._rows[name] = len(self.names)
            self.names.append(name)
            self._ticks.append(tick)
            self._oldest = min(self._oldest, tick)
            self.version += 1
            if SIZE * (row + 2) > len(self._numbers):  # there is always room for one more
                self._numbers = self._numbers + bytes(len(self._numbers))
        elif tick < self._ticks[row]:
            return
        else:
            self._ticks[row] = tick
        self._numbers[SIZE * row : SIZE * (row + 1)] = packed

    def put_all(self, entries: Iterable[tuple[str, int, bytes]]) -> None:
        """Put one after the other: names, ticks and rows."""
        rows, ticks, numbers, put = self._rows, self._ticks, self._numbers, self.put
        for name, tick, packed in entries:
            row = rows.get(name)
            if row is None:
                put(name, tick, packed)
                numbers = self._numbers
            elif tick >= ticks[row]:
                ticks[row] = tick
                start = SIZE * row
                numbers[start : start + SIZE] = packed

    def everybody(self) -> frozenset[str]:
        """All names at present."""
        return frozenset(self._rows)

    def remove(self, name: str) -> None:
        """Nobody knows any more where somebody is; the last takes the free row."""
        row = self._rows.pop(name, None)
        if row is None:
            return
        last, tick = self.names.pop(), self._ticks.pop()
        self.version += 1
        if row < len(self.names):
            self.names[row], self._ticks[row], self._rows[last] = last, tick, row
            end = SIZE * len(self.names)
            self._numbers[SIZE * row : SIZE * (row + 1)] = self._numbers[end : end + SIZE]

    def forget(self, since: int) -> list[str]:
        """Remove those whose last word is older than the tick `since`; who they were."""
        if since <= self._oldest:
            return []
        self._oldest = min(self._ticks, default=since)
        if self._oldest >= since:
            return []
        self._oldest = min([tick for tick in self._ticks if tick >= since], default=since)
        old = [name for name, tick in zip(self.names, self._ticks) if tick < since]
        for name in old:
            self.remove(name)
        return old

    def table(self, mine: bytes) -> np.ndarray:
        """All rows (N, 6) and, last, one more; to be used before the next word is put."""
        end = SIZE * len(self.names)
        self._numbers[end : end + SIZE] = mine
        return np.frombuffer(self._numbers, dtype=float, count=6 * (len(self.names) + 1)).reshape(-1, 6)
