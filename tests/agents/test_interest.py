"""Whom an agent must hear, against the diagram cut out by hand and on a dense grid."""

import numpy as np
import pytest

from agents.cells import power_cell
from agents.interest import MARGIN, owners, wanted
from protocol.geometry import EMPTY, rectangle

ARENA = rectangle(200.0, 200.0)


def test_owners_misses_nobody_who_owns_a_place_near_a_point() -> None:
    for seed in range(20):
        print(f"seed {seed}")
        rng = np.random.default_rng(seed)
        generators = np.column_stack([rng.random((30, 2)) * 60.0, rng.random(30) * 8.0])
        points = np.array([[30.0, 30.0]])
        places = points + (rng.random((4000, 2)) - 0.5) * 4.0  # all within 4 / sqrt(2) m
        dx, dy = places[:, :1] - generators[:, 0], places[:, 1:] - generators[:, 1]
        really = set((dx * dx + dy * dy - generators[:, 2] ** 2).argmin(axis=1).tolist())
        assert really <= set(np.nonzero(owners(points, generators))[0].tolist())


def test_a_row_of_sensors_hears_its_own_surroundings() -> None:
    """Ten discs of 5 m every 20 m on a line: the cell of the third is 40 to 60 m wide, the halo 6 m, the margin 20 m."""
    middles = 10.0 + 20.0 * np.arange(10)
    generators = np.column_stack([middles, np.full(10, 100.0), np.full(10, 5.0)])
    order = [0, 1, 3, 4, 5, 6, 7, 8, 9, 2]  # the own one last
    cell = power_cell(2, generators[:, :2], generators[:, 2], ARENA)
    places = np.column_stack([generators[order[:-1], :2], np.full(9, 5.0)])
    heard = wanted(cell, (50.0, 100.0), 5.0, 6.0, places, generators[order], ARENA)
    needed = [abs(middles[index] - 50.0) - 20.0 <= 6.0 + MARGIN for index in order[:-1]]
    assert [bool(asked) or not must for asked, must in zip(heard, needed)] == [True] * 9
    assert not heard[-1] and not heard[-2]


def test_a_far_sensor_that_reaches_here_is_heard() -> None:
    cell = rectangle(10.0, 10.0)
    generators = np.array([[30.0, 5.0, 1.0], [150.0, 5.0, 1.0], [5.0, 5.0, 1.0]])
    near, far = wanted(cell, (5.0, 5.0), 5.0, 6.0, np.array([[30.0, 5.0, 5.0], [150.0, 5.0, 120.0]]), generators, ARENA)
    assert near and far


@pytest.mark.parametrize("reach", [5.0, 25.0])
def test_without_a_cell_the_owner_of_the_place_is_heard(reach: float) -> None:
    generators = np.array([[100.0, 100.0, 30.0], [100.0, 20.0, 1.0], [100.0, 101.0, 1.0]])
    heard = wanted(EMPTY, (100.0, 101.0), reach, 6.0, np.column_stack([generators[:2, :2], [5.0, 5.0]]), generators, ARENA)
    assert heard[0]
