"""Paired comparisons by hand."""

import itertools
import json

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import rankdata, wilcoxon

from deploy.cli.study import pairs, show
from deploy.studies import paired
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


def test_p_is_the_share_of_signs_that_are_as_far_from_even_and_what_scipy_says_of_the_pairs() -> None:
    """Under the null hypothesis each difference has either sign; equal pairs are left out."""
    ours, theirs = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [1.5, 2.9, 2.8, 5.3, 4.7, 8.0]
    ranks = rankdata(np.abs(np.subtract(theirs, ours)))
    middle, found = ranks.sum() / 2, ranks[np.subtract(theirs, ours) > 0].sum()
    sums = [ranks @ signs for signs in itertools.product((0, 1), repeat=6)]
    share = np.mean([abs(one - middle) >= abs(found - middle) for one in sums])
    one = compare(rows("power", ours) + rows("voronoi", theirs), GROUP, "power", "voronoi")
    tied = compare(rows("power", [*ours, 3.0]) + rows("voronoi", [*theirs, 3.0]), GROUP, "power", "voronoi")
    assert one is not None and tied is not None
    assert one.wilcoxon == pytest.approx(share) == wilcoxon(ours, theirs).pvalue
    assert (tied.wilcoxon, tied.wins, len(tied.seeds)) == (one.wilcoxon, 4, 7)


def test_the_interval_holds_the_gain_and_is_wider_where_seeds_differ() -> None:
    """Of equal gains the interval is a point: 1 against 2 m is 50 %."""
    even, odd = (
        compare(rows("power", [1.0] * 8) + rows("voronoi", [2.0 - shift, 2.0 + shift] * 4), GROUP, "power", "voronoi") for shift in (0, 0.5)
    )
    assert even is not None and (even.gain, even.low, even.high) == (0.5, 0.5, 0.5)
    assert odd is not None and odd.low is not None and odd.high is not None and odd.low < 0.5 < odd.high


@pytest.mark.parametrize(("seeds", "least", "most"), [(40, 0.92, 0.97), (5, 0.78, 0.88)])
def test_the_interval_holds_the_true_gain_about_as_often_as_it_says_and_less_often_with_few_seeds(
    seeds: int, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """500 studies of two methods, of which one has 10 % less error; a seed is as hard for both."""
    monkeypatch.setattr(paired, "RESAMPLES", 500)
    dice, held = np.random.default_rng(3), []
    for _ in range(500):
        hard, own, other = dice.normal(1.0, 0.2, seeds), *dice.normal(0.0, 0.1, (2, seeds))
        _, low, high = paired.gains(np.column_stack([0.9 * hard + own, hard + other]))
        held.append(low is not None and high is not None and low <= 0.1 <= high)
    assert least <= np.mean(held) <= most


def test_the_json_of_a_study_compares_the_first_method_with_each_other_one() -> None:
    study = [row for name, shift in (("my:Law", 0.0), ("voronoi", 1.0), ("power", 0.5)) for row in rows(name, [1.0 + shift, 2.0 + shift])]
    found = json.loads(json.dumps(pairs(study)))
    assert [(pair["team"], pair["targets"], pair["method"], pair["other"]) for pair in found] == [
        ("2", 30, "my:Law", "voronoi"),
        ("2", 30, "my:Law", "power"),
    ]
    expected = {"seeds": [100, 101], "differences": [1.0, 1.0], "gain": 0.4, "wins": 2, "wilcoxon": 0.5, "sign": 0.5}
    assert {name: found[0][name] for name in expected} == expected and found[0]["low"] <= 0.4 <= found[0]["high"]


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
