"""D, U, the power radius and the COD against closed forms; other sensors than wedges by quadrature."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.config import CapacitySettings
from agents.coverage.capacity import centroid_of_detection, detecting_capability, power_radius, sensor_facts, unused_capacity
from protocol.sensing import SENSOR_CLASSES, Pose, WedgeSensor
from protocol.settings import BadSetting
from protocol.user_classes import CheckedSensor


class AsStranger:
    """A wedge that hides what it is, so that D and COD come from quadrature."""

    def __init__(self, wedge: WedgeSensor) -> None:
        self._wedge, self.reach, self.area = wedge, wedge.reach, wedge.area

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        return self._wedge.probability(points, pose)

    def footprint(self, pose: Pose) -> np.ndarray:
        return self._wedge.footprint(pose)


class Cone:
    """p_d falls linearly from 1 at the sensor to 0 at 6 m, all around: D = pi 6^2 / 3."""

    reach, area = 6.0, math.pi * 36.0

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        return np.maximum(0.0, 1.0 - np.hypot(points[:, 0] - pose[0], points[:, 1] - pose[1]) / 6.0)

    def footprint(self, pose: Pose) -> np.ndarray:
        return np.empty((0, 2))


class Blind(Cone):
    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        return np.zeros(len(points))


@pytest.mark.parametrize(
    ("name", "area", "radius"),
    [
        *[("A", 132.70, 6.50), ("B", 24.88, 2.81), ("C", 17.59, 2.37), ("D", 1295.9, 20.31)],
        *[("E", 39.27, 3.54), ("F", 209.44, 8.17), ("G", 418.87, 11.55), ("H", 837.76, 16.33)],
    ],
)
def test_capability_of_the_classes_of_table_one(name: str, area: float, radius: float) -> None:
    capability = detecting_capability(SENSOR_CLASSES[name])
    assert capability == pytest.approx(area, rel=4e-4)
    assert power_radius(capability) == pytest.approx(radius, abs=0.006)


@pytest.mark.parametrize("fall", [None, 0.6, 0.1, 1e-9])
@pytest.mark.parametrize("name", SENSOR_CLASSES)
def test_quadrature_agrees_with_the_closed_form_of_a_wedge(name: str, fall: float | None) -> None:
    paper = SENSOR_CLASSES[name]
    sensor = WedgeSensor(paper.angle, paper.radius, paper.prob_detection, None, fall)
    exact, rough = sensor_facts(sensor), sensor_facts(AsStranger(sensor))
    assert rough.capability == pytest.approx(exact.capability, rel=1e-3)
    assert rough.cod_offset == pytest.approx(exact.cod_offset, abs=1e-3 * SENSOR_CLASSES[name].radius)


def test_capability_of_a_probability_that_falls_with_the_range() -> None:
    facts = sensor_facts(Cone())
    assert facts.capability == pytest.approx(math.pi * 36.0 / 3.0, rel=1e-4)
    assert facts.cod_offset == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_wedge_whose_probability_falls_to_nothing_is_a_cone() -> None:
    assert detecting_capability(WedgeSensor(2.0 * math.pi, 6.0, 1.0, None, 1e-12)) == pytest.approx(detecting_capability(Cone()), rel=1e-4)
    half = WedgeSensor(math.pi, 4.0, 0.5, None, 1e-12)  # the integral of x (1 - r / 4) over the half disc is 2 * 4^3 / 12
    assert centroid_of_detection(half, (0.0, 0.0, 0.0)) == pytest.approx([(2.0 * 4.0**3 / 12.0) / (math.pi * 4.0**2 / 6.0), 0.0])


def test_a_sensor_that_sees_nothing_is_refused() -> None:
    with pytest.raises(BadSetting, match="Blind: the detection probability is 0 everywhere within its reach"):
        sensor_facts(CheckedSensor(Blind(), "fields:Blind"))


def test_a_reach_for_which_the_quadrature_is_too_coarse_is_refused() -> None:
    cone = Cone()
    cone.reach = 50.0 * cone.reach  # some 320 points of the quadrature lie within the cone
    with pytest.raises(BadSetting, match=r"only \d+ of 1024 x 1024 places within its reach of .* m are seen, the farthest at 5\.\d+ m"):
        sensor_facts(cone)
    cone = Cone()
    cone.reach = 30.0 * cone.reach
    assert sensor_facts(cone).capability == pytest.approx(math.pi * 36.0 / 3.0, rel=0.02)


def test_cod_of_a_half_disc_lies_four_thirds_of_r_over_pi_ahead() -> None:
    assert centroid_of_detection(WedgeSensor(math.pi, 3.0, 0.5), (0.0, 0.0, 0.0)) == pytest.approx([4.0 / math.pi, 0.0])
    assert centroid_of_detection(WedgeSensor(2.0 * math.pi, 3.0, 0.5), (5.0, 6.0, 1.0)) == pytest.approx([5.0, 6.0])


@given(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-math.pi, math.pi))
def test_the_cod_moves_and_turns_with_the_sensor(x: float, y: float, heading: float) -> None:
    offset = centroid_of_detection(SENSOR_CLASSES["C"], (0.0, 0.0, 0.0))[0]
    turned = centroid_of_detection(SENSOR_CLASSES["C"], (x, y, heading))
    assert turned == pytest.approx([x + offset * math.cos(heading), y + offset * math.sin(heading)])


def test_the_four_readings_of_unused_capacity_by_hand() -> None:
    """D = 100 m^2, 4 expected targets in view, each seen with probability .7."""
    readings = {mode: unused_capacity(100.0, 2.8, 4.0, CapacitySettings(mode=mode)) for mode in ("static", "expected", "saturating")}
    assert readings == {"static": 100.0, "expected": 97.2, "saturating": 50.0}
    assert unused_capacity(100.0, 2.8, 4.0) == pytest.approx(99.3)


def test_with_nothing_in_view_all_capacity_is_unused() -> None:
    for mode in ("literal", "expected", "static", "saturating"):
        assert unused_capacity(100.0, 0.0, 0.0, CapacitySettings(mode=mode)) == 100.0


@given(st.floats(0.01, 2000.0), st.floats(0.0, 1e4), st.floats(0.0, 1.0), st.sampled_from(["literal", "expected", "static", "saturating"]))
def test_unused_capacity_lies_between_zero_and_the_capability(capability: float, load: float, probability: float, mode: str) -> None:
    unused = unused_capacity(capability, load * probability, load, CapacitySettings(mode=mode))  # type: ignore[arg-type]
    assert 0.0 <= unused <= capability


@given(st.floats(0.0, 1e3))
def test_the_power_radius_is_that_of_the_disc_of_the_same_area(radius: float) -> None:
    assert power_radius(math.pi * radius * radius) == pytest.approx(radius, abs=1e-9)
