"""Geometry against closed forms and against shapely."""

import math

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from protocol.geometry import EMPTY, contains, distances, polygon_area, polygon_centroid, rectangle, total_area, wrap_angle

TRIANGLE = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 6.0]])
coordinates = st.floats(-100.0, 100.0).map(lambda value: round(value, 3))
points = st.tuples(coordinates, coordinates)


@st.composite
def convex_polygons(draw: st.DrawFn) -> np.ndarray:
    """The convex hull, counter-clockwise, of 3 to 12 points that do not lie on one line."""
    hull = shapely.MultiPoint(draw(st.lists(points, min_size=3, max_size=12))).convex_hull
    if hull.geom_type != "Polygon" or hull.area < 1.0:
        hull = shapely.box(0.0, 0.0, 1.0, 1.0)
    return np.array(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1]


def test_a_rectangle_is_counter_clockwise_and_has_its_area() -> None:
    assert polygon_area(rectangle(4.0, 2.5)) == 10.0
    assert polygon_centroid(rectangle(4.0, 2.5)).tolist() == [2.0, 1.25]


def test_a_triangle_has_half_of_base_times_height_and_its_centroid_at_a_third() -> None:
    assert polygon_area(TRIANGLE) == 9.0
    assert polygon_area(TRIANGLE[::-1]) == -9.0
    assert polygon_centroid(TRIANGLE).tolist() == [1.0, 2.0]


def test_the_empty_polygon_has_no_area_no_centroid_and_no_points_and_is_infinitely_far() -> None:
    somewhere = np.array([[1.0, 2.0], [0.0, 0.0]])
    assert polygon_area(EMPTY) == 0.0
    assert np.isnan(polygon_centroid(EMPTY)).all()
    assert contains(EMPTY, somewhere).tolist() == [False, False]
    assert distances(EMPTY, somewhere).tolist() == [math.inf, math.inf]


def test_a_polygon_without_area_has_the_mean_of_its_corners_as_centroid() -> None:
    assert polygon_centroid(np.array([[1.0, 1.0], [3.0, 5.0]])).tolist() == [2.0, 3.0]


def test_no_points_give_no_answers() -> None:
    assert contains(TRIANGLE, EMPTY).shape == (0,)
    assert distances(TRIANGLE, EMPTY).shape == (0,)


def test_a_point_on_the_border_is_inside_and_at_distance_zero() -> None:
    border = np.array([[0.0, 0.0], [1.5, 0.0], [0.0, 3.0], [1.5, 3.0]])
    assert contains(TRIANGLE, border).all()
    assert distances(TRIANGLE, border).tolist() == [0.0, 0.0, 0.0, 0.0]


def test_distances_to_an_edge_and_to_a_corner_are_those_of_school() -> None:
    outside = np.array([[1.0, -2.0], [-3.0, -4.0], [6.0, -4.0]])
    assert distances(TRIANGLE, outside).tolist() == [2.0, 5.0, 5.0]


def test_a_repeated_corner_changes_nothing() -> None:
    doubled = np.vstack([TRIANGLE, TRIANGLE[-1:]])
    probe = np.array([[0.5, 0.5], [4.0, 4.0]])
    assert polygon_area(doubled) == 9.0
    assert distances(doubled, probe).tolist() == distances(TRIANGLE, probe).tolist()


@given(convex_polygons())
def test_area_and_centroid_agree_with_shapely(polygon: np.ndarray) -> None:
    oracle = shapely.Polygon(polygon)
    assert math.isclose(polygon_area(polygon), oracle.area, rel_tol=1e-9)
    assert np.allclose(polygon_centroid(polygon), [oracle.centroid.x, oracle.centroid.y], rtol=0.0, atol=1e-6)


@given(st.lists(st.one_of(convex_polygons(), st.just(EMPTY), st.just(TRIANGLE[:2])), max_size=6))
def test_the_area_of_several_is_the_sum_of_their_areas(polygons: list[np.ndarray]) -> None:
    assert math.isclose(total_area(polygons), math.fsum(map(polygon_area, polygons)), rel_tol=1e-9)


@given(convex_polygons(), st.lists(points, min_size=1, max_size=20))
def test_distance_and_containment_agree_with_shapely(polygon: np.ndarray, probes: list[tuple[float, float]]) -> None:
    oracle = shapely.Polygon(polygon)
    expected = np.array([oracle.distance(shapely.Point(probe)) for probe in probes])
    found = distances(polygon, np.array(probes))
    assert np.allclose(found, expected, rtol=0.0, atol=1e-9)
    clear = np.array([oracle.exterior.distance(shapely.Point(probe)) > 1e-9 for probe in probes])
    assert (contains(polygon, np.array(probes)) == (expected == 0.0))[clear].all()


@given(convex_polygons(), st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)))
def test_a_shift_moves_the_centroid_and_leaves_the_area(polygon: np.ndarray, shift: tuple[float, float]) -> None:
    moved = polygon + np.array(shift)
    assert math.isclose(polygon_area(moved), polygon_area(polygon), rel_tol=1e-6)
    assert np.allclose(polygon_centroid(moved), polygon_centroid(polygon) + shift, rtol=0.0, atol=1e-3)


@given(st.floats(-1e4, 1e4))
def test_a_wrapped_angle_points_the_same_way_and_lies_in_the_half_open_circle(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


def test_plus_pi_and_anything_just_below_minus_pi_wrap_to_minus_pi() -> None:
    assert wrap_angle(math.pi) == -math.pi
    assert wrap_angle(math.nextafter(-math.pi, -4.0)) == -math.pi
