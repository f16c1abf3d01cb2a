"""The error of the swarm beside that of one central filter with the same detections, which extracts its targets from the whole arena."""

import math

import pytest

from deploy.scenario import resolve
from deploy.simulation import compiled
from tests.swarm.oracle import Beside


def excess(team: str, seed: int, seconds: float) -> float:
    """Steady OSPA of the swarm over that of the central filter, less 1."""
    options = {"run.seed": seed, "run.seconds": seconds, "run.dt": 0.5, "team.composition": team, "targets.count": 30}
    both = Beside(resolve("efficacy", options), compiled()).run()
    assert len(both.swarm) == len(both.central) == round(seconds / 0.5)
    steady = len(both.swarm) // 5
    return math.fsum(both.swarm[steady:]) / math.fsum(both.central[steady:]) - 1.0


@pytest.mark.slow
def test_the_error_is_within_two_per_cent_of_the_central_filter() -> None:
    assert abs(excess("2", seed=100, seconds=60.0)) <= 0.02


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("team", ["4", "3", "20E+10G"])
def test_it_is_so_for_the_teams_of_the_paper(team: str) -> None:
    found = [excess(team, seed, seconds=150.0) for seed in (100, 101)]
    assert abs(math.fsum(found)) / len(found) <= 0.02, f"--team {team}: {found}"
