"""Range and bearing, bearing alone, and poses that are not exact: densities, births, and bits that do not depend on the backend."""

import math
from typing import Any

import numpy as np
import pytest

from agents.backend import PLAIN
from agents.config import FilterSettings
from agents.tracking.births import Scan
from agents.tracking.measurement_likelihood import (
    BEARING,
    EXACT_POSE,
    POSITION,
    RANGE_BEARING,
    Noise,
    birth_places,
    distances_and_peaks,
    kernel_variance,
    noise_of,
    sigma_poses,
)
from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol.measuring import MeasurementModel, to_measurements, to_places
from protocol.sensing import WedgeSensor

POSE = (3.0, 4.0, 0.7)
RADIUS = 10.0
CAMERA: dict[str, Any] = {"angle": 120.0, "radius": RADIUS, "prob_detection": 0.9}


def team(kind: str, **others: Any) -> dict[str, Any]:
    """Two sensors of that kind beside two of positions, and 5 targets in 25 x 25 m."""
    noise = {"bearing_noise": 2.0, **({"range_noise": 0.3} if kind == "range-bearing" else {})}
    arena = {"arena.width": 25.0, "arena.height": 25.0, "targets.count": 5, "run.seconds": 5.0}
    return {"team.composition": "P2,A2", "sensors.P": {**CAMERA, "measures": kind, **noise}, **arena, **others}


def rays_of(points: np.ndarray) -> np.ndarray:
    """The rays from the pose to some points."""
    offset = points - np.array(POSE[:2])
    far = np.hypot(offset[:, 0], offset[:, 1])
    return np.column_stack([offset / far[:, None], far, np.zeros(len(points))])


@pytest.mark.parametrize("kind", ["range-bearing", "bearing"])
@pytest.mark.parametrize(
    "others",
    [
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"pose.position_noise": 0.1, "pose.heading_noise": 0.03}, marks=pytest.mark.slow),
        {"pose.time_noise": 0.1, "pose.memory": 1.0, "bodies.time_error": 0.1},
        {"sensors.P.prob_detection_far": 0.2},
    ],
)
def test_a_mixed_team_walks_the_same_trajectory_with_both_backends(kind: str, others: dict[str, float]) -> None:
    options = team(kind) | others
    assert (
        Simulation(resolve("efficacy", options)).run().transcript
        == Simulation(resolve("efficacy", options), backend=PLAIN).run().transcript
    )


@pytest.mark.parametrize("noise", [{"pose.position_noise": 0.2}, {"pose.time_noise": 0.1}])
def test_a_team_of_positions_whose_poses_are_not_exact_walks_the_same_trajectory_with_both_backends(noise: dict[str, float]) -> None:
    options = {"team.composition": "A3", "run.seconds": 4.0, "arena.width": 25.0, "arena.height": 25.0, **noise}
    assert (
        Simulation(resolve("efficacy", options)).run().transcript
        == Simulation(resolve("efficacy", options), backend=PLAIN).run().transcript
    )


@pytest.mark.parametrize("place", [(9.0, 4.0), (3.0, 12.0), (5.0, 5.0)])
def test_the_density_of_ranges_and_bearings_has_the_integral_one_over_the_plane(place: tuple[float, float]) -> None:
    """The mean range is that of the target, so dividing by the range of the detection is right to second order: within 1 %."""
    noise, step = noise_of((RANGE_BEARING, 0.3, 0.03), 0.25, 0.0, EXACT_POSE), 0.02
    ticks = np.arange(-3.0, 3.0, step)
    points = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2) + np.array(place)
    squared, peaks = distances_and_peaks(np.array([[*place, 0.0, 0.0]]), POSE, points, rays_of(points), RADIUS, noise)
    assert float((np.exp(-0.5 * squared) * peaks).sum() * step * step) == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize(("degrees", "integral"), [(3.0, 1.0), (20.0, 0.97), (45.0, 0.89)])
def test_the_density_of_a_bearing_has_the_integral_one_over_the_circle_in_units_of_half_the_squared_radius(
    degrees: float, integral: float
) -> None:
    """Less where the noise is large: an error e counts as 2 tan(e / 2). The page on sensors says how much."""
    noise, step = noise_of((BEARING, 0.0, math.radians(degrees)), 0.25, 0.0, EXACT_POSE), 1e-3
    angles = np.arange(-math.pi, math.pi, step)
    points = np.array(POSE[:2]) + 7.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    squared, peaks = distances_and_peaks(np.array([[9.0, 5.0, 0.0, 0.0]]), POSE, points, rays_of(points), RADIUS, noise)
    assert float((np.exp(-0.5 * squared) * peaks).sum() * step * RADIUS**2 / 2.0) == pytest.approx(integral, rel=0.01)


