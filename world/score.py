"""Scores: how good an estimate is, and how a team is put together; pure functions of arrays and numbers.

Sets of points are arrays (N, 2) in m; the order of rows does not matter.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from protocol.arithmetic import elementwise
from world.assignment import linear_sum_assignment


def ospa(truth: np.ndarray, estimate: np.ndarray, cutoff: float = 10.0, order: float = 1.0) -> float:
    """Optimal sub-pattern assignment distance of two sets of points, m (22).

    ((min over assignments sum min(d, cutoff)^order + cutoff^order (n - m)) / n)^(1/order), n the larger number of points. Between 0
    (the same set, or both empty) and `cutoff`. Reference: Schuhmacher, Vo and Vo, IEEE Trans. Signal Processing 56(8), 2008.

    >>> ospa(np.array([[0.0, 0.0], [50.0, 0.0]]), np.array([[3.0, 4.0]]))
    7.5
    """
    return _ospa(_assigned_costs(truth, estimate, cutoff, order), max(len(truth), len(estimate)), cutoff, order)


def _ospa(assigned: np.ndarray, most: int, cutoff: float, order: float) -> float:
    if most == 0:
        return 0.0
    total = _sum(assigned) + math.pow(cutoff, order) * (most - len(assigned))
    return _root(total / most, order)


@dataclass(frozen=True, slots=True)
class Gospa:
    """GOSPA and its parts, each in m. The parts add up in the power `order`: total^p = localisation^p + missed^p + false^p."""

    total: float
    localisation: float  # of the targets that have an estimate
    missed: float  # targets without an estimate
    false: float  # estimates without a target


def gospa(truth: np.ndarray, estimate: np.ndarray, cutoff: float = 10.0, order: float = 1.0, alpha: float = 2.0) -> Gospa:
    """Generalised OSPA distance of two sets of points, m, with its parts; it is a sum over targets, not a mean.

    (min over assignments sum min(d, cutoff)^order + cutoff^order / alpha |n - m|)^(1/order), 0 < alpha <= 2. With alpha = 2 a pair at the
    cutoff costs as much as one missed and one false target and is counted as these. With a smaller alpha it stays a localisation error.
    Reference: Rahmathullah, Garcia-Fernandez and Svensson, FUSION 2017.

    >>> gospa(np.array([[0.0, 0.0], [50.0, 0.0]]), np.array([[3.0, 4.0]]))
    Gospa(total=10.0, localisation=5.0, missed=5.0, false=0.0)
    """
    if not 0.0 < alpha <= 2.0:
        raise ValueError(f"alpha = {alpha}: GOSPA is defined for 0 < alpha <= 2")
    return _gospa(_assigned_costs(truth, estimate, cutoff, order), len(truth), len(estimate), cutoff, order, alpha)


def errors(truth: np.ndarray, estimate: np.ndarray, cutoff: float = 10.0) -> tuple[float, Gospa]:
    """`ospa` and `gospa` of two sets of points with their default order and alpha, of one assignment."""
    assigned = _assigned_costs(truth, estimate, cutoff, 1.0)
    return _ospa(assigned, max(len(truth), len(estimate)), cutoff, 1.0), _gospa(assigned, len(truth), len(estimate), cutoff, 1.0, 2.0)


def _gospa(assigned: np.ndarray, targets: int, estimates: int, cutoff: float, order: float, alpha: float) -> Gospa:
    most = math.pow(cutoff, order)
    kept = assigned[assigned < most] if alpha == 2.0 else assigned
    localisation = _sum(kept)
    missed = most / alpha * (targets - len(kept))
    false = most / alpha * (estimates - len(kept))
    return Gospa(*(_root(part, order) for part in (localisation + missed + false, localisation, missed, false)))


def heterogeneity_level(radii: Sequence[float] | np.ndarray) -> float:
    """Standard deviation of the power radii of a team, m (19), Definition 2."""
    values = np.asarray(radii, dtype=float)
    return float(np.sqrt(np.mean((values - values.mean()) ** 2)))


def _assigned_costs(truth: np.ndarray, estimate: np.ndarray, cutoff: float, order: float) -> np.ndarray:
    """min(d, cutoff)^order of each pair of a cheapest assignment, as many as the smaller set has points."""
    if not len(truth) or not len(estimate):
        return np.empty(0)
    truth, estimate = np.asarray(truth), np.asarray(estimate)
    offset_x = truth[:, 0, None] - estimate[:, 0]
    offset_y = truth[:, 1, None] - estimate[:, 1]
    costs = np.minimum(np.sqrt(offset_x * offset_x + offset_y * offset_y), cutoff)
    if order != 1.0:
        costs = elementwise(math.pow, costs, np.full_like(costs, order))
    return costs[linear_sum_assignment(costs)]


def _sum(values: np.ndarray) -> float:
    """A correctly rounded sum, so that the order of the points cannot show."""
    return math.fsum(values.tolist())


def _root(value: float, order: float) -> float:
    return value if order == 1.0 else math.pow(value, 1.0 / order)
