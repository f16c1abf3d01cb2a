"""Power cells: they tile the arena whatever the generators, and agree with shapely's half-planes, Voronoi diagram and the argmin itself."""

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agents.coverage.cells import cut, power_cell
from agents.tracking.claims import depths, make_claim, owned, power_distances
from protocol.geometry import polygon_area, polygon_centroid, rectangle
from protocol.settings import ArenaSettings

SIDE = 40.0
ARENA = rectangle(SIDE, SIDE)
ARENA_SETTINGS = ArenaSettings(width=SIDE, height=SIDE)

anywhere = st.one_of(st.integers(-20, 60).map(float), st.floats(-20.0, 60.0))  # whole numbers make ties and coincidences
generators = st.lists(st.tuples(anywhere, anywhere, st.one_of(st.just(0.0), st.just(5.0), st.floats(0.0, 40.0))), min_size=1, max_size=12)
to_the_millimetre = generators.map(lambda rows: [tuple(round(number, 3) for number in row) for row in rows])  # where an oracle must keep up
few = settings(max_examples=60)


def split(rows: list[tuple[float, float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 2) and radii (N,)."""
    table = np.array(rows, dtype=float)
    return table[:, :2], table[:, 2]


def areas(points: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Area of every cell, m^2."""
    return np.array([polygon_area(power_cell(index, points, radii, ARENA)) for index in range(len(points))])


def half_plane_cell(index: int, points: np.ndarray, radii: np.ndarray) -> shapely.Geometry:
    """The oracle: the arena cut by one large polygon for each other generator."""
    cell, cut_at = shapely.Polygon(ARENA), set()
    for other in range(len(points)):
        offset = points[other] - points[index]
        span = float(np.hypot(*offset))
        if other == index:
            continue
        if span == 0.0:
            if (radii[other], -other) > (radii[index], -index):
                return shapely.Polygon()
            continue
        normal = offset / span
        along = np.array([-normal[1], normal[0]])
        away = (span**2 + radii[index] ** 2 - radii[other] ** 2) / (2.0 * span)
        foot = points[index] + normal * np.clip(away, -1e3, 1e3)  # farther than that it cuts all or nothing
        near, far = 1e4 * along, -2e4 * normal
        if (border := (*foot, *normal)) in cut_at:
            continue  # where a border is cut twice GEOS may leave nothing
        cut_at.add(border)
        cell = cell & shapely.Polygon([foot - near, foot + near, foot + near + far, foot - near + far])
    return cell


@given(generators)
@example([(10.0, 10.0, 3.0)] * 4)
@example([(5.0, 5.0, 30.0), (6.0, 5.0, 1.0), (35.0, 35.0, 1.0)])
@example([(-20.0, -20.0, 0.0), (60.0, 60.0, 0.0)])
@few
def test_cells_tile_the_arena_whatever_the_generators(rows: list[tuple[float, float, float]]) -> None:
    points, radii = split(rows)
    assert areas(points, radii).sum() == pytest.approx(SIDE * SIDE, rel=1e-9)


@given(to_the_millimetre, st.integers(0, 2**32 - 1))
@few
def test_every_place_belongs_to_one_claim_alone_that_of_the_least_power_distance(rows: list[tuple[float, float, float]], seed: int) -> None:
    points, radii = split(rows)
    places = np.random.default_rng(seed).random((200, 2)) * SIDE
    holders = np.zeros((len(points), len(places)), dtype=bool)
    for index in range(len(points)):
        cell = cut(index, points, radii, ARENA)
        if cell.bounding:
            chosen = list(cell.bounding)
            names = tuple(str(number) for number in chosen)
            claim = make_claim(names, np.column_stack([points, radii])[chosen])
            holders[index] = owned(places, claim, ARENA_SETTINGS)
    assert (holders.sum(axis=0) == 1).all()
    distances = power_distances(places, np.column_stack([points, radii]))
    assert (holders.argmax(axis=0) == distances.argmin(axis=1)).all()


@given(to_the_millimetre)
@example([(0.0, 0.0, 0.0)] * 3 + [(0.0, 0.002, 0.0), (0.0, 0.0, 9.0)])
@example([(0.0, 0.0, 0.0), (33.0, 31.061, 0.0), (12.0, -8.5, 0.0), (33.0, 31.061, 0.0)])
@few
def test_cells_equal_the_intersection_of_half_planes(rows: list[tuple[float, float, float]]) -> None:
    points, radii = split(rows)
    for index in range(len(points)):
        oracle, cell = half_plane_cell(index, points, radii), power_cell(index, points, radii, ARENA)
        ours = shapely.Polygon(cell) if len(cell) else shapely.Polygon()
        assert ours.area == pytest.approx(oracle.area, abs=1e-6)
        assert ours.difference(oracle.buffer(1e-6)).area < 1e-6


@given(to_the_millimetre, st.floats(0.0, 500.0))
@few
def test_a_constant_added_to_all_weights_changes_nothing(rows: list[tuple[float, float, float]], constant: float) -> None:
    points, radii = split(rows)
    # Coincident generators of one radius must stay equal, so the squares are rounded before both diagrams.
    squares = np.round(radii * radii, 3)
    assert areas(points, np.sqrt(squares + constant)) == pytest.approx(areas(points, np.sqrt(squares)), abs=1e-5)


@given(st.sets(st.tuples(st.integers(1, 39), st.integers(1, 39)), min_size=2, max_size=12), st.floats(0.0, 20.0))
@few
def test_with_equal_radii_the_power_diagram_is_the_voronoi_diagram(places: set[tuple[int, int]], radius: float) -> None:
    points = np.array(sorted(places), dtype=float)
    box = shapely.Polygon(ARENA)
    cells = shapely.voronoi_polygons(shapely.MultiPoint(points), extend_to=box)
    found = areas(points, np.full(len(points), radius))
    for index, point in enumerate(points):
        oracle = next(cell for cell in cells.geoms if cell.covers(shapely.Point(point)))
        assert found[index] == pytest.approx((oracle & box).area, abs=1e-6)


def test_two_generators_by_hand() -> None:
    """Equal weights cut in the middle; a weight of 5^2 against 3^2 moves the cut by 16 / (2 x 20) = 0.4 m."""
    points = np.array([[10.0, 20.0], [30.0, 20.0]])
    assert areas(points, np.zeros(2)).tolist() == [800.0, 800.0]
    assert areas(points, np.array([5.0, 3.0])) == pytest.approx([20.4 * 40.0, 19.6 * 40.0])


def test_a_generator_inside_a_much_heavier_one_has_no_cell() -> None:
    points = np.array([[20.0, 20.0], [21.0, 20.0]])
    cell = cut(1, points, np.array([30.0, 1.0]), ARENA)
    assert cell.polygon.shape == (0, 2) and cell.bounding == ()


def test_a_cell_need_not_hold_its_own_generator() -> None:
    """d = 10, r = 12 and 2: the cut lies (100 + 4 - 144) / 20 = -2 m ahead of the light one, that is behind it."""
    points, radii = np.array([[10.0, 20.0], [20.0, 20.0]]), np.array([12.0, 2.0])
    assert areas(points, radii) == pytest.approx([22.0 * 40.0, 18.0 * 40.0])
    assert polygon_centroid(power_cell(1, points, radii, ARENA)) == pytest.approx([31.0, 20.0])


def test_of_coincident_equal_generators_the_first_takes_all() -> None:
    points, radii = np.full((3, 2), 20.0), np.full(3, 4.0)
    assert areas(points, radii).tolist() == [1600.0, 0.0, 0.0]
    assert areas(points, np.array([4.0, 4.0, 5.0])).tolist() == [0.0, 0.0, 1600.0]


def test_a_generator_outside_the_arena_may_own_a_part_of_it_or_nothing() -> None:
    points = np.array([[-10.0, 20.0], [20.0, 20.0]])
    assert areas(points, np.zeros(2)) == pytest.approx([5.0 * 40.0, 35.0 * 40.0])
    assert areas(np.array([[-50.0, 20.0], [20.0, 20.0]]), np.zeros(2)).tolist() == [0.0, 1600.0]


def test_bounds_name_the_neighbours_alone_and_the_own_generator_first() -> None:
    points = np.array([[5.0, 20.0], [15.0, 20.0], [25.0, 20.0], [35.0, 20.0]])
    assert cut(0, points, np.zeros(4), ARENA).bounding == (0, 1)
    assert sorted(cut(1, points, np.zeros(4), ARENA).bounding) == [0, 1, 2]


def test_depth_is_the_distance_to_the_nearest_bisector() -> None:
    points = np.array([[10.0, 20.0, 0.0], [30.0, 20.0, 0.0]])
    claim = make_claim(("s1", "s2"), points)
    assert depths(np.array([[13.0, 5.0], [24.0, 0.0]]), claim).tolist() == [7.0, -4.0]
    assert depths(np.zeros((1, 2)), make_claim(("s1",), points[:1])).tolist() == [np.inf]


def test_nobody_owns_a_place_outside_the_arena() -> None:
    claim = make_claim(("s1",), np.array([[10.0, 10.0, 0.0]]))
    places = np.array([[0.0, 0.0], [40.0, 40.0], [-1e-9, 5.0], [5.0, 40.1]])
    assert owned(places, claim, ARENA_SETTINGS).tolist() == [True, True, False, False]
