"""The filter reports what its detections say: whoever is heard last, however often a sensor misses, with clutter and without."""

import math
from functools import lru_cache
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pytest

from deploy.scenario import resolve
from deploy.scoring.scores import Score
from deploy.simulation import Simulation
from protocol.observer_messages import Truth

SCENE = str(Path(__file__).with_name("eyes.toml"))
SETTLED = 15.0  # s
SEEDS = (1, 2, 3, 4)
GOOD_THEN_BAD, BAD_THEN_GOOD = "G1,B1", "B1,G1"  # in the order of names
CLUTTER = [0.0, pytest.param(0.1, marks=pytest.mark.nightly), pytest.param(1.0, marks=pytest.mark.nightly), 10.0]


def played(team: str, seed: int, **settings: Any) -> Simulation:
    """A run of the scene; settings as section__field."""
    options = {"team.composition": team, "run.seed": seed} | {name.replace("__", "."): value for name, value in settings.items()}
    return Simulation(resolve(SCENE, options))


def scores(team: str, seed: int, **settings: Any) -> list[Score]:
    """Of all settled ticks."""
    simulation = played(team, seed, **settings)
    simulation.run()
    return [score for score in simulation.scorer.scores if score.time >= SETTLED]


@lru_cache
def ospa(team: str, seeds: tuple[int, ...] = SEEDS, clutter: float = 0.1) -> float:
    """Mean over seeds and settled ticks, m."""
    return fmean(score.ospa for seed in seeds for score in scores(team, seed, detection__clutter=clutter))


@lru_cache
def bias(team: str, clutter: float) -> float:
    """Reported targets more than there are, mean over two seeds and settled ticks."""
    return fmean(score.estimated - score.targets for seed in (1, 2) for score in scores(team, seed, detection__clutter=clutter))


def nees(seed: int, **settings: Any) -> float:
    """Of one target before a good eye: mean of d' P^-1 d, of the error d and the covariance P of the particles within 2 m of it."""
    simulation, found = played("G1", seed, targets__count=1, run__seconds=50.0, detection__noise=0.05, **settings), []

    def judge(truth: Truth) -> None:
        target = np.array(truth.targets)[0, :2]
        for agent in simulation.agents.values():
            held = agent.outcome.belief.mine.targets
            near = np.hypot(*(held.states[:, :2] - target).T) < 2.0
            if agent.outcome.belief.tick == truth.tick and truth.time >= SETTLED and near.sum() >= 5:
                apart = held.states[near, :2] - target
                error, spread = apart.mean(axis=0), np.cov(apart.T, ddof=0)
                found.append(float(error @ np.linalg.pinv(spread) @ error))

    simulation.on_truth = judge
    simulation.run()
    assert len(found) > 100
    return fmean(found)


def test_a_tick_of_the_scene_is_seen_by_everybody() -> None:
    simulation = played(GOOD_THEN_BAD, 1, run__seconds=1.0)
    simulation.run()
    assert list(simulation.agents) == ["s1", "s2"]
    assert all(score.in_view == score.targets == 10 for score in simulation.scorer.scores)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.nightly
def test_a_bad_eye_takes_nothing_from_a_good_one_whichever_has_the_later_name() -> None:
    alone = ospa("G1")
    assert ospa(GOOD_THEN_BAD) <= 1.1 * ospa(BAD_THEN_GOOD)
    assert ospa(BAD_THEN_GOOD) <= 1.1 * ospa(GOOD_THEN_BAD)
    assert max(ospa(GOOD_THEN_BAD), ospa(BAD_THEN_GOOD)) <= 1.1 * alone


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_eight_eyes_that_miss_three_in_ten_have_half_the_error_of_one() -> None:
    """The ratio is 0.494 with sixteen seeds; its 95 % interval is 0.464 to 0.524 (docs/evidence/paper.md)."""
    seeds = tuple(range(1, 17))
    assert ospa("M8", seeds) <= 0.5 * ospa("M1", seeds)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("clutter", CLUTTER)
@pytest.mark.parametrize("eye", ["G1", "N1", "M1", "B1"])
def test_as_many_targets_are_reported_as_there_are(eye: str, clutter: float) -> None:
    assert abs(bias(eye, clutter)) <= 0.5


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_no_clutter_is_no_worse_than_hardly_any() -> None:
    assert ospa("N1", clutter=0.0) <= ospa("N1", clutter=1e-9) * (1.0 + 1e-9)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_what_nobody_sees_in_a_closed_arena_keeps_the_mass_of_the_prior() -> None:
    """.001 per m^2 on 1600 m^2, of which 5.8 % die in a minute and are born again."""
    found = scores("L1", 1, targets__count=0, detection__clutter=0.0)
    assert found[-1].time > 59.0
    assert all(math.isclose(score.mass, 1.6, rel_tol=1e-6) and score.estimated == 0 for score in found)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_spread_of_the_particles_is_the_error_of_their_mean() -> None:
    """A normalised error squared of 2 in the plane; noise of .05 m, targets that turn as usual and as the filter believes."""
    found = fmean(nees(seed, targets__heading_noise=noise) for seed in range(1, 5) for noise in (0.2, 0.3))
    assert 1.8 <= found <= 2.4
