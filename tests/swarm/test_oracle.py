"""What the agents own together is what one central filter with all detections would hold: particle by particle, bit by bit."""

import numpy as np
import pytest

from agents.backend import PLAIN
from agents.tracking.particles import unlabelled
from deploy.scenario import Scenario, resolve
from deploy.simulation import compiled
from deploy.verify.central_filter import particle_difference
from tests.swarm.oracle import compare


def swarm(team: str, side: float, targets: int, seconds: float, seed: int = 1, dt: float = 0.25, **others: float) -> Scenario:
    options = {"run.seed": seed, "run.seconds": seconds, "run.dt": dt, "team.composition": team, "targets.count": targets}
    return resolve("efficacy", {**options, "arena.width": side, "arena.height": side, **others})


SMALL = {
    "wide and narrow sensors": ("A2,C4,D2", 50.0, 12),
    "mostly narrow sensors": ("E6,G3", 55.0, 10),
    "short sensors": ("A2,B3,C2", 35.0, 6),
}


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if name != "short sensors" else ()) for name in SMALL])
def test_without_loss_the_swarm_is_the_central_filter_to_the_last_bit(name: str) -> None:
    apart = compare(swarm(*SMALL[name], seconds=30.0), backend=compiled())
    assert len(apart) == 120
    assert [found for found in apart if found != (0, 0, 0.0, 0.0)] == []


@pytest.mark.slow
@pytest.mark.nightly
def test_without_loss_the_plain_arithmetic_is_the_central_filter_too() -> None:
    apart = compare(swarm("A2,B3,C2", 30.0, 5, seconds=25.0, seed=7), backend=PLAIN)
    assert len(apart) == 100 and all(found.exact for found in apart)


def test_poses_that_err_in_place_heading_and_time_are_exact_too() -> None:
    """With a halo as wide as the births are read and the likelihood reaches."""
    noise = {"position_noise": 0.2, "heading_noise": 0.03, "time_noise": 0.1, "memory": 1.0}
    wrong = {"bodies.position_error": 0.2, "bodies.heading_error": 0.03, "bodies.time_error": 0.1, "filter.halo": 15.0}
    options = {f"pose.{name}": value for name, value in noise.items()} | wrong
    apart = compare(swarm("A2,B3,C2", 35.0, 6, seconds=20.0, **options), backend=compiled())
    assert len(apart) == 80
    assert [found for found in apart if found != (0, 0, 0.0, 0.0)] == []


def test_long_ticks_are_exact_too() -> None:
    apart = compare(swarm("E5,H2", 60.0, 12, seconds=50.0, seed=3, dt=0.5), backend=compiled())
    assert len(apart) == 100 and all(found.exact for found in apart)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("team", "ticks"),
    [
        pytest.param("4", 100, id="4ACD", marks=pytest.mark.nightly),
        pytest.param("4", 300, id="4ACD", marks=pytest.mark.nightly),
        pytest.param("20E+10G", 300, id="20E+10G", marks=pytest.mark.nightly),
        pytest.param("A10,B20,C15", 300, id="ABC", marks=pytest.mark.nightly),
    ],
)
def test_the_large_teams_of_the_paper_are_exact_in_every_tick(team: str, ticks: int) -> None:
    apart = compare(swarm(team, 100.0, 30, seconds=0.5 * ticks, dt=0.5), backend=compiled())
    assert len(apart) == ticks and all(found.exact for found in apart)


def test_the_distance_counts_what_differs() -> None:
    states = np.arange(12.0).reshape(3, 4)
    ids = np.array([1, 5, 9], dtype=np.uint64)
    one = unlabelled(states, np.array([0.5, 0.5, 0.5]), ids)
    moved = states.copy()
    moved[1, 0] += 1.0
    other = unlabelled(moved, np.array([0.5, 0.25, 0.5]), np.array([1, 5, 8], dtype=np.uint64))
    assert particle_difference(one, one).exact
    assert particle_difference(one, other) == (2, 1, 0.25, 0.25)
    renamed = one._replace(labels=np.array([0, 3, 0], dtype=np.uint64))
    assert particle_difference(one, renamed) == (0, 1, 0.0, 0.0)
