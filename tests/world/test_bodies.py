"""Bodies obey commands within the limits, and start where the seed or the scenario says."""

import math

import numpy as np
import pytest

from protocol.fields import FARTHEST
from protocol.messages import Command
from protocol.settings import ArenaSettings, BadSetting, LimitSettings
from world.bodies import Bodies, check_given, clip_velocity, integrate, pose_with_error, start_pose
from world.config import BodySettings, WorldConfig

LIMITS = LimitSettings(speed=2.0, turn_rate=5.0)


def command(name: str, velocity: tuple[float, float], turn_rate: float = 0.0) -> Command:
    return Command(sender=name, incarnation=1, tick=0, velocity=velocity, turn_rate=turn_rate)


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


def test_a_body_without_a_command_stands_still() -> None:
    bodies = Bodies(0.5, LIMITS)
    bodies.place("s1", (0.0, 0.0, 0.0))
    bodies.place("s2", (5.0, 5.0, 1.0))
    bodies.move({"s1": command("s1", (1.0, 0.0))})
    assert bodies.poses == {"s1": (0.5, 0.0, 0.0), "s2": (5.0, 5.0, 1.0)}


def test_a_body_may_leave_the_arena_but_not_the_range_of_the_wire() -> None:
    bodies = Bodies(1.0, LimitSettings(speed=1.0e9))
    bodies.place("s1", (-3.0, 0.0, 0.0))
    bodies.move({"s1": command("s1", (-1.0, 0.0))})
    assert bodies.poses["s1"] == (-4.0, 0.0, 0.0)
    bodies.move({"s1": command("s1", (-1.0e6, 1.0e6))})
    bodies.move({"s1": command("s1", (0.0, 1.0e6))})
    assert bodies.poses["s1"] == (-FARTHEST, FARTHEST, 0.0)


def test_the_pose_errors_of_two_agents_in_a_tick_have_nothing_to_do_with_each_other() -> None:
    settings = BodySettings(position_error=1.0, heading_error=0.1)
    one, other = (np.array([pose_with_error((0.0, 0.0, 0.0), settings, name, tick, 1) for tick in range(1000)]) for name in ("s1", "s2"))
    assert all(abs(np.corrcoef(one[:, part], other[:, part])[0, 1]) < 0.1 for part in range(3))
    assert np.std(one, axis=0) == pytest.approx((1.0, 1.0, 0.1), rel=0.1)


def test_starts_are_uniform_in_the_arena_and_in_heading() -> None:
    arena = ArenaSettings(width=40.0, height=20.0)
    poses = np.array([start_pose(f"s{number}", BodySettings(), arena, seed=1) for number in range(2000)])
    assert (poses[:, :2] >= 0.0).all() and (poses[:, :2] <= [40.0, 20.0]).all()
    np.testing.assert_allclose(poses.mean(axis=0), [20.0, 10.0, 0.0], atol=0.8)
    np.testing.assert_allclose(poses.std(axis=0), np.array([40.0, 20.0, 2.0 * math.pi]) / math.sqrt(12.0), rtol=0.05)


def test_a_start_depends_on_seed_and_name_alone() -> None:
    arena = ArenaSettings()
    assert start_pose("s1", BodySettings(), arena, 1) == start_pose("s1", BodySettings(), arena, 1)
    assert start_pose("s1", BodySettings(), arena, 1) != start_pose("s2", BodySettings(), arena, 1)
    assert start_pose("s1", BodySettings(), arena, 1) != start_pose("s1", BodySettings(), arena, 2)


def test_given_poses_are_taken_and_guests_start_anywhere() -> None:
    given = BodySettings(start="given", poses={"s1": (1.0, 2.0, 4.0)})
    assert start_pose("s1", given, ArenaSettings(), 1) == (1.0, 2.0, pytest.approx(4.0 - 2.0 * math.pi))
    assert start_pose("guest", given, ArenaSettings(), 1) == start_pose("guest", BodySettings(), ArenaSettings(), 1)


def test_a_member_without_a_given_pose_is_named() -> None:
    config = WorldConfig(members={"s1": "A", "s2": "B"}, bodies=BodySettings(start="given", poses={"s1": (1.0, 2.0, 0.0)}))
    with pytest.raises(BadSetting, match=r"bodies\.poses\.s2: is missing"):
        check_given(config)


def test_a_given_pose_must_be_finite() -> None:
    config = WorldConfig(members={"s1": "A"}, bodies=BodySettings(start="given", poses={"s1": (1.0, math.nan, 0.0)}))
    with pytest.raises(BadSetting, match=r"bodies\.poses\.s1 = \[1\.0, nan, 0\.0\]"):
        check_given(config)


def test_errors_of_poses_are_refused_for_bodies_of_their_own() -> None:
    settings = WorldConfig(bodies=BodySettings(host="own", heading_error=0.1))
    with pytest.raises(BadSetting, match=r"bodies\.heading_error = 0\.1: should be 0 with bodies of their own"):
        check_given(settings)
