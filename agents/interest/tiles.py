"""The tiles of the arena in which beacons are published (docs/reference/protocol.md), and bounds on unknown agents."""

import math
from typing import NamedTuple

from protocol.keys import Tile
from protocol.settings import ArenaSettings


class Rectangle(NamedTuple):
    """An axis-parallel rectangle; sides in m."""

    west: float
    south: float
    east: float
    north: float

    def contains(self, other: "Rectangle") -> bool:
        """Whether another rectangle lies in this one."""
        return self.west <= other.west and self.south <= other.south and self.east >= other.east and self.north >= other.north

    def wider(self, width: float) -> "Rectangle":
        """The rectangle with all sides moved outward by `width` m."""
        return Rectangle(self.west - width, self.south - width, self.east + width, self.north + width)


class TileBlock(NamedTuple):
    """A block of tiles: first and last column and row."""

    west: int
    south: int
    east: int
    north: int

    def tiles(self) -> list[Tile]:
        """All tiles of the block."""
        return [(column, row) for column in range(self.west, self.east + 1) for row in range(self.south, self.north + 1)]


class Bounds(NamedTuple):
    """What some agents do not exceed, in m: reach of the sensor, distance from it to the COD, power radius."""

    reach: float
    offset: float
    radius: float

    def wider(self, other: "Bounds") -> "Bounds":
        """The bounds of both groups of agents; the same object if the others add nothing."""
        if other.reach <= self.reach and other.offset <= self.offset and other.radius <= self.radius:
            return self
        return Bounds(*map(max, self, other))


class Tiling:
    """Square tiles of `side` m from (0, 0); a point outside the arena belongs to the nearest tile."""

    def __init__(self, side: float, arena: ArenaSettings) -> None:
        self.side = side
        self._last = max(1, math.ceil(arena.width / self.side)) - 1, max(1, math.ceil(arena.height / self.side)) - 1

    def tile(self, point: tuple[float, float]) -> Tile:
        """The tile of a point."""
        (x, y), (column, row), side = point, self._last, self.side
        return max(0, min(column, math.floor(x / side))), max(0, min(row, math.floor(y / side)))

    def block(self, rectangle: Rectangle) -> TileBlock:
        """The tiles that a rectangle touches."""
        return TileBlock(*self.tile(rectangle[:2]), *self.tile(rectangle[2:]))

    def around(self, tile: Tile, width: int) -> TileBlock:
        """The block of up to `width` tiles on every side of a tile."""
        (column, row), (columns, rows) = tile, self._last
        return TileBlock(max(0, column - width), max(0, row - width), min(columns, column + width), min(rows, row + width))

    def rectangle_of(self, block: TileBlock) -> Rectangle:
        """The rectangle of all positions whose beacons are published in these tiles; it is infinite where the arena ends."""
        (west, south, east, north), (column, row), side = block, self._last, self.side
        return Rectangle(
            west * side if west > 0 else -math.inf,
            south * side if south > 0 else -math.inf,
            (east + 1) * side if east < column else math.inf,
            (north + 1) * side if north < row else math.inf,
        )
