"""Wedge sensors against polar coordinates, and Table I."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import strategies as st

from protocol.geometry import polygon_area
from protocol.sensing import SENSOR_CLASSES, SensorModel, WedgeSensor

QUARTER = WedgeSensor(math.pi / 2.0, 10.0, 0.8)
HERE = (0.0, 0.0, 0.0)
wedges = st.builds(WedgeSensor, st.floats(0.05, 2.0 * math.pi), st.floats(0.5, 30.0), st.floats(0.01, 1.0))
poses = st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-10.0, 10.0))


def polar(pose: tuple[float, float, float], bearing: float, distance: float) -> np.ndarray:
    """The point (1, 2) at a bearing from the heading and a distance from the sensor."""
    return np.array([[pose[0] + distance * math.cos(pose[2] + bearing), pose[1] + distance * math.sin(pose[2] + bearing)]])


def test_a_quarter_disc_sees_ahead_up_to_its_radius_and_45_degrees_to_either_side() -> None:
    points = np.array([[9.99, 0.0], [10.01, 0.0], [5.0, 4.99], [5.0, -4.99], [5.0, 5.01], [-1.0, 0.0], [0.0, 0.0], [10.0, 0.0]])
    assert QUARTER.probability(points, HERE).tolist() == [0.8, 0.0, 0.8, 0.8, 0.0, 0.0, 0.8, 0.8]


def test_no_points_have_no_probabilities() -> None:
    assert QUARTER.probability(np.empty((0, 2)), HERE).shape == (0,)


@given(wedges, poses, st.floats(-math.pi, math.pi), st.floats(0.01, 40.0))
def test_probability_is_constant_inside_the_polar_wedge_and_zero_outside(
    sensor: WedgeSensor, pose: tuple[float, float, float], bearing: float, distance: float
) -> None:
    margin = min(abs(distance - sensor.radius), abs(abs(bearing) - sensor.angle / 2.0))
    if margin > 1e-6:
        inside = distance < sensor.radius and abs(bearing) < sensor.angle / 2.0
        assert sensor.probability(polar(pose, bearing, distance), pose).tolist() == [sensor.prob_detection if inside else 0.0]


def test_a_probability_that_falls_with_the_distance_is_linear_between_the_sensor_and_its_radius() -> None:
    falling = WedgeSensor(math.pi / 2.0, 10.0, 0.8, None, 0.2)
    points = np.array([[0.0, 0.0], [2.5, 0.0], [0.0, 5.0], [3.0, -4.0], [10.0, 0.0], [10.01, 0.0]])
    assert falling.probability(points, (0.0, 0.0, 0.0)) == pytest.approx([0.8, 0.65, 0.0, 0.0, 0.2, 0.0], abs=1e-12)
    assert falling.probability(points, (0.0, 0.0, -0.9)) == pytest.approx([0.8, 0.0, 0.0, 0.5, 0.0, 0.0], abs=1e-12)


@given(wedges, poses, st.floats(1e-12, 1.0), st.floats(-math.pi, math.pi), st.floats(0.0, 1.0))
def test_a_falling_probability_stays_between_its_two_ends(
    sensor: WedgeSensor, pose: tuple[float, float, float], share: float, bearing: float, part: float
) -> None:
    far = share * sensor.prob_detection
    falling = WedgeSensor(sensor.angle, sensor.radius, sensor.prob_detection, None, far)
    points = np.vstack([polar(pose, bearing, part * sensor.radius), polar(pose, 0.0, part * sensor.radius)])
    constant, found = sensor.probability(points, pose), falling.probability(points, pose)
    assert ((found > 0.0) == (constant > 0.0)).all()
    assert (found[found > 0.0] >= far).all() and (found <= sensor.prob_detection).all()


@given(st.floats(-10.0, 10.0), st.floats(0.01, 9.99), st.floats(-math.pi, math.pi))
@example(0.3, 5.0, math.pi)
def test_a_full_disc_sees_in_every_direction_straight_behind_included(heading: float, distance: float, bearing: float) -> None:
    pose = (1.0, 2.0, heading)
    assert WedgeSensor(2.0 * math.pi, 10.0, 0.5).probability(polar(pose, bearing, distance), pose).tolist() == [0.5]


def test_rays_straight_behind_a_full_disc_are_never_cut_by_rounding() -> None:
    sensor = WedgeSensor(2.0 * math.pi, 10.0, 1.0)
    for heading in np.linspace(-math.pi, math.pi, 2001):
        assert sensor.probability(polar((0.0, 0.0, heading), math.pi, 7.0), (0.0, 0.0, heading)).tolist() == [1.0]


@given(wedges, poses)
@example(WedgeSensor(math.nextafter(2.0 * math.pi, 0.0), 2.0, 1.0), (-16.0, 23.0, 5.0))
def test_the_footprint_is_a_counter_clockwise_polygon_inscribed_in_the_wedge(sensor: WedgeSensor, pose: tuple[float, float, float]) -> None:
    outline = sensor.footprint(pose)
    assert shapely.Polygon(outline).is_valid
    steps = max(2, math.ceil(sensor.angle / math.radians(5.0)))
    chords = steps * sensor.radius**2 * math.sin(sensor.angle / steps) / 2.0  # steps triangles with the apex at the sensor
    assert math.isclose(polygon_area(outline), chords, rel_tol=1e-6)
    assert chords < sensor.area < 1.03 * chords
    assert (np.hypot(*(outline - pose[:2]).T) <= sensor.reach * (1.0 + 1e-9)).all()


def test_a_full_disc_has_no_apex_and_a_wedge_has_one() -> None:
    assert np.allclose(np.hypot(*WedgeSensor(2.0 * math.pi, 3.0, 1.0).footprint(HERE).T), 3.0)
    assert QUARTER.footprint((4.0, 5.0, 1.0))[0].tolist() == [4.0, 5.0]


@pytest.mark.parametrize(
    ("name", "capability"),
    [("A", 132.70), ("B", 24.88), ("C", 17.59), ("D", 1295.9), ("E", 39.27), ("F", 209.44), ("G", 418.87), ("H", 837.76)],
)
def test_area_times_detection_probability_of_table_i_is_the_known_capability(name: str, capability: float) -> None:
    sensor = SENSOR_CLASSES[name]
    assert sensor.area * sensor.prob_detection == pytest.approx(capability, rel=4e-4)


def test_a_wedge_fulfils_the_sensor_contract() -> None:
    assert isinstance(QUARTER, SensorModel)
    assert (QUARTER.reach, QUARTER.area) == (10.0, math.pi * 25.0)


@pytest.mark.parametrize(
    ("numbers", "field"),
    [
        ((0.0, 1.0, 1.0), "angle = 0.0"),
        ((6.3, 1.0, 1.0), "angle = 6.3"),
        ((math.nan, 1.0, 1.0), "angle = nan"),
        ((1.0, 0.0, 1.0), "radius = 0.0"),
        ((1.0, math.inf, 1.0), "radius = inf"),
        ((1.0, 1e200, 1.0), "radius = 1e"),
        ((1.0, math.nan, 1.0), "radius = nan"),
        ((1.0, 1.0, 0.0), "prob_detection = 0.0"),
        ((1.0, 1.0, 1.01), "prob_detection = 1.01"),
        ((1.0, 1.0, math.nan), "prob_detection = nan"),
    ],
)
def test_a_wedge_with_an_impossible_number_cannot_be_built(numbers: tuple[float, float, float], field: str) -> None:
    with pytest.raises(ValueError, match=field):
        WedgeSensor(*numbers)


@pytest.mark.parametrize("far", [0.0, -0.1, 0.51, math.nan])
def test_a_probability_at_the_far_edge_above_that_at_the_sensor_or_of_zero_is_refused(far: float) -> None:
    with pytest.raises(ValueError, match=rf"prob_detection_far = {far}: should be more than 0 and at most prob_detection = 0\.5"):
        WedgeSensor(1.0, 1.0, 0.5, None, far)
