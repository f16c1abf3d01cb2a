"""Paired comparisons by hand."""

import pytest
from rich.console import Console

from deploy.cli.study import show
from deploy.studies.paired import Group, compare, groups_of, summarise
from deploy.studies.trials import Row

GROUP = Group("2", 30)


def rows(method: str, values: list[float], first_seed: int = 100, team: str = "2", targets: int = 30) -> list[Row]:
    """One trial for each value."""
    return [
        {"team": team, "start_targets": targets, "method": method, "seed": first_seed + number, "steady_ospa": value}
        | {"steady_gospa": 10.0 * value, "end_in_view": value / 10.0}
        for number, value in enumerate(values)
    ]


def test_differences_are_taken_seed_by_seed() -> None:
    found = compare(rows("power", [1.0, 2.0, 3.0]) + rows("voronoi", [2.0, 2.5, 2.5]), GROUP, "power", "voronoi")
    assert found is not None
    assert found.differences == (1.0, 0.5, -0.5) and found.wins == 2
    assert found.gain == pytest.approx((1.0 / 3.0) / (7.0 / 3.0))


def test_seeds_that_one_method_lacks_do_not_count() -> None:
    found = compare(rows("power", [1.0, 2.0]) + rows("voronoi", [2.5, 9.0], first_seed=101), GROUP, "power", "voronoi")
    assert found is not None and found.differences == (0.5,)
    assert compare(rows("power", [1.0]), GROUP, "power", "voronoi") is None


def test_eight_wins_of_eight_have_p_of_two_in_two_to_the_eighth() -> None:
    """Both tests, two-sided: 2 / 2^8 = 0.0078."""
    both = rows("power", [1.0] * 8) + rows("voronoi", [1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.8])
    found = compare(both, GROUP, "power", "voronoi")
    assert found is not None and found.wilcoxon == pytest.approx(2.0 / 256.0) and found.sign == pytest.approx(2.0 / 256.0)


def test_equal_methods_have_no_p() -> None:
    found = compare(rows("power", [1.0, 2.0]) + rows("voronoi", [1.0, 2.0]), GROUP, "power", "voronoi")
    assert found is not None and (found.gain, found.wins, found.wilcoxon, found.sign) == (0.0, 0, None, None)


def test_over_a_method_without_an_error_there_is_no_gain(capsys: pytest.CaptureFixture[str]) -> None:
    both = rows("power", [0.5, 0.5]) + rows("voronoi", [0.0, 0.0])
    found = compare(both, GROUP, "power", "voronoi")
    assert found is not None and (found.gain, found.wins) == (None, 0)
    show(both, Console(width=200))
    assert "-, 0/2" in capsys.readouterr().out


def test_summary_of_a_group_alone() -> None:
    found = summarise(rows("power", [3.0, 1.0, 2.0]) + rows("power", [9.0], team="3"), GROUP, "power")
    assert found is not None and (found.trials, found.ospa, found.low, found.high, found.gospa) == (3, 2.0, 1.0, 3.0, 20.0)
    assert found.in_view == pytest.approx(0.2) and summarise([], GROUP, "power") is None


def test_groups_come_by_number_of_targets_and_then_as_they_are() -> None:
    mixed = rows("power", [1.0], team="3", targets=40) + rows("power", [1.0], team="3") + rows("power", [1.0])
    assert groups_of(mixed) == [Group("3", 30), Group("2", 30), Group("3", 40)]
