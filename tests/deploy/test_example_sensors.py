"""The example sensors against closed forms and their own data, and the scenario that uses them from end to end."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.coverage.capacity import sensor_facts
from covey.examples.sensors import DATA, RangeFalling, SampledGrid
from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol.geometry import polygon_area
from protocol.sensing import Pose, SensorModel
from protocol.settings import BadSetting

HERE: Pose = (0.0, 0.0, 0.0)


@pytest.fixture
def grid(tmp_path: Path) -> SampledGrid:
    """Four cells of 2 m: ahead on the left .8, ahead on the right .4, behind on the left nothing, behind on the right .2."""
    (tmp_path / "grid.csv").write_text("0.8,0.4\n0,0.2\n")
    return SampledGrid(str(tmp_path / "grid.csv"), 2.0)


def test_capability_of_a_probability_that_falls_with_the_range() -> None:
    """D = angle x peak x scale^2 / 2 x (1 - exp(-(R / scale)^2)); the COD lies on the axis."""
    facts = sensor_facts(RangeFalling(120.0, 14.0, 9.0, 0.98))
    assert facts.capability == pytest.approx(math.radians(120.0) * 0.98 * 81.0 / 2.0 * (1.0 - math.exp(-196.0 / 81.0)), rel=2e-3)
    assert facts.cod_offset[1] == pytest.approx(0.0, abs=1e-9) and 3.0 < facts.cod_offset[0] < 9.0


def test_the_probability_falls_and_ends_at_the_edge() -> None:
    sensor = RangeFalling(120.0, 14.0, 9.0, 0.98)
    points = np.array([[0.0, 0.0], [9.0, 0.0], [13.9, 0.0], [14.1, 0.0], [-1.0, 0.0], [3.0, 5.0], [2.0, 5.0]])
    found = sensor.probability(points, HERE)
    assert found[:3] == pytest.approx([0.98, 0.98 / math.e, 0.98 * math.exp(-((13.9 / 9.0) ** 2))])
    assert (found[[3, 4, 6]] == 0.0).all() and found[5] > 0.0  # half the angle is 60 degrees


def test_a_grid_says_what_its_data_say(grid: SampledGrid) -> None:
    ahead_left, ahead_right, behind_left, behind_right = (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)
    points = np.array([ahead_left, ahead_right, behind_left, behind_right, (2.1, 1.0)])
    assert grid.probability(points, HERE).tolist() == [0.8, 0.4, 0.0, 0.2, 0.0]
    turned = np.array([(-y + 10.0, x + 20.0) for x, y in points])  # by 90 degrees to the left, standing at (10, 20)
    assert grid.probability(turned, (10.0, 20.0, math.pi / 2.0)).tolist() == [0.8, 0.4, 0.0, 0.2, 0.0]


def test_capability_and_cod_of_a_grid_by_hand(grid: SampledGrid) -> None:
    """D = 4 m^2 x (.8 + .4 + .2); COD = (.8 + .4 - .2, .8 - .4 - .2) / 1.4."""
    facts = sensor_facts(grid)
    assert facts.capability == pytest.approx(5.6, rel=5e-3)
    assert facts.cod_offset == pytest.approx((1.0 / 1.4, 0.2 / 1.4), abs=5e-3)
    assert (grid.area, grid.reach) == (12.0, pytest.approx(math.sqrt(8.0)))


@pytest.mark.parametrize("sensor", [RangeFalling(120.0, 14.0, 9.0), RangeFalling(360.0, 5.0, 9.0), SampledGrid("side_looking.csv", 2.0)])
def test_outlines_are_counter_clockwise_and_within_reach(sensor: SensorModel) -> None:
    outline = sensor.footprint((3.0, 4.0, 1.0))
    assert 0.9 * sensor.area < polygon_area(outline) < 1.01 * sensor.area
    assert np.hypot(outline[:, 0] - 3.0, outline[:, 1] - 4.0).max() <= sensor.reach * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "should hold rows of equal length"),
        ("0.1,0.2\n0.3\n", "should hold rows of equal length"),
        ("0,0\n0,0\n", "holds 0 alone; probabilities should lie from 0 to 1"),
        ("0.1,90\n", "holds 90; probabilities should lie from 0 to 1"),
        ("0.1,nan\n", "holds nan; probabilities should lie from 0 to 1"),
        ("0.5,half\n", "could not convert string to float: 'half'"),
    ],
)
def test_data_that_are_no_grid_of_probabilities_are_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(ValueError, match=f"file = .*: {said}"):
        SampledGrid(str(tmp_path / "bad.csv"), 2.0)


def test_a_scenario_with_a_missing_grid_names_the_sensor() -> None:
    with pytest.raises(BadSetting, match=r"sensors\.S: .*SampledGrid raised ValueError: file = 'nowhere\.csv'"):
        resolve("anisotropic", {"sensors.S.parameters": {"file": "nowhere.csv", "spacing": 2.0}})


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"angle": 400.0}, "angle = 400.0: should be a number above 0 and at most 360 degrees"),
        ({"angle": "wide"}, "angle = 'wide': should be a number above 0 and at most 360 degrees"),
        ({"radius": -1.0}, "radius = -1.0: should be a number above 0 m"),
        ({"scale": math.nan}, "scale = nan: should be a number above 0 m"),
        ({"peak": 1.5}, "peak = 1.5: should be a number above 0 and at most 1"),
    ],
)
def test_a_wrong_parameter_is_named_with_its_value(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        RangeFalling(**({"angle": 90.0, "radius": 5.0, "scale": 3.0, "peak": 0.9} | wrong))


def test_a_missing_grid_is_named_with_the_folders_where_it_is_sought(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=re.escape(f"file = 'nix.csv': No such file or directory; it should lie in {tmp_path} or ")):
        SampledGrid("nix.csv", 1.0)
    with pytest.raises(ValueError, match=r"spacing = 0\.0: should be a number above 0 m"):
        SampledGrid("side_looking.csv", 0.0)


def test_the_data_are_shipped_beside_the_module() -> None:
    assert (DATA / "side_looking.csv").exists()


@pytest.mark.slow
def test_a_swarm_of_such_sensors_tracks_targets_without_a_hole() -> None:
    result = Simulation(resolve("anisotropic", {"run.dt": 0.5, "run.seconds": 24.0})).run()
    assert result.agents == 12 and result.ticks == 48
    assert result.hole_area < 1e-9 and result.mass_residual < 1e-9
    assert result.share_in_view > 0.5 and result.steady_ospa < 8.0
