"""Components that no known target bears: unseen ground keeps the density of the prior, and clutter beyond the border bears nothing."""

import math

import numpy as np
import pytest

from agents.config import AgentConfig, BirthSettings, FilterSettings
from agents.tracking import births, gaussian_phd
from agents.tracking.births import Scan
from agents.tracking.gaussian_belief import filter_step
from agents.tracking.gaussians import EMPTY
from agents.tracking.step import Step
from protocol.sensing import WedgeSensor
from protocol.settings import ArenaSettings, RunSettings
from tests.agents.gossip_table import table

SIDE = 40.0


def config(border: str, birth: BirthSettings, lifetime: float) -> AgentConfig:
    filters = FilterSettings(kind="gaussian-mixture", seed=5, border=border, lifetime=lifetime)  # type: ignore[arg-type]
    return AgentConfig(run=RunSettings(dt=0.5), arena=ArenaSettings(width=SIDE, height=SIDE), filter=filters, birth=birth)


def unseen(settings: AgentConfig, ticks: int) -> list[float]:
    """The mass after each tick of a swarm that sees nothing, as a share of that of the prior."""
    known, found = gaussian_phd.prior(settings), []
    for tick in range(ticks):
        _, known = filter_step(known, table([], config=settings), Step(settings, tick))
        found.append(float(known.weights.sum()) / (settings.filter.prior_density * SIDE * SIDE))
    return found


def test_in_a_closed_arena_unseen_ground_keeps_the_mass_of_the_prior() -> None:
    """4 % of it die in 80 ticks, and are born again in components that are not so light as to be dropped."""
    assert unseen(config("reflect", BirthSettings(), lifetime=1000.0), 80)[-1] == pytest.approx(1.0, abs=0.005)


def test_births_of_too_little_mass_come_seldom_and_together_bring_the_inflow() -> None:
    settings = config("reflect", BirthSettings(), lifetime=1000.0)
    found = [gaussian_phd.background_births(Step(settings, tick)).weights for tick in range(60)]
    assert min(map(min, filter(len, found))) > settings.mixture.pruned
    assert sum(map(sum, found)) == pytest.approx(60 * births.inflow(0.5, settings.filter, settings.arena))


def test_as_much_stays_of_what_crosses_an_open_border_as_leaves() -> None:
    """A birth has the direction of its particle. With an unknown heading besides, a fifth of the mass would be missing."""
    found = unseen(config("cross", BirthSettings(border_share=1.0), lifetime=0.0), 120)
    assert np.mean(found[60:]) == pytest.approx(1.0, abs=0.07)


@pytest.mark.parametrize(("place", "number"), [((-0.5, 20.0), 1), ((-1.0, 20.0), 0), ((20.0, 40.5), 1), ((20.0, 41.0), 0)])
def test_a_detection_far_outside_of_the_arena_is_clutter(place: tuple[float, float], number: int) -> None:
    """The noise is 0.25 m. A footprint reaches beyond the border, and what its clutter bears there would all come to lie on the border."""
    settings = config("cross", BirthSettings(background=False), lifetime=0.0)
    scan = Scan(7, WedgeSensor(2.0 * math.pi, 30.0, 0.9), (20.0, 20.0, 0.0), np.array([place]), np.zeros(1, dtype=np.uint64), 1e-4)
    assert len(gaussian_phd.correct(EMPTY, [scan], Step(settings, 3)).ids) == number
