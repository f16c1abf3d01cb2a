"""The errors that a run reports are those of linear programs over its recorded truth and estimates, to 1e-9 m."""

from itertools import permutations

import numpy as np
import pytest

from tests.oracle.recorded import recorded
from tests.oracle.scores import gospa, ospa

SCENE = {"team.composition": "A3,C3", "arena.width": 24.0, "arena.height": 24.0, "targets.count": 7, "run.seconds": 8.0}


def test_ospa_and_gospa_of_a_run_are_those_of_the_cheapest_assignments() -> None:
    run = recorded(*SCENE.items())
    assert len(run.scores) == len(run.ticks) == 32
    for tick, score in zip(run.ticks, run.scores):
        truth, estimates = tick.truths[0].targets, np.vstack([estimate.targets for estimate in tick.estimates.values()])
        assert score.tick == tick.truths[0].tick and score.estimated == len(estimates)
        assert abs(ospa(truth, estimates) - score.ospa) <= 1e-9
        said = (score.gospa, score.localisation, score.missed, score.false)
        assert np.abs(np.array(gospa(truth, estimates)) - said).max() <= 1e-9
    assert max(score.estimated for score in run.scores) >= 3 and max(score.false for score in run.scores) > 0.0


@pytest.mark.parametrize(("targets", "estimates"), [(0, 0), (0, 3), (4, 0), (2, 5), (5, 3), (4, 4)])
def test_the_linear_programs_find_what_trying_all_permutations_finds(targets: int, estimates: int) -> None:
    dice = np.random.default_rng(10 * targets + estimates)
    truth, estimate = dice.uniform(0.0, 20.0, (targets, 2)), dice.uniform(0.0, 20.0, (estimates, 2))
    few, many = sorted((truth, estimate), key=len)
    costs = np.minimum(np.hypot(few[:, :1] - many[:, 0], few[:, 1:] - many[:, 1]), 10.0)
    sums = [sum(costs[row, column] for row, column in enumerate(order)) for order in permutations(range(len(many)), len(few))]
    best = min(sums) + 10.0 * (len(many) - len(few))
    assert abs(ospa(truth, estimate) * max(len(many), 1) - best) <= 1e-9
    assert abs(gospa(truth, estimate)[0] - (min(sums) + 5.0 * (len(many) - len(few)))) <= 1e-9
