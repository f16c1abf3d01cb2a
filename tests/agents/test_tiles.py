"""The tiles in which beacons are said, and what bounds a generator of which none was heard."""

import math

import pytest

from agents.gossip.table import announced_sensor
from agents.interest.tiles import Bounds, Rectangle, TileBlock, Tiling
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import ArenaSettings

TILING = Tiling(25.0, ArenaSettings(width=110.0, height=60.0))  # five columns, the last 10 m wide, and three rows


def test_a_place_has_one_tile_and_outside_the_arena_the_nearest() -> None:
    assert TILING.tile((0.0, 0.0)) == (0, 0) and TILING.tile((24.9, 25.0)) == (0, 1)
    assert TILING.tile((-50.0, 1e6)) == (0, 2) and TILING.tile((1e6, -1.0)) == (4, 0)


def test_the_ground_of_a_box_has_no_end_where_the_arena_ends() -> None:
    assert TILING.rectangle_of(TileBlock(1, 1, 2, 1)) == Rectangle(25.0, 25.0, 75.0, 50.0)
    assert TILING.rectangle_of(TileBlock(0, 0, 4, 2)) == Rectangle(-math.inf, -math.inf, math.inf, math.inf)


def test_the_box_of_a_rectangle_holds_it() -> None:
    asked = Rectangle(30.0, -20.0, 51.0, 20.0)
    assert TILING.block(asked) == TileBlock(1, 0, 2, 0)
    assert TILING.rectangle_of(TILING.block(asked)).contains(asked) and not TILING.rectangle_of(TILING.block(asked)).contains(
        asked.wider(30.0)
    )
    assert TILING.around((0, 2), 1).tiles() == [(0, 1), (0, 2), (1, 1), (1, 2)]


def of_class(name: str) -> Bounds:
    return announced_sensor("s1", SENSOR_CLASSES[name], 0.0).bounds


def test_what_two_do_not_exceed_is_the_larger_of_each() -> None:
    narrow, long = Bounds(8.0, 5.0, 3.0), Bounds(25.0, 2.0, 3.0)
    assert narrow.wider(long) == long.wider(narrow) == Bounds(25.0, 5.0, 3.0)
    assert narrow.wider(Bounds(1.0, 5.0, 0.0)) is narrow


def test_the_bounds_of_a_sensor_are_its_reach_its_cod_and_the_radius_of_its_whole_capability() -> None:
    """Class D: 240 degrees, 25 m, p_d 0.99. Its COD lies 2 R sin(120 deg) / (3 * 2 pi / 3) ahead."""
    bounds = of_class("D")
    half = math.radians(120.0)
    assert bounds.reach == 25.0
    assert bounds.offset == pytest.approx(2.0 * 25.0 * math.sin(half) / (3.0 * half))
    assert bounds.radius == pytest.approx(math.sqrt(0.99 * half * 25.0**2 / math.pi))
