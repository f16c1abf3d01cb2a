"""An agent states how exactly it knows its pose, and averages reports along its own motion."""

import math

import numpy as np
import pytest

from agents.config import AgentConfig, PoseSettings
from agents.own_pose import SURPRISE, AveragingWeight, OwnPose
from protocol.fields import pack
from protocol.geometry import wrap_angle
from protocol.measuring import MeasurementModel
from protocol.messages import Observation
from protocol.sensing import Pose, WedgeSensor
from protocol.settings import LimitSettings, RunSettings

DT = 0.25
WEDGE = WedgeSensor(2.0, 8.0, 0.9)


def own_pose(sensor: WedgeSensor = WEDGE, **settings: float) -> OwnPose:
    """That of an agent with these settings of [pose]."""
    limits = LimitSettings(speed=2.0, turn_rate=5.0)
    return OwnPose(AgentConfig(pose=PoseSettings(**settings), run=RunSettings(dt=DT), limits=limits), sensor)


def report(pose: Pose, tick: int, points: list[tuple[float, float]] | None = None) -> Observation:
    """An observation from a reported pose, with detections and obstacles at the same points."""
    rows = np.array(points or []).reshape(-1, 2)
    both = {"detections_bytes": pack(rows, "<f4"), "obstacles_bytes": pack(rows, "<f8")}
    return Observation(sender="world", incarnation=1, recipient="s1", tick=tick, time=tick * DT, pose=pose, **both)


def test_an_agent_of_exact_poses_states_no_noise_and_takes_every_report_as_it_is() -> None:
    pose = own_pose(memory=2.0)
    seen = report((1.0, 2.0, 0.5), 0, [(3.0, 3.0)])
    assert pose.correct(seen) is seen
    assert pose.noise is None


def test_without_memory_a_report_is_taken_as_it_is_and_its_noise_is_that_of_the_settings() -> None:
    pose = own_pose(position_noise=0.3, heading_noise=0.05)
    for tick in range(3):
        seen = report((1.0, 2.0, 0.5), tick)
        assert pose.correct(seen) is seen
        assert pose.noise == (0.3, 0.05)
        pose.note_command(((2.0, 0.0), 1.0), 0)


@pytest.mark.parametrize(("command", "limited"), [(((1.2, -1.6), -3.0), ((1.2, -1.6), -3.0)), (((30.0, 40.0), 9.0), ((1.2, 1.6), 5.0))])
def test_an_error_in_time_widens_the_noise_by_the_motion_within_the_limits(command: tuple, limited: tuple) -> None:
    """Against draws: a pose true t s ago errs by velocity and turn rate times t; place and heading independent of each other."""
    rng, (velocity, turn_rate) = np.random.default_rng(4), limited
    late = rng.normal(0.0, 0.1, 100_000)
    places = rng.normal(0.0, 0.2, (100_000, 2)) + late[:, None] * np.array(velocity)
    headings = rng.normal(0.0, 0.04, 100_000) + late * turn_rate
    pose = own_pose(position_noise=0.2, heading_noise=0.04, time_noise=0.1)
    pose.note_command(command, 0)
    pose.correct(report((1.0, 2.0, 0.5), 0))
    assert pose.noise is not None
    assert pose.noise == pytest.approx((math.sqrt(np.var(places, axis=0).mean()), np.std(headings)), rel=0.01)


def test_a_body_that_stands_has_no_error_in_time() -> None:
    pose = own_pose(time_noise=0.1)
    pose.correct(report((1.0, 2.0, 0.5), 0))
    assert pose.noise == (0.0, 0.0)


