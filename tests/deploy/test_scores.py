"""What the scores of a run come to, by pocket calculator."""

import msgspec
import numpy as np
import pytest

from deploy.scenario import Scenario, resolve
from deploy.scoring.scores import Coverage, Score, figures, ground, hole_and_overlap, share_in_view, steady_part
from protocol.fields import pack
from protocol.observer_messages import Truth
from protocol.sensing import SENSOR_CLASSES


@pytest.fixture
def scenario() -> Scenario:
    """10 s of 0.5 s in 20 x 20 m with one full disc of 5 m: ticks 4 to 19 are steady."""
    options = {"run.dt": 0.5, "run.seconds": 10.0, "arena.width": 20.0, "arena.height": 20.0, "team.composition": "1E"}
    disc = {"angle": 360.0, "radius": 5.0}
    return resolve("quick", {**options, "sensors.E.angle": disc["angle"], "sensors.E.radius": disc["radius"]})


def score(tick: int, **figures: float) -> Score:
    """A tick with 4 targets."""
    known = {"ospa": 1.0, "gospa": 8.0, "targets": 4, "in_view": 3, "estimated": 5, "mass": 4.5, "hole": 0.0, "overlap": 0.0}
    return Score(tick=tick, time=0.5 * tick, **{**known, **figures})  # type: ignore[arg-type]


def truth(tick: int, pose: tuple[float, float, float], alive: tuple[str, ...] = ("s1",)) -> Truth:
    """The world with one body."""
    poses = pack(np.array([pose]), "<f8")
    return Truth(sender="world", incarnation=1, tick=tick, time=0.5 * tick, bodies=("s1",), poses_bytes=poses, alive=alive)


def test_means_are_over_the_steady_part(scenario: Scenario) -> None:
    scores = [score(tick, localisation=float(tick), missed=2.0, false=1.0, coverage=0.5) for tick in range(20)]
    assert [each.tick for each in steady_part(scores, scenario)] == list(range(4, 20))
    found = figures(scores, scenario)
    assert found["steady_localisation"] == 11.5  # mean of 4 .. 19
    assert (found["steady_missed"], found["steady_false"], found["steady_coverage"]) == (2.0, 1.0, 0.5)
    assert (found["steady_targets"], found["steady_estimated"], found["steady_mass"]) == (4.0, 5.0, 4.5)


def test_the_share_in_view_of_the_last_five_seconds(scenario: Scenario) -> None:
    scores = [score(tick, in_view=4 if tick >= 10 else 0) for tick in range(20)]
    assert figures(scores, scenario)["end_in_view"] == 1.0 and share_in_view(scores) == 0.5
    scores = [score(tick, in_view=2 if tick >= 11 else 0) for tick in range(20)]
    assert figures(scores, scenario)["end_in_view"] == pytest.approx(9 * 2 / 40)


def test_the_steady_part_begins_at_a_whole_tick_where_its_share_is_no_binary_number(scenario: Scenario) -> None:
    shared = msgspec.structs.replace(scenario, study=msgspec.structs.replace(scenario.study, steady_share=0.7))
    assert steady_part([score(tick) for tick in range(20)], shared)[0].tick == 6


@pytest.mark.parametrize("share", [0.0, 0.04])
def test_a_share_of_less_than_a_tick_is_the_last_tick(share: float, scenario: Scenario) -> None:
    shared = msgspec.structs.replace(scenario, study=msgspec.structs.replace(scenario.study, steady_share=share))
    assert [one.tick for one in steady_part([score(tick) for tick in range(20)], shared)] == [19]


def test_a_run_that_ended_before_its_steady_part_and_one_without_a_tick(scenario: Scenario) -> None:
    assert figures([score(0), score(1, mass=6.5)], scenario)["steady_mass"] == 5.5
    assert share_in_view([]) == 0.0


def test_coverage_is_the_area_of_the_footprints_of_the_living(scenario: Scenario) -> None:
    assert Coverage(scenario).share(truth(0, (10.0, 10.0, 0.0))) == pytest.approx(np.pi * 25.0 / 400.0, abs=0.01)
    assert Coverage(scenario).share(truth(0, (0.0, 0.0, 0.0))) == pytest.approx(np.pi * 25.0 / 1600.0, abs=0.01)
    assert Coverage(scenario).share(truth(0, (10.0, 10.0, 0.0), ())) == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_coverage_counts_the_points_that_any_sensor_may_detect(seed: int) -> None:
    scenario = resolve("quick", {"team.composition": "A3,B3,D2", "arena.width": 60.0, "arena.height": 35.0})
    rng = np.random.default_rng(seed)
    names, poses = tuple(scenario.members), rng.random((8, 3)) * [70.0, 45.0, 7.0] - [5.0, 5.0, 0.0]
    world = Truth(sender="world", incarnation=1, tick=0, time=0.0, bodies=names, poses_bytes=pack(poses, "<f8"), alive=names[1:])
    points = np.array([[1.2 * (column + 0.5), 0.7 * (row + 0.5)] for row in range(50) for column in range(50)])
    sensors = [(SENSOR_CLASSES[scenario.members[name]], pose) for name, pose in zip(names[1:], poses[1:].tolist())]
    covered = np.any([sensor.probability(points, tuple(pose)) > 0.0 for sensor, pose in sensors], axis=0)
    assert Coverage(scenario).share(world) == covered.mean() > 0.1


def test_coverage_is_read_every_ten_ticks(scenario: Scenario) -> None:
    coverage = Coverage(scenario)
    inside = coverage.share(truth(0, (10.0, 10.0, 0.0)))
    assert coverage.share(truth(9, (50.0, 50.0, 0.0))) == inside
    assert coverage.share(truth(10, (50.0, 50.0, 0.0))) == 0.0


def test_cells_of_one_view_tile_when_their_areas_add_up() -> None:
    left, right = np.array([[0, 0], [4, 0], [4, 10], [0, 10.0]]), np.array([[4, 0], [10, 0], [10, 10], [4, 10.0]])
    assert hole_and_overlap([left, right], 100.0, one_view=True) == (0.0, 0.0)
    assert hole_and_overlap([left], 100.0, one_view=True) == pytest.approx((0.6, 0.0))


def test_a_cell_whose_corners_cross_counts_as_the_hull_around_them() -> None:
    """Anybody may state thousands of corners: to find all crossings of 2000 took 7 s and 1 GB."""
    bow_tie = np.array([[0, 0], [4, 4], [4, 0], [0, 4.0]])
    assert hole_and_overlap([bow_tie], 100.0)[0] == pytest.approx(0.84)
    assert ground(bow_tie).area == 16.0
    garbage = np.random.default_rng(1).random((8192, 2)) * 10.0
    assert hole_and_overlap([garbage], 100.0)[0] == pytest.approx(0.0, abs=0.01)
