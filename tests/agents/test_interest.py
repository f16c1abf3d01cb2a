"""Whom an agent must hear, against the diagram cut out by hand and on a dense grid."""

import numpy as np
import pytest

from agents.coverage.cells import power_cell
from agents.interest.selection import SELECTION_MARGIN, KnownArena, owners, select_peers
from agents.interest.tiles import Bounds, Rectangle
from protocol.geometry import EMPTY, distances, rectangle

ARENA = rectangle(200.0, 200.0)
GROUND = KnownArena(ARENA, Bounds(reach=25.0, offset=7.0, radius=20.0), drift=5.0)


def table(places: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """Positions and reaches (N, 3) of others and generators (N + 1, 3), the own one last, side by side (see `position_table`)."""
    return np.column_stack([np.vstack([places, np.zeros(3)]), generators])


def test_owners_misses_nobody_who_owns_a_place_near_a_point() -> None:
    for seed in range(20):
        print(f"seed {seed}")
        rng = np.random.default_rng(seed)
        generators = np.column_stack([rng.random((30, 2)) * 60.0, rng.random(30) * 8.0])
        points = np.array([[30.0, 30.0]])
        places = points + (rng.random((4000, 2)) - 0.5) * 4.0  # all within 4 / sqrt(2) m
        dx, dy = places[:, :1] - generators[:, 0], places[:, 1:] - generators[:, 1]
        really = set((dx * dx + dy * dy - generators[:, 2] ** 2).argmin(axis=1).tolist())
        assert really <= set(np.nonzero(owners(points, generators)[0])[0].tolist())


def test_a_row_of_sensors_hears_its_own_surroundings() -> None:
    """Ten discs of 5 m every 20 m on a line: the cell of the third goes from 40 to 60 m, the halo is 6 m."""
    middles = 10.0 + 20.0 * np.arange(10)
    generators = np.column_stack([middles, np.full(10, 100.0), np.full(10, 5.0)])
    order = [0, 1, 3, 4, 5, 6, 7, 8, 9, 2]  # the own one last
    cell = power_cell(2, generators[:, :2], generators[:, 2], ARENA)
    places = np.column_stack([generators[order[:-1], :2], np.full(9, 5.0)])
    heard = select_peers(cell, (50.0, 100.0), 5.0, 6.0, table(places, generators[order]), GROUND).chosen
    needed = [abs(middles[index] - 50.0) - 20.0 <= 6.0 + SELECTION_MARGIN for index in order[:-1]]
    assert [bool(asked) or not must for asked, must in zip(heard, needed)] == [True] * 9
    assert not heard[-1] and not heard[-2]


def test_a_far_sensor_that_reaches_here_is_heard() -> None:
    cell = rectangle(10.0, 10.0)
    generators = np.array([[30.0, 5.0, 1.0], [150.0, 5.0, 1.0], [5.0, 5.0, 1.0]])
    near, far = select_peers(
        cell, (5.0, 5.0), 5.0, 6.0, table(np.array([[30.0, 5.0, 5.0], [150.0, 5.0, 140.0]]), generators), GROUND
    ).chosen
    assert near and far


@pytest.mark.parametrize("reach", [5.0, 25.0])
def test_without_a_cell_the_owner_of_the_place_is_heard(reach: float) -> None:
    generators = np.array([[100.0, 100.0, 30.0], [100.0, 20.0, 1.0], [100.0, 101.0, 1.0]])
    heard = select_peers(EMPTY, (100.0, 101.0), reach, 6.0, table(np.column_stack([generators[:2, :2], [5.0, 5.0]]), generators), GROUND)
    assert heard.chosen[0]


def test_nobody_from_outside_the_needed_ground_can_own_or_see_what_matters() -> None:
    """Random swarms, and strangers outside of what a choice needs, as strong as any: none of them would have been chosen."""
    bounds = Bounds(reach=12.0, offset=4.0, radius=9.0)
    ground = KnownArena(ARENA, bounds, drift=0.0)
    outside = 0
    for seed in range(40):
        print(f"seed {seed}")
        rng = np.random.default_rng(seed)
        generators = np.column_stack([60.0 + rng.random((40, 2)) * 80.0, rng.random(40) * 9.0])
        cell = power_cell(39, generators[:, :2], generators[:, 2], ARENA)
        eye = (float(generators[39, 0]), float(generators[39, 1]))
        places = np.column_stack([generators[:39, :2], rng.random(39) * 12.0])
        needed = select_peers(cell, eye, 8.0, 6.0, table(places, generators), ground).needed
        for _ in range(20):
            x, y, turn = rng.random(3) * [200.0, 200.0, 6.3]
            if needed.contains(Rectangle(x, y, x, y)):
                continue
            outside += 1
            stranger = [x + 4.0 * np.cos(turn), y + 4.0 * np.sin(turn), 9.0]
            chosen = select_peers(
                cell, eye, 8.0, 6.0, table(np.vstack([[x, y, 12.0], places]), np.vstack([stranger, generators])), ground
            ).chosen
            grown = power_cell(40, np.vstack([stranger, generators])[:, :2], np.vstack([stranger, generators])[:, 2], ARENA)
            assert grown.shape == cell.shape and np.allclose(grown, cell), (seed, x, y)
            assert not chosen[0] or not _matters(stranger, generators, cell, eye), (seed, x, y)
    assert outside > 100


def _matters(stranger: list[float], generators: np.ndarray, cell: np.ndarray, eye: tuple[float, float]) -> bool:
    """Whether a generator owns a point of a fine grid within the halo of a cell, or in the footprint, `SELECTION_MARGIN` m wider."""
    axis = np.arange(0.0, 200.0, 1.0)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    near = (distances(cell, points) <= 6.0 + SELECTION_MARGIN) | (
        np.hypot(points[:, 0] - eye[0], points[:, 1] - eye[1]) <= 8.0 + SELECTION_MARGIN
    )
    points = points[near]

    def power(generator: np.ndarray) -> np.ndarray:
        found: np.ndarray = (points[:, 0] - generator[0]) ** 2 + (points[:, 1] - generator[1]) ** 2 - generator[2] ** 2
        return found

    return bool((power(np.array(stranger)) <= np.min([power(generator) for generator in generators], axis=0)).any())
