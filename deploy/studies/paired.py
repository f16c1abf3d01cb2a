"""Paired comparisons: the gain of a method over another on the same seeds, and its significance."""

from collections.abc import Sequence
from statistics import mean, median
from typing import NamedTuple

from deploy.studies.trials import Row


class Group(NamedTuple):
    """Trials that differ in seed and method alone."""

    team: str
    targets: int


class Comparison(NamedTuple):
    """`method` against `other` in one group: differences other - method of the steady OSPA, m, one for each seed that both have."""

    group: Group
    method: str
    other: str
    differences: tuple[float, ...]
    gain: float | None  # mean difference, share of the other's mean; None where the other has no error
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
    reference = mean(theirs[seed] for seed in seeds)
    gain = mean(differences) / reference if reference else None
    wins = sum(difference > 0.0 for difference in differences)
    return Comparison(group, method, other, differences, gain, wins, *_tests(differences))


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
