"""Where new particles come from: the right mass in the right places, and the same for everybody who looks."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.config import AgentConfig, BirthSettings, FilterSettings
from agents.tracking.births import Scan, background_births, birth_density, measurement_births, prior, prior_around
from agents.tracking.particles import NO_PARTICLES, Particles, unlabelled
from agents.tracking.step import Step
from protocol.compact_particles import DIRECTIONS
from protocol.sensing import WedgeSensor
from protocol.settings import ArenaSettings, RunSettings

ARENA = ArenaSettings(width=100.0, height=60.0)
FILTER, BIRTH = FilterSettings(), BirthSettings()
DISC = WedgeSensor(2.0 * math.pi, 10.0, 0.8)


def scan(places: list[tuple[float, float]], numbers: list[int] | None = None) -> Scan:
    """Detections of one sensor, numbered as in the whole scan."""
    points = np.array(places, dtype=float).reshape(-1, 2)
    return Scan(99, DISC, (50.0, 30.0, 0.0), points, np.array(numbers or range(len(points)), dtype=np.uint64), 3e-4)


def step(seed: int, tick: int, filters: FilterSettings = FILTER, birth: BirthSettings = BIRTH) -> Step:
    """A step of half a second in the arena of these tests."""
    seeded = msgspec.structs.replace(filters, seed=seed)
    return Step(AgentConfig(run=RunSettings(dt=0.5), arena=ARENA, filter=seeded, birth=birth), tick)


def born(seed: int, tick: int, filters: FilterSettings, birth: BirthSettings) -> Particles:
    """The background births of half a second in the arena of these tests."""
    return background_births(step(seed, tick, filters, birth))


def test_the_prior_is_uniform_and_has_its_density() -> None:
    particles = prior(1, 4000, FILTER, ARENA)
    assert particles.weights.sum() == pytest.approx(0.001 * 6000.0)
    counts = np.histogram2d(*particles.states[:, :2].T, bins=[5, 3], range=[[0, 100], [0, 60]])[0]
    spread = math.sqrt(4000 / 15 * (1 - 1 / 15))
    assert np.abs(counts - 4000 / 15).max() < 4.5 * spread
    assert np.hypot(particles.states[:, 2], particles.states[:, 3]) == pytest.approx(2.0, rel=1e-6)
    assert (particles.ids[1:] > particles.ids[:-1]).all()


def test_the_prior_around_a_box_is_what_lies_in_the_squares_that_the_box_touches() -> None:
    """Squares of 25 m: the box from (30, 10) to (55, 20) touches those from (25, 0) to (75, 25)."""
    given = 1, 4000, FILTER, ARENA
    everywhere, found = prior(*given), prior_around(*given, (30.0, 10.0, 55.0, 20.0))
    x, y = everywhere.states[:, :2].T
    inside = (x >= 25.0) & (x < 75.0) & (y < 25.0)
    assert found.ids.tolist() == everywhere.ids[inside].tolist() and found.states.tolist() == everywhere.states[inside].tolist()


def test_no_prior_density_no_prior() -> None:
    assert len(prior(1, 100, FilterSettings(prior_density=0.0), ARENA).ids) == 0
    assert len(prior(1, 0, FILTER, ARENA).ids) == 0


def test_background_births_bring_what_flows_in_over_the_border() -> None:
    """density x speed x perimeter / pi per second: 0.001 x 2 x 320 / pi x 0.5 s."""
    births = born(1, 3, FILTER, BIRTH)
    assert births.weights.sum() == pytest.approx(0.001 * 2.0 * 320.0 / math.pi * 0.5)
    assert len(born(1, 3, FILTER, BirthSettings(background=False)).ids) == 0


def test_in_a_closed_arena_as_many_are_born_as_die_and_none_on_the_border() -> None:
    closed = FilterSettings(border="reflect", lifetime=20.0)
    births = born(1, 3, closed, BirthSettings(background_particles=500))
    assert births.weights.sum() == pytest.approx(0.001 * 6000.0 * (1.0 - math.exp(-0.5 / 20.0)))
    assert ((births.states[:, :2] > 0.0) & (births.states[:, :2] < [100.0, 60.0])).all()
    counts = np.histogram(births.states[:, 0], bins=5, range=(0, 100))[0]
    assert np.abs(counts - 100).max() < 4.5 * math.sqrt(80.0)
    immortal = FilterSettings(border="reflect", lifetime=0.0)
    assert len(born(1, 3, immortal, BIRTH).ids) == 0


def test_nine_tenths_are_born_on_the_border_with_headings_inward_by_the_cosine_law() -> None:
    parts = [born(2, tick, FILTER, BirthSettings(background_particles=1000)) for tick in range(8)]
    states = np.concatenate([part.states for part in parts])
    west, east = states[:, 0] == 0.0, states[:, 0] == 100.0
    south, north = states[:, 1] == 0.0, states[:, 1] == 60.0
    assert (west | east | south | north).sum() == 8 * 900
    assert (states[west, 2] > 0).all() and (states[east, 2] < 0).all() and (states[south, 3] > 0).all() and (states[north, 3] < 0).all()
    assert west.sum() == pytest.approx(7200 * 60 / 320, abs=4.5 * math.sqrt(7200 * 60 / 320))
    sines = states[south, 2] / 2.0  # uniform in [-1, 1) under the cosine law: mean 0, variance 1/3
    assert sines.mean() == pytest.approx(0.0, abs=4.5 * math.sqrt(1 / 3 / south.sum()))
    assert (sines**2).mean() == pytest.approx(1 / 3, abs=0.04)


def test_births_of_different_ticks_have_different_ids() -> None:
    ids = np.concatenate([born(1, tick, FILTER, BIRTH).ids for tick in range(50)])
    assert len(set(ids.tolist())) == 50 * BIRTH.background_particles


def test_measurement_births_lie_around_their_detections_and_share_their_mass() -> None:
    births = measurement_births(scan([(50.0, 30.0), (55.0, 31.0)]), np.array([0.01, 0.02]), np.array([8, 9], np.uint64), step(1, 7))
    assert births.weights.tolist() == [0.01] * 10 + [0.02] * 10
    apart = births.states[:, :2] - np.repeat([(50.0, 30.0), (55.0, 31.0)], 10, axis=0)
    assert np.abs(apart).max() < 0.25 * 2.0 * math.sqrt(3.0)
    assert np.hypot(births.states[:, 2], births.states[:, 3]) == pytest.approx(2.0)


def test_a_birth_is_the_same_for_whoever_hears_a_part_of_the_scan() -> None:
    """The number of a detection in the whole scan is its key, not its place among those that matter here."""
    whole = measurement_births(
        scan([(45.0, 30.0), (50.0, 30.0), (55.0, 31.0)]), np.full(3, 0.01), np.arange(3, dtype=np.uint64), step(1, 7)
    )
    part = measurement_births(scan([(55.0, 31.0)], [2]), np.full(1, 0.01), np.full(1, 2, np.uint64), step(1, 7))
    assert (whole.states[20:] == part.states).all() and (whole.ids[20:] == part.ids).all()


@given(st.floats(0.0, 10.0), st.integers(0, 40))
@settings(max_examples=50)
def test_the_birth_density_is_the_local_density_within_its_limits(mass: float, count: int) -> None:
    rng = np.random.default_rng(count)
    angles, ranges = rng.random(count) * 2 * math.pi, rng.random(count) * 3.99
    places = np.column_stack([50.0 + ranges * np.cos(angles), 30.0 + ranges * np.sin(angles)])
    particles = unlabelled(
        np.column_stack([places, np.zeros((count, 2))]), np.full(count, mass / max(count, 1)), np.arange(count, dtype=np.uint64)
    )
    found = birth_density(particles, scan([(50.0, 30.0)]), np.zeros(1), BIRTH)[0]
    local = mass / (math.pi * 16.0) if count else 0.0
    assert found == pytest.approx(min(max(local, 0.25 * 3e-4), 0.001))


def test_what_explains_a_detection_is_no_target_without_particles() -> None:
    """A sure target within 4 m of two detections, one of which it explains for .98: what is left is .02, over 16 pi m^2."""
    sure = unlabelled(np.array([[50.0, 30.0, 0.0, 0.0]]), np.array([1.0]), np.array([1], dtype=np.uint64))
    places = scan([(50.0, 30.0), (53.0, 30.0), (58.0, 30.0)])
    found = birth_density(sure, places, np.array([0.98, 0.0, 0.0]), BIRTH)
    assert found == pytest.approx([0.02 / (16.0 * math.pi), 0.02 / (16.0 * math.pi), 0.25 * 3e-4])


@pytest.mark.parametrize(
    ("clutter_density", "least"), [(0.0, 1e-5), (1e-9, 1e-5), (4e-4, 1e-4), (1.0, 5e-4)], ids=["none", "hardly any", "usual", "much"]
)
def test_the_least_birth_density_follows_the_clutter_within_limits(clutter_density: float, least: float) -> None:
    quiet = scan([(50.0, 30.0)])._replace(clutter_density=clutter_density)
    assert birth_density(NO_PARTICLES, quiet, np.zeros(1), BIRTH) == pytest.approx([least], rel=1e-12)


def test_birth_densities_without_particles_detections_or_births() -> None:
    assert birth_density(NO_PARTICLES, scan([(50.0, 30.0)]), np.zeros(1), BIRTH).tolist() == [0.25 * 3e-4]
    assert birth_density(NO_PARTICLES, scan([]), np.zeros(0), BIRTH).shape == (0,)
    assert birth_density(NO_PARTICLES, scan([(50.0, 30.0)]), np.zeros(1), BirthSettings(measurement=False)).tolist() == [0.0]


def test_directions_are_unit_vectors_all_around() -> None:
    assert np.hypot(*DIRECTIONS.T) == pytest.approx(1.0)
    assert DIRECTIONS.sum(axis=0) == pytest.approx([0.0, 0.0], abs=1e-9)
