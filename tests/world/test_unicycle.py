"""Robots that cannot move sideways: the point ahead of the axle that follows a velocity, and its error."""

import math

import numpy as np
import pytest

from covey.examples.robots import INNER, DifferentialDrive
from protocol.settings import LimitSettings
from world.unicycle import twist

LIMITS = LimitSettings(speed=2.0, turn_rate=5.0)


def test_ahead_of_the_axle_a_point_moves_in_any_direction() -> None:
    for heading in np.linspace(-3.0, 3.0, 13):
        forward, turn = twist(heading, (0.3, -0.2), 0.5, LIMITS)
        east, north = math.cos(heading), math.sin(heading)
        moved = forward * east - 0.5 * turn * north, forward * north + 0.5 * turn * east
        assert moved == pytest.approx((0.3, -0.2), abs=1e-12)


def test_limits_shorten_the_motion_and_keep_its_direction() -> None:
    assert twist(0.0, (0.0, 2.0), 0.2, LIMITS) == pytest.approx((0.0, 5.0))
    assert twist(0.0, (4.0, 1.0), 0.5, LIMITS) == pytest.approx((2.0, 1.0))
    assert twist(1.0, (1.0, 1.0), 0.5, LimitSettings(speed=0.0, turn_rate=5.0)) == (0.0, 0.0)


def test_the_error_over_a_tick_is_as_stated() -> None:
    """A course that changes every second, within the limits: at most |velocity| dt turn_rate h / 2 off it in a tick, and never faster."""
    rng, robot = np.random.default_rng(7), DifferentialDrive("s1", {"s1": (0.0, 0.0, 0.0)})
    (x, y, _), _ = robot.read(0)
    worst, tick, slow = -math.inf, 0, []
    for _ in range(300):
        course, speed = rng.uniform(-math.pi, math.pi), rng.uniform(0.5, 2.0)
        for _ in range(4):
            robot.drive((speed * math.cos(course), speed * math.sin(course)), 0.0)
            tick += 1
            (x1, y1, _), _ = robot.read(tick)
            along = (x1 - x) * math.cos(course) + (y1 - y) * math.sin(course)
            across = (y1 - y) * math.cos(course) - (x1 - x) * math.sin(course)
            worst = max(worst, abs(across) - speed * 0.25 * 5.0 * INNER / 2.0)
            slow.append(along / (speed * 0.25))
            x, y = x1, y1
    print(f"margin {-1000 * worst:.2f} mm; share of the way {min(slow):.2f} to {max(slow):.2f}, median {np.median(slow):.3f}")
    assert worst <= 0.0
    assert min(slow) >= 0.2 * 5.0 / 2.0 - 0.05 and max(slow) <= 1.0 + 1e-9
    assert np.median(slow) >= 0.98
