"""Keeping bodies apart: the bounds of buffered Voronoi cells, by hand and in crowds."""

import math

import numpy as np
import pytest

from agents.coverage.keep_apart import CLEARANCE, bound, keep_apart, nearest
from protocol.message import Vector
from protocol.settings import LimitSettings

LIMITS = LimitSettings(speed=2.0, turn_rate=5.0, radius=0.2)
DT = 0.25  # s: a velocity may be held for twice that


def kept(velocity: Vector, *others: Vector, limits: LimitSettings = LIMITS) -> Vector:
    return keep_apart((velocity, 0.7), (0.0, 0.0), others, limits, DT)[0]


def test_a_command_away_from_all_others_is_obeyed() -> None:
    assert keep_apart(((2.0, 0.0), 0.7), (0.0, 0.0), [(-0.6, 0.0), (9.0, 0.0)], LIMITS, DT) == ((2.0, 0.0), 0.7)
    assert kept((0.3, 0.4)) == (0.3, 0.4)


def test_each_of_two_bodies_may_go_halfway_but_for_radius_and_clearance_in_two_ticks() -> None:
    vx, vy = kept((2.0, 0.0), (1.5, 0.0))
    assert vx == pytest.approx((0.75 - 0.2 - CLEARANCE) / 0.5) and vy == 0.0


def test_it_slides_along_a_wreck_instead_of_stopping() -> None:
    touching = 2.0 * (0.2 + CLEARANCE)
    assert kept((1.0, 0.5), (touching, 0.0)) == pytest.approx((0.0, 0.5))


def test_in_the_corner_of_two_bodies_it_stands() -> None:
    touching = 2.0 * (0.2 + CLEARANCE)
    assert kept((1.0, 1.0), (touching, 0.0), (0.0, touching)) == pytest.approx((0.0, 0.0))


def test_bodies_that_are_too_close_draw_apart_and_one_between_two_stands() -> None:
    vx, vy = kept((2.0, 0.0), (0.3, 0.0))
    assert vx == pytest.approx((0.15 - 0.25) / 0.5) and vy == 0.0
    assert kept((1.0, 0.0), (0.3, 0.0), (-0.3, 0.0)) == pytest.approx((0.0, 0.0))


def test_a_body_that_is_too_close_draws_apart_at_full_speed_too() -> None:
    vx, vy = kept((0.0, 2.0), (0.3, 0.0))
    assert vx == pytest.approx((0.15 - 0.25) / 0.5) and math.hypot(vx, vy) == pytest.approx(2.0) and vy > 1.9


def test_a_law_that_asks_for_more_than_the_limit_gets_no_more() -> None:
    assert kept((30.0, 40.0)) == pytest.approx((1.2, 1.6))


def test_no_velocity_within_the_bounds_is_nearer_to_the_command() -> None:
    rng = np.random.default_rng(5)
    axis = np.linspace(-2.0, 2.0, 161)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    grid = grid[np.hypot(*grid.T) <= 2.0]
    for _ in range(60):
        wanted = rng.uniform(-1.4, 1.4, 2)
        others = [tuple(rng.uniform(0.5, 2.5) * np.array([math.cos(turn), math.sin(turn)])) for turn in rng.uniform(0.0, 6.3, 5)]
        bounds = [bound((0.0, 0.0), other, 0.25, 0.5, pressed=False) for other in others]
        found = nearest((float(wanted[0]), float(wanted[1])), bounds, 2.0)
        assert found is not None
        allowed = np.all([grid @ np.array(each[:2]) <= each[2] for each in bounds], axis=0)
        best = np.hypot(*(grid[allowed] - wanted).T).min()
        assert math.dist(found, wanted) <= best + 1e-9
        assert all(each[0] * found[0] + each[1] * found[1] <= each[2] + 1e-8 for each in bounds)


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_in_a_crowd_that_wants_to_meet_no_two_bodies_touch_even_when_every_command_is_held_for_two_ticks(seed: int, late: bool) -> None:
    """Nine bodies on a 3 x 3 grid of 0.6 m all want to be in its middle; some are wrecks. The least distance is twice the radius."""
    rng = np.random.default_rng(seed)
    places = np.array([(0.6 * column, 0.6 * row) for row in range(3) for column in range(3)]) + rng.uniform(-0.04, 0.04, (9, 2))
    wrecks = rng.permutation(9)[:3].tolist()
    held = 2.0 * DT if late else DT
    for _ in range(60):
        goal = rng.uniform(0.0, 1.2, 2)
        points = [(float(x), float(y)) for x, y in places]
        velocities = [
            keep_apart((tuple(4.0 * (goal - place)), 0.0), points[row], points, LIMITS, DT)[0] for row, place in enumerate(places)
        ]
        for row in wrecks:
            velocities[row] = (0.0, 0.0)
        for share in (0.5, 1.0):
            moved = places + share * held * np.array(velocities)
            apart = np.hypot(*(moved[:, None] - moved[None]).transpose(2, 0, 1)) + 9.0 * np.eye(9)
            assert apart.min() >= 0.4, seed
        places = moved