def test_the_mean_of_reports_is_as_exact_as_it_says() -> None:
    """A body that drives and turns for 30 ticks, 400 times over: independent errors of 0.3 m and 0.05 rad, averaged over 1 s."""
    rng, found = np.random.default_rng(5), []
    for _ in range(400):
        pose, true = own_pose(position_noise=0.3, heading_noise=0.05, memory=1.0), (5.0, 5.0, 3.0)
        for tick in range(30):
            east, north, turn = rng.normal(0.0, (0.3, 0.3, 0.05)).tolist()
            stated = pose.correct(report((true[0] + east, true[1] + north, wrap_angle(true[2] + turn)), tick)).pose
            if tick >= 10:
                found.append((stated[0] - true[0], stated[1] - true[1], wrap_angle(stated[2] - true[2])))
            velocity, turn_rate = (2.0 * math.cos(0.3 * tick), 2.0 * math.sin(0.3 * tick)), 1.5 * math.sin(tick)
            pose.note_command((velocity, turn_rate), 0)
            true = (true[0] + velocity[0] * DT, true[1] + velocity[1] * DT, wrap_angle(true[2] + turn_rate * DT))
    share = 1.0 - math.exp(-DT)
    expected = math.sqrt(share / (2.0 - share))  # of the deviation of one report: closed form of an exponential average
    assert np.std(found, axis=0) == pytest.approx((0.3 * expected, 0.3 * expected, 0.05 * expected), rel=0.06)
    assert pose.noise == pytest.approx((0.3 * expected, 0.05 * expected), rel=0.01)


def test_reports_weigh_by_their_variances_and_fade() -> None:
    average = AveragingWeight()
    assert average.add(0.04, 0.5) == 1.0
    assert average.add(0.01, 0.5) == pytest.approx(100.0 / (100.0 + 12.5))
    assert average.variance == pytest.approx((12.5**2 * 0.04 + 100.0**2 * 0.01) / 112.5**2)
    assert average.add(0.01, 0.0) == 1.0
    assert average.variance == 0.01


def test_an_exact_report_counts_nearly_alone_and_later_ones_count_again() -> None:
    average = AveragingWeight()
    average.add(0.04, 1.0)
    assert average.add(0.0, 1.0) == pytest.approx(1.0, abs=1e-6)
    for _ in range(100):
        share = average.add(0.04, 0.5)
    assert share == pytest.approx(0.5)


@pytest.mark.parametrize("carried", [(SURPRISE + 0.5) * 0.5, 30.0])
def test_a_body_that_is_carried_away_is_believed_at_once(carried: float) -> None:
    pose = own_pose(position_noise=0.3, heading_noise=0.05, memory=5.0)
    for tick in range(20):
        pose.correct(report((5.0, 5.0, 1.0), tick))
    assert pose.correct(report((5.0 + carried, 5.0, 1.0), 20)).pose == (5.0 + carried, 5.0, 1.0)
    assert pose.noise == (0.3, 0.05)


def test_a_body_that_does_not_turn_as_it_should_is_believed_soon() -> None:
    pose = own_pose(position_noise=0.3, heading_noise=0.05, memory=5.0)
    worst = 0.0
    for tick in range(40):
        worst = max(worst, abs(pose.correct(report((5.0, 5.0, 1.0), tick)).pose[2] - 1.0))
        pose.note_command(((0.0, 0.0), 0.4), 0)
    assert worst < SURPRISE * 0.1


def test_detections_and_obstacles_move_with_the_pose_and_ranges_and_bearings_do_not() -> None:
    camera = WedgeSensor(2.0, 8.0, 0.9, MeasurementModel("range-bearing", 0.01, 0.1))
    for sensor, moves in ((WEDGE, True), (camera, False)):
        pose = own_pose(sensor, position_noise=0.3, heading_noise=0.05, memory=60.0)
        pose.correct(report((0.0, 0.0, 0.0), 0))
        seen = pose.correct(report((0.2, -0.1, 0.08), 1, [(5.2, -0.1)]))
        assert seen.pose == pytest.approx((0.1, -0.05, 0.04), abs=1e-3)
        turned = (seen.pose[0] + 5.0 * math.cos(seen.pose[2] - 0.08), seen.pose[1] + 5.0 * math.sin(seen.pose[2] - 0.08))
        assert seen.detections[0] == pytest.approx(turned if moves else (5.2, -0.1), abs=1e-6)
        assert seen.obstacles[0] == pytest.approx(turned)


def test_skipped_ticks_count_as_time_in_which_the_last_command_held() -> None:
    pose = own_pose(position_noise=0.3, memory=10.0)
    for tick in (0, 1, 2, 3):
        pose.correct(report((5.0, 5.0, 0.0), tick))
    pose.note_command(((2.0, 0.0), 0.0), 0)
    assert pose.correct(report((6.5, 5.0, 0.0), 6)).pose == pytest.approx((6.5, 5.0, 0.0))
