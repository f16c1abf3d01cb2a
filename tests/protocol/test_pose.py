"""Commands move poses within the limits, and points turn with the frame in which they were seen."""

import math

import numpy as np
import pytest

from protocol.pose import clip_velocity, from_other_frame, integrate
from protocol.settings import LimitSettings

LIMITS = LimitSettings(speed=2.0, turn_rate=5.0)


def test_a_slow_command_is_carried_out_as_said() -> None:
    assert integrate((1.0, 2.0, 0.5), (1.0, -0.5), 0.25, 2.0, LIMITS) == (3.0, 1.0, 1.0)


def test_a_velocity_beyond_the_limit_keeps_its_direction() -> None:
    x, y = clip_velocity((30.0, 40.0), 2.0)
    assert (x, y) == (pytest.approx(1.2), pytest.approx(1.6))


def test_a_velocity_at_the_limit_is_not_touched() -> None:
    assert clip_velocity((0.0, 2.0), 2.0) == (0.0, 2.0)


def test_the_turn_rate_is_clipped_both_ways() -> None:
    assert integrate((0.0, 0.0, 0.0), (0.0, 0.0), 100.0, 0.1, LIMITS)[2] == pytest.approx(0.5)
    assert integrate((0.0, 0.0, 0.0), (0.0, 0.0), -100.0, 0.1, LIMITS)[2] == pytest.approx(-0.5)


def test_the_heading_stays_within_half_a_turn() -> None:
    heading = integrate((0.0, 0.0, 3.0), (0.0, 0.0), 1.0, 1.0, LIMITS)[2]
    assert heading == pytest.approx(4.0 - 2.0 * math.pi)


def test_a_limit_of_zero_holds_a_body_fast() -> None:
    assert integrate((1.0, 2.0, 0.5), (9.0, 9.0), 9.0, 1.0, LimitSettings(speed=0.0, turn_rate=0.0)) == (1.0, 2.0, 0.5)


def test_a_point_keeps_its_distance_and_bearing_when_the_pose_is_corrected() -> None:
    true, reported = (1.0, 2.0, 0.5), (4.0, -1.0, 0.5 + math.pi / 2.0)
    seen = np.array([[1.0 + 3.0, 2.0], [1.0, 2.0 + 2.0]], np.float32)  # 3 m east, 2 m north: a quarter turn later north and west
    np.testing.assert_allclose(from_other_frame(seen, true, reported), [[4.0, 2.0], [2.0, -1.0]], atol=1e-6)
    assert from_other_frame(np.empty((0, 2), np.float32), true, reported).shape == (0, 2)