def test_the_variances_of_sensor_kernel_and_own_pose_add_up() -> None:
    pose = 0.3, 0.02
    assert noise_of((POSITION, 0.0, 0.0), 0.5, 0.01, pose)[1:] == pytest.approx((0.25 + 0.01 + 0.09, 0.25 + 0.01 + 0.09, 0.0004))
    assert noise_of((RANGE_BEARING, 0.2, 0.1), 9.0, 0.01, pose)[1:] == pytest.approx((0.04 + 0.01 + 0.09, 0.01 + 0.09, 0.01 + 0.0004))


def test_a_pose_of_unknown_heading_widens_a_position_across_the_ray_and_not_along_it() -> None:
    noise = noise_of((POSITION, 0.0, 0.0), 0.1, 0.0, (0.0, 0.05))
    point = np.array([[POSE[0] + 8.0, POSE[1]]])
    ahead, aside = np.array([[POSE[0] + 8.5, POSE[1], 0.0, 0.0]]), np.array([[POSE[0] + 8.0, POSE[1] + 0.5, 0.0, 0.0]])
    along, across = (distances_and_peaks(place, POSE, point, rays_of(point), RADIUS, noise)[0][0, 0] for place in (ahead, aside))
    assert along == pytest.approx(25.0)
    assert across == pytest.approx(0.25 / (0.01 + 0.0025 * 64.0))


def test_the_sigma_poses_have_the_mean_and_the_variances_of_the_pose() -> None:
    poses = np.array(sigma_poses(POSE, (0.3, 0.05)))
    assert poses.mean(axis=0) == pytest.approx(POSE)
    assert np.cov(poses.T, bias=True) == pytest.approx(np.diag([0.09, 0.09, 0.0025]))
    assert sigma_poses(POSE, EXACT_POSE) == [POSE]


def test_what_a_sensor_sees_from_an_unsure_pose_is_the_mean_over_its_poses() -> None:
    """Against draws of the pose. Just inside of an edge one pose in six sees nothing, and the truth is a half: a third off at most.

    The error is less than half of that of a sharp footprint.
    """
    wedge, noise, rng = WedgeSensor(2.0, 8.0, 0.9), (0.3, 0.05), np.random.default_rng(3)
    scan = Scan(0, wedge, POSE, np.empty((0, 2)), np.empty(0, dtype=np.uint64), 0.0, np.empty((0, 4)), noise)
    points = np.array(POSE[:2]) + rng.uniform(-10.0, 10.0, (3000, 2))
    drawn = np.array(POSE) + rng.normal(size=(2000, 3)) * (0.3, 0.3, 0.05)
    mean = np.mean([wedge.probability(points, tuple(pose)) for pose in drawn.tolist()], axis=0)
    found = scan.probability(points)
    assert np.abs(found - mean).max() < 0.9 / 3.0
    assert found.mean() == pytest.approx(mean.mean(), rel=0.01)
    assert np.abs(found - mean).mean() < 0.5 * np.abs(wedge.probability(points, POSE) - mean).mean()


@pytest.mark.parametrize("error", [0.0, 0.1, -0.3])
def test_a_difference_of_bearings_counts_as_an_angle_also_across_the_west(error: float) -> None:
    noise = Noise(BEARING, 0.0, 0.0, 1.0)
    point = np.array([[POSE[0] - 5.0 * math.cos(error), POSE[1] - 5.0 * math.sin(error)]])
    squared, _ = distances_and_peaks(np.array([[POSE[0] - 8.0, POSE[1], 0.0, 0.0]]), POSE, point, rays_of(point), RADIUS, noise)
    assert squared[0, 0] == pytest.approx(error**2, rel=0.02)


