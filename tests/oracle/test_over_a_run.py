"""Where dice differ the swarm must agree on average: over 30 seeds within 3 standard errors of a central filter with dice of its own.

The oracle's filter is fed with the observations of recorded runs, over the whole run. Bodies drive to random places: a body that follows
its own particles sees more of their chance clusters than of another filter's, and that alone would be a difference.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from tests.oracle.paper_filter import PaperFilter, Phd
from tests.oracle.recorded import Recorded, recorded
from tests.oracle.said import Tick, wedges_of
from tests.oracle.wedges import Wedge, sees

SIDE = 20.0
SCENE: dict[str, Any] = {
    "team.composition": "A3,C3",
    "arena.width": SIDE,
    "arena.height": SIDE,
    "targets.count": 4,
    "run.seconds": 3.5,
    "control.mode": "random",
    "detection.clutter": 1.0,
    "filter.prior_density": 0.02,
    "filter.particles_per_target": 400,
    "filter.least_particles": 1,
    "birth.most_density": 0.02,
    "birth.measurement_particles": 30,
    "birth.background_particles": 40,
}
SEEDS = 30
SETTLED = 4  # ticks until births and clutter have had their effect
REGIONS = ("the arena", "what nobody sees", "within 1 m of a target", "the western half", "weighted by how near a target is")


def regions(phd: Phd, tick: Tick, sensors: dict[str, Wedge]) -> np.ndarray:
    """Expected targets in each of REGIONS; the last is the PHD smoothed with 0.25 m at the targets, in targets."""
    places = phd.states[:, :2]
    seen = np.any([sees(sensors[name], said.pose, places) for name, said in tick.observations.items()], axis=0)
    targets = tick.truths[0].targets
    apart = np.hypot(places[:, :1] - targets[:, 0], places[:, 1:] - targets[:, 1])
    near = apart.min(axis=1, initial=math.inf) < 1.0
    smooth = float(phd.weights @ np.exp(-0.5 * (apart / 0.25) ** 2).sum(axis=1))
    return np.array([phd.mass(), phd.mass(~seen), phd.mass(near), phd.mass(places[:, 0] < SIDE / 2.0), smooth])


@lru_cache
def run_of(seed: int) -> Recorded:
    """One run of the swarm."""
    return recorded(*(SCENE | {"run.seed": seed}).items())


@lru_cache
def swarm(seed: int) -> np.ndarray:
    """Means over the settled ticks of what the agents say they own together."""
    run = run_of(seed)
    sensors = wedges_of(run.settings)
    pairs = list(zip(run.ticks, run.ticks[1:]))[SETTLED:]
    return np.mean([regions(later.particles(), tick, sensors) for tick, later in pairs], axis=0)


def oracle(seed: int, section: str = "", field: str = "", factor: float = 1.0) -> np.ndarray:
    """The same of the oracle's filter, which is given a setting that is wrong by a factor."""
    run = run_of(seed)
    settings = run.settings | ({section: run.settings[section] | {field: factor * run.settings[section][field]}} if section else {})
    sensors, paper = wedges_of(settings), PaperFilter(settings, seed + 1_000_000)
    found = []
    for tick in run.ticks[:-1]:
        paper.step(tick.scans(settings, sensors))
        found.append(regions(paper.phd, tick, sensors))
    return np.mean(found[SETTLED:], axis=0)


def standard_errors(differences: list[np.ndarray]) -> np.ndarray:
    """How many standard errors the mean of paired differences is from 0, for each region."""
    return np.abs(np.mean(differences, axis=0)) / (np.std(differences, axis=0, ddof=1) / math.sqrt(len(differences)))


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [10, pytest.param(SEEDS, marks=pytest.mark.nightly)])
def test_mass_and_phd_are_within_three_standard_errors_of_the_oracle(seeds: int) -> None:
    apart = standard_errors([swarm(seed) - oracle(seed) for seed in range(seeds)])
    assert (apart <= 3.0).all(), dict(zip(REGIONS, apart.round(1).tolist()))


PLANTED = {
    "kappa x 2": ("detection", "clutter", 2.0),
    "likelihood noise x 2": ("detection", "noise", 2.0),
    "prior and births x 2": ("filter", "prior_density", 2.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("planted", [pytest.param(name, marks=[pytest.mark.nightly] * (name != "kappa x 2")) for name in PLANTED])
def test_a_planted_error_is_found_within_ten_seeds(planted: str) -> None:
    apart = standard_errors([swarm(seed) - oracle(seed, *PLANTED[planted]) for seed in range(10)])
    assert (apart > 3.0).any(), dict(zip(REGIONS, apart.round(1).tolist()))
