"""Bodies obey commands within the limits, and start where the seed or the scenario says."""

import math

import numpy as np
import pytest

from protocol.fields import LARGEST_NUMBER
from protocol.geometry import wrap_angle
from protocol.messages import Command
from protocol.sensing import Pose
from protocol.settings import ArenaSettings, BadSetting, LimitSettings
from world import bodies as module
from world.bodies import Bodies, check_given, free_pose, pose_warnings, pose_with_error, start_pose
from world.config import BodySettings, RecordedSettings, WorldConfig, WorldRun

LIMITS = LimitSettings(speed=2.0, turn_rate=5.0)


def command(name: str, velocity: tuple[float, float], turn_rate: float = 0.0) -> Command:
    return Command(sender=name, incarnation=1, tick=0, velocity=velocity, turn_rate=turn_rate)


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
    assert bodies.poses["s1"] == (-LARGEST_NUMBER, LARGEST_NUMBER, 0.0)


def errors(settings: BodySettings, name: str, before: Pose = (0.0, 0.0, 0.0), pose: Pose = (0.0, 0.0, 0.0)) -> np.ndarray:
    """The errors (4000, 3) of the poses that an agent is told in as many ticks of 0.5 s; all are near one pose."""
    config = WorldConfig(bodies=settings, run=WorldRun(dt=0.5, seed=1))
    found = np.array([pose_with_error(pose, before, config, name, tick) for tick in range(4000)]) - np.array(pose)
    return np.column_stack([found[:, :2], [wrap_angle(turn) for turn in found[:, 2].tolist()]])


def test_the_pose_errors_of_two_agents_in_a_tick_have_nothing_to_do_with_each_other() -> None:
    one, other = (errors(BodySettings(position_error=1.0, heading_error=0.1), name) for name in ("s1", "s2"))
    assert all(abs(np.corrcoef(one[:, part], other[:, part])[0, 1]) < 0.1 for part in range(3))
    assert np.std(one, axis=0) == pytest.approx((1.0, 1.0, 0.1), rel=0.1)


def test_an_error_in_time_moves_a_pose_along_its_motion_and_turns_it_with_that() -> None:
    """2 m/s at an angle, -0.6 rad/s across the west, known to 0.1 s: 0.2 m and 0.06 rad, and all of one sign."""
    before, pose = (3.0, 4.0, -3.0), (3.6, 4.8, wrap_angle(-3.3))
    found = errors(BodySettings(time_error=0.1), "s1", before, pose)
    assert np.std(found, axis=0) == pytest.approx((0.12, 0.16, 0.06), rel=0.05)
    assert np.abs(found.mean(axis=0)).max() < 0.01
    np.testing.assert_allclose(found, np.outer(found[:, 0] / 1.2, (1.2, 1.6, -0.6)), atol=1e-9)
    assert np.corrcoef(found[:-1, 0], found[1:, 0])[0, 1] == pytest.approx(0.0, abs=0.05)


def test_an_error_in_time_is_nothing_to_a_body_that_stands() -> None:
    assert not errors(BodySettings(time_error=0.1), "s1", (3.0, 4.0, 1.0), (3.0, 4.0, 1.0)).any()


def test_errors_in_place_and_heading_are_the_same_with_an_error_in_time_beside_them() -> None:
    alone, both = (errors(BodySettings(position_error=0.3, heading_error=0.1, time_error=late), "s1") for late in (0.0, 0.1))
    assert (alone == both).all()


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


def test_given_poses_that_are_not_read_or_lie_outside_of_the_arena_are_told() -> None:
    arena, poses = ArenaSettings(width=40.0, height=20.0), {"s1": (0.0, 20.0, 0.0), "s2": (-500.0, 2.0, 3.0), "zz": (1.0, 2.0, 3.0)}
    given = WorldConfig(members={"s1": "A", "s2": "B"}, arena=arena, bodies=BodySettings(start="given", poses=poses))
    assert pose_warnings(given) == [
        "bodies.poses.s2: lies outside of the arena of 40 x 20 m",
        "bodies.poses.zz: there is no such agent",
    ]
    assert pose_warnings(WorldConfig(members={"s1": "A"}, bodies=BodySettings(poses=poses))) == [
        "bodies.poses is not read: bodies.start should be 'given'"
    ]
    assert pose_warnings(WorldConfig(members={"s1": "A"})) == []


def test_given_poses_are_taken_and_guests_start_anywhere() -> None:
    given = BodySettings(start="given", poses={"s1": (1.0, 2.0, 4.0)})
    assert start_pose("s1", given, ArenaSettings(), 1) == (1.0, 2.0, pytest.approx(4.0 - 2.0 * math.pi))
    assert start_pose("guest", given, ArenaSettings(), 1) == start_pose("guest", BodySettings(), ArenaSettings(), 1)


def test_a_member_without_a_given_pose_is_named() -> None:
    config = WorldConfig(members={"s1": "A", "s2": "B"}, bodies=BodySettings(start="given", poses={"s1": (1.0, 2.0, 0.0)}))
    with pytest.raises(BadSetting, match=r"bodies\.poses\.s2: is missing"):
        check_given(config)


@pytest.mark.parametrize("y", [math.nan, math.inf, 1.1e6])
def test_a_given_pose_must_fit_into_a_message(y: float) -> None:
    config = WorldConfig(members={"s1": "A"}, bodies=BodySettings(start="given", poses={"s1": (1.0, y, 0.0)}))
    with pytest.raises(BadSetting, match=r"bodies\.poses\.s1 = \[1\.0, .*, 0\.0\]: should be .*, each of at most 1e\+06$"):
        check_given(config)


@pytest.mark.parametrize("field", ["position_error", "heading_error", "time_error"])
def test_errors_of_poses_are_refused_for_bodies_of_their_own(field: str) -> None:
    settings = WorldConfig(bodies=BodySettings(host="own", **{field: 0.1}))
    with pytest.raises(BadSetting, match=rf"bodies\.{field} = 0\.1: should be 0 with bodies of their own"):
        check_given(settings)


def test_recorded_robots_have_no_bodies_of_their_own() -> None:
    recorded = RecordedSettings(kind="mrclam", data="somewhere")
    check_given(WorldConfig(recorded=recorded))
    with pytest.raises(BadSetting, match=r"bodies\.host = 'own': should be 'world' with recorded\.kind = 'mrclam'"):
        check_given(WorldConfig(recorded=recorded, bodies=BodySettings(host="own")))


def test_the_last_pose_that_is_drawn_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    config = WorldConfig(limits=LimitSettings(radius=1.0))
    first = free_pose("s1", config, [])
    second = free_pose("s1", config, [first])
    monkeypatch.setattr(module, "ATTEMPTS", 2)
    assert free_pose("s1", config, [first]) == second != first
    with pytest.raises(BadSetting, match="no room for 3 bodies"):
        free_pose("s1", config, [first, second])
