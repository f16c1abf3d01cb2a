"""Paired comparisons: the gain of a method over another on the same seeds, its interval, and its significance."""

from collections.abc import Sequence
from statistics import mean, median
from typing import NamedTuple

import numpy as np

from deploy.studies.trials import Row

RESAMPLES = 10_000


class Group(NamedTuple):
    """Trials that differ in seed and method alone."""

    team: str
    targets: int


class Comparison(NamedTuple):
    """`method` against `other` in one group, on the seeds that both have; errors are the steady OSPA, m."""

    group: Group
    method: str
    other: str
    seeds: tuple[int, ...]
    differences: tuple[float, ...]  # error of the other - error of the method, m, one for each seed
    gain: float | None  # mean difference, share of the other's mean; None where the other has no error
    low: float | None  # ends of the interval of 95 % of the gain
    high: float | None
    wins: int  # seeds with a smaller error than the other
    wilcoxon: float | None  # p of the signed-rank test, two-sided; None without differences
    sign: float | None  # p of the sign test, two-sided


def groups_of(rows: Sequence[Row]) -> list[Group]:
    """All groups in the order in which they occur, numbers of targets first."""
    found = list(dict.fromkeys(Group(str(row["team"]), row["start_targets"]) for row in rows))
    return sorted(found, key=lambda group: group.targets)


def values(rows: Sequence[Row], group: Group, method: str, figure: str = "steady_ospa") -> dict[int, float]:
    """A figure of a method in a group, by seed."""
    mine = [row for row in rows if (str(row["team"]), row["start_targets"], row["method"]) == (*group, method)]
    return {row["seed"]: row[figure] for row in mine}


def compare(rows: Sequence[Row], group: Group, method: str, other: str) -> Comparison | None:
    """The comparison on the seeds that both methods have; None when there is none."""
    ours, theirs = values(rows, group, method), values(rows, group, other)
    seeds = [seed for seed in ours if seed in theirs]
    if not seeds:
        return None
    differences = tuple(theirs[seed] - ours[seed] for seed in seeds)
    gain, low, high = gains(np.array([(ours[seed], theirs[seed]) for seed in seeds]))
    wins = sum(difference > 0.0 for difference in differences)
    return Comparison(group, method, other, tuple(seeds), differences, gain, low, high, wins, *_tests(differences))


def gains(pairs: np.ndarray) -> tuple[float | None, float | None, float | None]:
    """The mean gain over paired seeds (N, 2) of OSPA, own and base, and the ends of its interval of 95 %, as shares of the base.

    None without seeds, and where the base has no error. The bootstrap draws seeds with replacement; its numbers are always the same.
    Draws in which the base has no error do not count.
    """
    if not pairs[:, 1].any():
        return None, None, None
    drawn = np.random.default_rng(25).integers(0, len(pairs), (RESAMPLES, len(pairs)))
    drawn = drawn[pairs[drawn, 1].any(axis=1)]
    own, base = pairs[drawn, 0].mean(axis=1), pairs[drawn, 1].mean(axis=1)
    low, high = np.quantile(1.0 - own / base, [0.025, 0.975])
    return float(1.0 - pairs[:, 0].mean() / pairs[:, 1].mean()), float(low), float(high)


def _tests(differences: Sequence[float]) -> tuple[float | None, float | None]:
    """p of the signed-rank test and of the sign test; ties are left out."""
    from scipy.stats import binomtest, wilcoxon

    apart = [difference for difference in differences if difference != 0.0]
    if not apart:
        return None, None
    sign = binomtest(sum(difference > 0.0 for difference in apart), len(apart)).pvalue
    return float(wilcoxon(apart).pvalue), float(sign)


class Summary(NamedTuple):
    """One method in one group, medians over seeds."""

    group: Group
    method: str
    trials: int
    ospa: float  # m
    low: float
    high: float
    gospa: float  # m
    in_view: float  # share of target-time over the last 5 s, mean


def summarise(rows: Sequence[Row], group: Group, method: str) -> Summary | None:
    """Median, least and greatest steady OSPA of a method in a group; None without trials."""
    ospa = list(values(rows, group, method).values())
    if not ospa:
        return None
    gospa, in_view = (list(values(rows, group, method, figure).values()) for figure in ("steady_gospa", "end_in_view"))
    return Summary(group, method, len(ospa), median(ospa), min(ospa), max(ospa), median(gospa), mean(in_view))
