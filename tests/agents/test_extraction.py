"""Target extraction: what counts as a target, where it is put, and what is left."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.config import ExtractionSettings
from agents.tracking.extraction import estimate_targets
from agents.tracking.particles import NO_PARTICLES, Particles, unlabelled

seeds = st.integers(0, 2**32 - 1)


def blob(x: float, y: float, mass: float, count: int = 50, spread: float = 0.3, seed: int = 1) -> np.ndarray:
    """Rows x, y, weight around a place, their mean exactly there."""
    rng = np.random.default_rng(seed)
    offsets = rng.normal(0.0, spread, (count, 2)).clip(-2 * spread, 2 * spread)
    offsets -= offsets.mean(axis=0)
    return np.column_stack([offsets + np.array([x, y]), np.full(count, mass / count)])


def particles(*rows: np.ndarray) -> Particles:
    """Particles of rows x, y, weight."""
    table = np.concatenate(rows)
    states = np.column_stack([table[:, :2], np.zeros((len(table), 2))])
    return unlabelled(states, table[:, 2], np.arange(len(table), dtype=np.uint64))


def test_no_particles_no_targets() -> None:
    assert estimate_targets(NO_PARTICLES).positions.shape == (0, 2)


def test_a_target_of_mass_one_is_found_at_its_mean() -> None:
    found = estimate_targets(particles(blob(20.5, 31.5, 1.0))).positions
    assert found == pytest.approx(np.array([[20.5, 31.5]]))


@pytest.mark.parametrize(("mass", "number"), [(0.49, 0), (0.51, 1), (1.45, 1), (1.55, 2), (2.6, 3)])
def test_mass_within_five_metres_is_rounded_to_a_number_of_targets(mass: float, number: int) -> None:
    assert len(estimate_targets(particles(blob(20.5, 31.5, mass))).positions) == number


def test_a_lower_threshold_finds_fainter_targets() -> None:
    assert len(estimate_targets(particles(blob(20.5, 31.5, 0.45)), ExtractionSettings(threshold=0.4)).positions) == 1


def test_what_is_left_beside_an_estimate_needs_the_mass_of_beside() -> None:
    """1.45 in one place: .45 is left. Twenty metres away .45 is an estimate of its own."""
    rows = blob(20.5, 31.5, 1.45)
    found = [
        len(estimate_targets(particles(rows), ExtractionSettings(threshold=0.4, beside=beside)).positions) for beside in (0.0, 0.4, 0.5)
    ]
    assert found == [2, 2, 1]
    apart = particles(rows, blob(40.5, 31.5, 0.45, seed=2))
    assert len(estimate_targets(apart, ExtractionSettings(threshold=0.4, beside=0.5)).positions) == 2


def test_targets_apart_are_found_apart_the_heaviest_first() -> None:
    found = estimate_targets(particles(blob(5.5, 5.5, 0.8), blob(30.5, 5.5, 1.2, seed=2), blob(5.5, 30.5, 0.3, seed=3))).positions
    assert found == pytest.approx(np.array([[30.5, 5.5], [5.5, 5.5]]))


def test_two_targets_four_metres_apart_are_both_found_near_their_places() -> None:
    found = estimate_targets(particles(blob(20.5, 20.5, 1.0), blob(24.5, 20.5, 1.0, seed=2))).positions
    assert sorted(found[:, 0].tolist()) == pytest.approx([20.5, 24.5], abs=0.3)
    assert found[:, 1] == pytest.approx(20.5, abs=0.3)


def test_places_below_zero_and_bins_of_other_sizes() -> None:
    found = estimate_targets(particles(blob(-7.5, -3.5, 1.0)), ExtractionSettings(bin=0.5)).positions
    assert found == pytest.approx(np.array([[-7.5, -3.5]]), abs=0.1)


@given(seeds, st.integers(1, 80), st.floats(0.0, 12.0))
@settings(max_examples=60)
def test_there_are_at_most_two_targets_for_each_unit_of_mass_and_all_lie_among_the_particles(seed: int, count: int, mass: float) -> None:
    """A peak holds at least 0.5 and loses that much or one unit."""
    rng = np.random.default_rng(seed)
    weights = rng.random(count)
    cloud = particles(np.column_stack([rng.random((count, 2)) * 30.0, weights / weights.sum() * mass]))
    found = estimate_targets(cloud).positions
    assert len(found) <= 2.0 * mass + 1e-9
    assert ((found >= cloud.states[:, :2].min(axis=0) - 1e-9) & (found <= cloud.states[:, :2].max(axis=0) + 1e-9)).all()


@given(seeds, st.integers(-20, 20), st.integers(-20, 20))
@settings(max_examples=40)
def test_whole_bins_of_shift_shift_the_targets(seed: int, east: int, north: int) -> None:
    rng = np.random.default_rng(seed)
    rows = np.column_stack([np.round(rng.random((60, 2)) * 20.0, 2) + 0.003, rng.random(60) / 10.0])
    found, shifted = estimate_targets(particles(rows)).positions, estimate_targets(particles(rows + np.array([east, north, 0.0]))).positions
    assert shifted == pytest.approx(found + np.array([east, north]), abs=1e-6)