@pytest.mark.parametrize("model", [RANGE_BEARING, BEARING])
def test_births_scatter_as_the_sensor_does(model: float) -> None:
    noise = noise_of((model, 0.3, 0.04), 0.1, 0.0, EXACT_POSE)
    place = np.array([[POSE[0] + 6.0, POSE[1]]])
    ids = np.arange(1, 4001, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    found = birth_places(ids, POSE, np.repeat(place, 4000, axis=0), np.repeat(rays_of(place), 4000, axis=0), RADIUS, noise)
    offset = found - np.array(POSE[:2])
    far, angle = np.hypot(offset[:, 0], offset[:, 1]), np.arctan2(offset[:, 1], offset[:, 0])
    assert np.std(angle) == pytest.approx(0.04, rel=0.05)
    mean, deviation = (6.0, 0.3) if model == RANGE_BEARING else (RADIUS * 2.0 / 3.0, RADIUS / math.sqrt(18.0))
    assert (np.mean(far), np.std(far)) == pytest.approx((mean, deviation), rel=0.05)


@pytest.mark.parametrize("far", [4.0, 10.0])
def test_births_of_a_sensor_of_positions_scatter_with_its_heading(far: float) -> None:
    noise = noise_of((POSITION, 0.0, 0.0), 0.1, 0.0, (0.0, 0.04))
    place = np.array([[POSE[0] + far, POSE[1]]])
    ids = np.arange(1, 4001, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    found = birth_places(ids, POSE, np.repeat(place, 4000, axis=0), np.repeat(rays_of(place), 4000, axis=0), RADIUS, noise) - place
    assert np.std(found, axis=0) == pytest.approx((0.1, math.hypot(0.1, 0.04 * far)), rel=0.05)


def test_places_undo_measurements() -> None:
    camera, points = MeasurementModel("range-bearing", 0.01, 0.1), np.array([[9.0, 9.0], [-4.0, 1.0], [3.0, -8.0]])
    assert to_places(camera, RADIUS, POSE, to_measurements(camera, POSE, points)) == pytest.approx(points)
    ahead = to_places(MeasurementModel("bearing", 0.01), RADIUS, POSE, np.array([[0.0, 0.0]]))
    assert ahead[0] == pytest.approx([POSE[0] + RADIUS * math.sqrt(0.5) * math.cos(0.7), POSE[1] + RADIUS * math.sqrt(0.5) * math.sin(0.7)])


def test_the_kernel_is_that_of_positions() -> None:
    settings = FilterSettings(position_noise=0.5, roughening=1.0, particles_per_target=64)
    assert kernel_variance(settings) == pytest.approx((0.5 * 64 ** (-1 / 6)) ** 2)


def test_a_team_of_ranges_and_bearings_tracks_as_one_of_positions_of_like_noise_does() -> None:
    arena = {"arena.width": 20.0, "arena.height": 20.0, "targets.count": 3, "targets.border": "reflect", "filter.border": "reflect"}
    wide = {"angle": 360.0, "radius": 15.0, "prob_detection": 0.95}
    run = {"run.seconds": 20.0, "team.composition": "P3", **arena}
    polar = resolve("efficacy", {**run, "sensors.P": {**wide, "measures": "range-bearing", "range_noise": 0.25, "bearing_noise": 2.0}})
    plain = resolve("efficacy", {**run, "sensors.P": wide})
    found, known = (Simulation(scenario).run().steady_ospa for scenario in (polar, plain))
    assert found < 1.5 * known + 0.1


PLACE_AND_HEADING = {"bodies.position_error": 0.3, "bodies.heading_error": 0.0524}
BELIEVED = {"pose.position_noise": 0.3, "pose.heading_noise": 0.0524}


def error(seeds: tuple[int, ...], options: dict[str, Any]) -> float:
    """The steady OSPA of four sensors over four targets in 25 x 25 m, m, mean of some seeds."""
    fixed = {"team.composition": "A4", "arena.width": 25.0, "arena.height": 25.0, "targets.count": 4, "targets.border": "reflect"}
    run = {"run.seconds": 30.0, "filter.border": "reflect", **fixed, **options}
    return float(np.mean([Simulation(resolve("efficacy", {**run, "run.seed": seed})).run().steady_ospa for seed in seeds]))


@pytest.mark.parametrize("kind", ["particles", pytest.param("gaussian-mixture", marks=pytest.mark.nightly)])
@pytest.mark.slow
def test_a_filter_that_knows_of_its_pose_errors_beats_one_that_does_not(kind: str) -> None:
    """Sigma 0.3 m and 3 degrees; the mean of two seeds."""
    wrong = PLACE_AND_HEADING | {"filter.kind": kind}
    assert error((1, 2), wrong | BELIEVED) < 0.7 * error((1, 2), wrong)


@pytest.mark.slow
@pytest.mark.nightly
def test_a_filter_that_knows_of_its_errors_in_time_beats_one_that_does_not() -> None:
    """Sigma 0.2 s; the mean of four seeds."""
    wrong = {"bodies.time_error": 0.2}
    assert error((1, 2, 3, 4), wrong | {"pose.time_noise": 0.2}) < 0.9 * error((1, 2, 3, 4), wrong)


@pytest.mark.slow
@pytest.mark.nightly
def test_poses_averaged_over_two_seconds_take_most_of_the_loss_away() -> None:
    """Sigma 0.3 m, 3 degrees and 0.1 s; the mean of four seeds."""
    wrong = PLACE_AND_HEADING | BELIEVED | {"bodies.time_error": 0.1, "pose.time_noise": 0.1}
    exact, known, averaged = (error((1, 2, 3, 4), options) for options in ({}, wrong, wrong | {"pose.memory": 2.0}))
    assert averaged - exact < 0.5 * (known - exact)
