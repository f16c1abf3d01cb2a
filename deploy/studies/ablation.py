"""The ablation: what search-and-track gains over other methods on the same seeds, and what each of its ingredients is worth.

Data types: a `MethodSummary` is one method with one team.

Rules. All numbers are means over the whole run, and over the seeds that both methods have. Intervals are those of the bootstrap over
seeds; with few seeds they are narrow by luck, so the number of seeds stands beside them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deploy.studies.paired import Group, gains, groups_of, values
from deploy.studies.trials import Row, methods_of

PARTS = ("never_seen", "lost", "in_view", "false")  # of OSPA and GOSPA


class MethodSummary(NamedTuple):
    """One method with one team; lengths in m."""

    group: Group
    method: str
    seeds: int
    ospa: float
    gospa: float
    parts: tuple[float, ...]  # of the OSPA, in the order of `PARTS`
    gospa_parts: tuple[float, ...]  # of the GOSPA
    gain: (
        float | None
    )  # of the OSPA over the base method on the same seeds, as a share of the base; None for the base, without seeds, and over no error
    low: float | None  # ends of the interval of 95 % of the gain
    high: float | None


def lines(rows: Sequence[Row], base: str = "power") -> list[MethodSummary]:
    """A line for each team and method, in the order of the study."""
    found = [_line(rows, group, method, base) for group in groups_of(rows) for method in methods_of(rows)]
    return [line for line in found if line is not None]


def _line(rows: Sequence[Row], group: Group, method: str, base: str) -> MethodSummary | None:
    """The line of a method; None without trials."""
    ospa, others = values(rows, group, method, "mean_ospa"), values(rows, group, base, "mean_ospa")
    if not ospa:
        return None
    gospa = _mean(values(rows, group, method, "mean_gospa"))
    parts, gospa_parts = (tuple(_mean(values(rows, group, method, f"{score}_{part}")) for part in PARTS) for score in ("ospa", "gospa"))
    pairs = np.array([(ospa[seed], others[seed]) for seed in ospa if seed in others and method != base]).reshape(-1, 2)
    return MethodSummary(group, method, len(ospa), _mean(ospa), gospa, parts, gospa_parts, *gains(pairs))


def _mean(found: dict[int, float]) -> float:
    """The mean over the seeds."""
    return float(np.mean([*found.values()]))
