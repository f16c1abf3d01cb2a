"""OSPA (22) and GOSPA as linear programs: the cheapest assignment is a corner of the polytope of all shared assignments."""

import numpy as np
from scipy.optimize import linprog
from scipy.spatial.distance import cdist


def ospa(truth: np.ndarray, estimate: np.ndarray, cutoff: float = 10.0) -> float:
    """OSPA of first order, m (22)."""
    fewer, more = sorted((truth, estimate), key=len)
    if not len(more):
        return 0.0
    costs = np.minimum(cdist(fewer, more), cutoff) if len(fewer) else np.empty((0, len(more)))
    return (_cheapest(costs, whole=True)[0] + cutoff * (len(more) - len(fewer))) / len(more)


def gospa(truth: np.ndarray, estimate: np.ndarray, cutoff: float = 10.0) -> tuple[float, float, float, float]:
    """GOSPA of first order with alpha = 2, m: the total, and its parts for localisation, missed and false targets.

    A pair is made only where it is cheaper than one missed and one false target (Rahmathullah et al., FUSION 2017, proposition 1).
    """
    if not len(truth) or not len(estimate):
        missed, false = cutoff / 2.0 * len(truth), cutoff / 2.0 * len(estimate)
        return missed + false, 0.0, missed, false
    gain, pairs = _cheapest(cdist(truth, estimate) - cutoff, whole=False)
    localisation = gain + cutoff * pairs
    missed, false = cutoff / 2.0 * (len(truth) - pairs), cutoff / 2.0 * (len(estimate) - pairs)
    return localisation + missed + false, localisation, missed, false


def _cheapest(costs: np.ndarray, *, whole: bool) -> tuple[float, int]:
    """The least cost of an assignment and its number of pairs; `whole`: every row has a partner, otherwise only where that is cheaper."""
    rows, columns = costs.shape
    if not rows:
        return 0.0, 0
    once_a_row, once_a_column = np.kron(np.eye(rows), np.ones(columns)), np.kron(np.ones(rows), np.eye(columns))
    if whole:
        found = linprog(costs.ravel(), A_ub=once_a_column, b_ub=np.ones(columns), A_eq=once_a_row, b_eq=np.ones(rows), bounds=(0, 1))
    else:
        found = linprog(costs.ravel(), A_ub=np.vstack([once_a_row, once_a_column]), b_ub=np.ones(rows + columns), bounds=(0, 1))
    assert found.success, found.message
    chosen = np.round(found.x).reshape(rows, columns) == 1.0
    return float(costs[chosen].sum()), int(chosen.sum())
