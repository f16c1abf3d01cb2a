"""OSPA and GOSPA against brute force over all assignments, and the closed forms of the paper's definitions."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.sensing import SENSOR_CLASSES
from world.score import errors, gospa, heterogeneity_level, ospa

NOTHING = np.empty((0, 2))
coordinates = st.floats(-30.0, 30.0, allow_nan=False, width=32)
point_sets = st.lists(st.tuples(coordinates, coordinates), max_size=5).map(lambda rows: np.array(rows, dtype=float).reshape(-1, 2))
orders = st.sampled_from([1.0, 2.0, 3.0])
cutoffs = st.sampled_from([1.0, 10.0, 25.0])
quickly = settings(max_examples=80, deadline=None, database=None)


def brute_ospa(truth: np.ndarray, estimate: np.ndarray, cutoff: float, order: float) -> float:
    """(22) as printed, over all permutations."""
    small, large = sorted((truth, estimate), key=len)
    if not len(large):
        return 0.0
    best = min(
        sum(min(cutoff, math.dist(point, large[index])) ** order for point, index in zip(small, chosen))
        for chosen in itertools.permutations(range(len(large)), len(small))
    )
    return ((best + cutoff**order * (len(large) - len(small))) / len(large)) ** (1.0 / order)


def brute_gospa(truth: np.ndarray, estimate: np.ndarray, cutoff: float, order: float) -> float:
    """GOSPA with alpha = 2 in its second form: over all partial assignments, half a cutoff for each point without a partner."""
    best = math.inf
    for number in range(min(len(truth), len(estimate)) + 1):
        for rows in itertools.combinations(range(len(truth)), number):
            for columns in itertools.permutations(range(len(estimate)), number):
                pairs = sum(math.dist(truth[row], estimate[column]) ** order for row, column in zip(rows, columns))
                best = min(best, pairs + cutoff**order / 2.0 * (len(truth) + len(estimate) - 2 * number))
    return best ** (1.0 / order)


def test_two_empty_sets_agree() -> None:
    assert ospa(NOTHING, NOTHING) == 0.0
    assert gospa(NOTHING, NOTHING).total == 0.0


def test_one_empty_set_costs_the_cutoff_whatever_the_number_of_points() -> None:
    assert ospa(np.zeros((3, 2)), NOTHING) == 10.0
    assert ospa(NOTHING, np.zeros((7, 2)), cutoff=4.0, order=2.0) == 4.0


def test_ospa_by_hand() -> None:
    truth = np.array([[0.0, 0.0], [50.0, 0.0]])
    assert ospa(truth, np.array([[3.0, 4.0]])) == 7.5  # (5 + 10) / 2
    assert ospa(truth, np.array([[50.0, 1.0], [3.0, 4.0]])) == 3.0  # (5 + 1) / 2
    assert ospa(truth, np.array([[30.0, 0.0], [80.0, 0.0]])) == 10.0  # nothing within the cutoff
    assert ospa(truth, np.array([[3.0, 4.0]]), order=2.0) == pytest.approx(math.sqrt((25.0 + 100.0) / 2.0))


def test_gospa_by_hand() -> None:
    truth = np.array([[0.0, 0.0], [50.0, 0.0], [90.0, 0.0]])
    result = gospa(truth, np.array([[3.0, 4.0], [70.0, 0.0]]))
    assert (result.total, result.localisation, result.missed, result.false) == (20.0, 5.0, 10.0, 5.0)


def test_a_pair_at_the_cutoff_is_a_missed_and_a_false_target_only_where_alpha_is_two() -> None:
    truth, estimate = np.array([[0.0, 0.0]]), np.array([[10.0, 0.0]])
    two, one = gospa(truth, estimate), gospa(truth, estimate, alpha=1.0)
    assert (two.total, two.localisation, two.missed, two.false) == (10.0, 0.0, 5.0, 5.0)
    assert (one.total, one.localisation, one.missed, one.false) == (10.0, 10.0, 0.0, 0.0)


def test_a_target_far_away_is_missed_also_where_the_square_of_the_cutoff_is_less_than_its_power() -> None:
    cutoff = 16.50127684479608  # x * x and pow(x, 2.0) of the C library differ in the last bit
    result = gospa(np.zeros((1, 2)), np.array([[500.0, 0.0]]), cutoff, 2.0)
    assert result.localisation == 0.0 and result.missed == result.false == pytest.approx(cutoff / 2.0**0.5)


def test_a_smaller_alpha_punishes_a_wrong_number_more() -> None:
    assert gospa(np.zeros((1, 2)), NOTHING).total == 5.0
    assert gospa(np.zeros((1, 2)), NOTHING, alpha=1.0).total == 10.0
    with pytest.raises(ValueError, match=r"alpha = 0\.0"):
        gospa(NOTHING, NOTHING, alpha=0.0)


@quickly
@given(point_sets, point_sets, cutoffs, orders)
def test_ospa_equals_the_best_of_all_permutations(truth: np.ndarray, estimate: np.ndarray, cutoff: float, order: float) -> None:
    assert ospa(truth, estimate, cutoff, order) == pytest.approx(brute_ospa(truth, estimate, cutoff, order), rel=1e-9, abs=1e-9)


@quickly
@given(point_sets, point_sets, cutoffs, orders)
def test_gospa_equals_the_best_of_all_partial_assignments(truth: np.ndarray, estimate: np.ndarray, cutoff: float, order: float) -> None:
    result = gospa(truth, estimate, cutoff, order)
    assert result.total == pytest.approx(brute_gospa(truth, estimate, cutoff, order), rel=1e-9, abs=1e-9)
    parts = result.localisation**order + result.missed**order + result.false**order
    assert result.total**order == pytest.approx(parts, rel=1e-9, abs=1e-9)


@quickly
@given(point_sets, point_sets)
def test_both_errors_of_one_assignment_are_those_of_two(truth: np.ndarray, estimate: np.ndarray) -> None:
    assert errors(truth, estimate) == (ospa(truth, estimate), gospa(truth, estimate))


@quickly
@given(point_sets, point_sets, point_sets, orders)
def test_ospa_is_a_metric(first: np.ndarray, second: np.ndarray, third: np.ndarray, order: float) -> None:
    assert ospa(first, first, order=order) == 0.0
    assert ospa(first, second, order=order) == ospa(second, first, order=order)
    direct = ospa(first, second, order=order)
    assert direct <= ospa(first, third, order=order) + ospa(third, second, order=order) + 1e-9
    assert direct <= 10.0 + 1e-9


@quickly
@given(point_sets, point_sets, st.randoms(use_true_random=False))
def test_the_order_of_the_points_does_not_matter(truth: np.ndarray, estimate: np.ndarray, random: np.random.Generator) -> None:
    rows = list(range(len(estimate)))
    random.shuffle(rows)
    assert ospa(truth, estimate) == pytest.approx(ospa(truth, estimate[rows]), rel=1e-12)
    assert gospa(truth, estimate).total == pytest.approx(gospa(truth, estimate[rows]).total, rel=1e-12)


def test_lists_of_points_are_taken_too() -> None:
    assert ospa([[0.0, 0.0]], [[0.0, 1.0]]) == 1.0


def test_the_heterogeneity_level_is_the_deviation_of_the_radii() -> None:
    assert heterogeneity_level([3.0, 3.0, 3.0]) == 0.0
    assert heterogeneity_level([1.0, 5.0]) == 2.0


def radius(letter: str) -> float:
    """g of a sensor with p_d = 1 and nothing in view, sqrt(D / pi)."""
    return math.sqrt(SENSOR_CLASSES[letter].area / math.pi)


@pytest.mark.parametrize(("letter", "number", "level"), [("F", 20, 2.3147), ("G", 10, 3.7766), ("H", 4, 4.7682)])
def test_the_levels_of_the_teams_of_section_iv_c(letter: str, number: int, level: float) -> None:
    assert heterogeneity_level([radius("E")] * 20 + [radius(letter)] * number) == pytest.approx(level, abs=5e-5)
