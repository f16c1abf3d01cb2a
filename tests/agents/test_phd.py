"""The particle PHD filter against closed forms, a dense grid and its own mass balance."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.config import AgentConfig, BirthSettings, FilterSettings
from agents.tracking.births import Scan, survival_probability
from agents.tracking.particles import NO_PARTICLES, Particles, select, total, unlabelled
from agents.tracking.phd import correct, likelihood_noise, predict, resample, sample_size
from agents.tracking.step import Step
from protocol.random_streams import scramble
from protocol.sensing import Pose, WedgeSensor
from protocol.settings import ArenaSettings, DetectionSettings, RunSettings

ARENA = ArenaSettings(width=40.0, height=40.0)
FILTER = FilterSettings(seed=1)
POINTS = FilterSettings(seed=1, roughening=0.0)  # a particle stands for its own place alone
NO_BIRTH = BirthSettings(measurement=False)
NOISE = 0.25
DISC = WedgeSensor(2.0 * math.pi, 10.0, 0.8)
seeds = st.integers(0, 2**32 - 1)


def cloud(seed: int, count: int, mass: float = 3.0, side: float = 40.0) -> Particles:
    """Random particles in a square, ids ascending, speeds of about 2 m/s."""
    rng = np.random.default_rng(seed)
    weights = rng.random(count)
    weights *= mass / max(weights.sum(), 1e-300)
    ids = np.sort(scramble(np.arange(count, dtype=np.uint64), seed))
    return unlabelled(np.column_stack([rng.random((count, 2)) * side, rng.normal(0.0, 2.0, (count, 2))]), weights, ids)


def scan(detections: list[tuple[float, float]], pose: Pose = (20.0, 20.0, 0.0), sensor: WedgeSensor = DISC, salt: int = 7) -> Scan:
    """A scan with the clutter of the default scenario, 0.1 points in the footprint."""
    points = np.array(detections, dtype=float).reshape(-1, 2)
    return Scan(salt, sensor, pose, points, np.arange(len(points), dtype=np.uint64), 0.1 / sensor.area)


def step(tick: int, filters: FilterSettings = FILTER, birth: BirthSettings = NO_BIRTH) -> Step:
    """A step of half a second in the arena of these tests."""
    detection = DetectionSettings(noise=NOISE)
    return Step(AgentConfig(run=RunSettings(dt=0.5), arena=ARENA, detection=detection, filter=filters, birth=birth), tick)


def correct_all(particles: Particles, scans: list[Scan], birth: BirthSettings = NO_BIRTH, settings: FilterSettings = POINTS) -> Particles:
    """The PHD after all scans of tick 5."""
    return correct(particles, scans, step(5, settings, birth))


def test_a_gaussian_prior_is_corrected_as_the_closed_form_says() -> None:
    """Prior m N(mu, P) with p_d constant around it, all of it one target: one detection z leaves n N(mu, P) + f N(mu', P') with
    f = L / (kappa + L), L = p_d m N(z; mu, P + R), mu' = mu + P / (P + R) (z - mu), P' = P R / (P + R) per axis (Kalman), and
    n = r (1 - p_d) / (1 - r p_d), r = m - f (Bernoulli)."""
    spread, mass, mean, seen = 0.5, 0.7, np.array([20.0, 21.0]), np.array([21.5, 19.5])
    axis = (np.arange(201) - 100) * 0.03  # +-6 standard deviations
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    weights = np.exp(-0.5 * (grid**2).sum(axis=1) / spread**2)
    weights *= mass / weights.sum()
    states = np.column_stack([grid + mean, np.zeros_like(grid)])
    one_target = FilterSettings(vicinity=100.0, roughening=0.0)
    after = correct_all(unlabelled(states, weights, np.arange(len(grid), dtype=np.uint64)), [scan([tuple(seen)])], settings=one_target)
    total = spread**2 + NOISE**2
    likelihood = 0.8 * mass * math.exp(-0.5 * float(((seen - mean) ** 2).sum()) / total) / (2.0 * math.pi * total)
    found = likelihood / (0.1 / DISC.area + likelihood)
    missed = 0.2 * (mass - found) / (1.0 - 0.8 * (mass - found))
    assert 0.1 < found < 0.6  # so that something is missed
    assert after.weights.sum() == pytest.approx(missed + found, rel=1e-6)
    new_mean = mean + spread**2 / total * (seen - mean)
    expected = (missed * mean + found * new_mean) / (missed + found)
    assert after.weights @ after.states[:, :2] / after.weights.sum() == pytest.approx(expected, abs=1e-6)
    second = missed * (spread**2 + (mean - expected) ** 2) + found * (spread**2 * NOISE**2 / total + (new_mean - expected) ** 2)
    variance = after.weights @ (after.states[:, :2] - expected) ** 2
    assert variance == pytest.approx(second, rel=1e-4)


@pytest.mark.parametrize("far", [0.9, 0.1])
def test_particles_agree_with_a_dense_grid_filter(far: float) -> None:
    """Two scans, one with a miss and a false detection: the mass in each square of 4 m, by random particles and by a grid of 0.1 m.

    The second sensor detects with a probability of 0.9 that stays or falls with the distance.
    """
    rng, density = np.random.default_rng(3), 0.002
    wedge = WedgeSensor(math.pi / 2.0, 12.0, 0.9, None, far)
    scans = [scan([(22.1, 21.9), (26.2, 25.8)]), scan([(22.0, 22.2)], (14.0, 20.0, 0.3), wedge)]
    axis = (np.arange(400) + 0.5) * 0.1
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    phd = np.full(len(grid), density)
    for one in scans:
        apart = grid - one.pose[:2]
        ranges, bearings = np.hypot(*apart.T), np.arctan2(apart[:, 1], apart[:, 0]) - one.pose[2]
        falling = one.sensor.prob_detection + (one.sensor.far_probability - one.sensor.prob_detection) * ranges / one.sensor.reach
        probability = falling * ((ranges <= one.sensor.reach) & (np.abs(bearings) <= one.sensor.angle / 2.0))
        corrected = np.zeros_like(phd)
        for detection in one.detections:
            share = phd * probability * np.exp(-0.5 * ((grid - detection) ** 2).sum(axis=1) / NOISE**2) / (2.0 * math.pi * NOISE**2)
            corrected += share / (one.clutter_density + share.sum() * 0.01)
        mass, left = (near_by(grid, values * 0.01) for values in (np.where(probability > 0.0, phd, 0.0), corrected))
        rest = np.maximum(mass - left, 0.0)
        kept = np.where(mass > 0.0, rest / np.where(mass > 0.0, mass, 1.0), 0.0)
        missed = kept * (1.0 - probability) / (1.0 - probability * np.minimum(rest, POINTS.certainty))
        phd = phd * np.where(probability > 0.0, missed, 1.0) + corrected
    square, offset = np.divmod(np.arange(160000), 100)  # 100 particles in each square of 1 m, each at random in its tenth
    corners = np.column_stack([square % 40 + offset % 10 / 10.0, square // 40 + offset // 10 / 10.0])
    states = np.column_stack([corners + 0.1 * rng.random((160000, 2)), np.zeros((160000, 2))])
    after = correct_all(unlabelled(states, np.full(160000, density / 100.0), np.arange(160000, dtype=np.uint64)), scans)
    ours = np.histogram2d(*after.states[:, :2].T, bins=10, range=[[0, 40], [0, 40]], weights=after.weights)[0]
    oracle = np.histogram2d(*grid.T, bins=10, range=[[0, 40], [0, 40]], weights=phd * 0.01)[0]
    assert ours.sum() == pytest.approx(oracle.sum(), rel=0.01)
    assert np.abs(ours - oracle).max() < 0.02
    assert oracle.max() > 0.8  # there was something to find


def near_by(grid: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """The sums of masses (G,) over the 5 x 5 squares of 1 m around each place of a grid (G, 2) in 40 x 40 m."""
    squares = np.histogram2d(*grid.T, bins=40, range=[[0, 40], [0, 40]], weights=masses)[0]
    sums = np.lib.stride_tricks.sliding_window_view(np.pad(squares, 2), (5, 5)).sum(axis=(2, 3))
    columns, rows = np.floor(grid).astype(int).T
    return np.asarray(sums[columns, rows])


@given(seeds, st.integers(0, 60), st.lists(st.tuples(st.floats(8.0, 32.0), st.floats(8.0, 32.0)), max_size=4), st.booleans())
@settings(max_examples=60)
def test_mass_balance_of_a_scan(seed: int, count: int, places: list[tuple[float, float]], births: bool) -> None:
    """Mass after = what was out of view + 1 - kappa / normaliser for every detection, which makes no more than one.

    The sensor misses nothing, so that nothing is left of what is in view and not detected.
    """
    before, one = cloud(seed, count), scan(places, sensor=WedgeSensor(2.0 * math.pi, 10.0, 1.0))
    birth = BirthSettings(measurement=births)
    after = correct_all(before, [one], birth)
    probability = one.sensor.probability(before.states[:, :2], one.pose)
    found = after.weights.sum() - (before.weights * (1.0 - probability)).sum()
    assert -1e-9 <= found <= len(places) + 1e-9
    normalisers, squares = [], [((before.states[:, :2] - place) ** 2).sum(axis=1) for place in one.detections]
    densities = [np.exp(-squared / (2 * NOISE**2)) / (2 * math.pi * NOISE**2) * (squared <= (6 * NOISE) ** 2) for squared in squares]
    evidence = [(before.weights * probability * density).sum() for density in densities]
    for place, squared, found_here in zip(one.detections, squares, evidence):
        fresh = 0.0
        if births:
            mutual = ((one.detections - place) ** 2).sum(axis=1) <= 16.0
            known = sum(other / (one.clutter_density + other) for other, close in zip(evidence, mutual) if close)
            local = (before.weights[squared <= 16.0].sum() - known) / (math.pi * 16.0)
            seen = 1.0 if math.dist(place, (20.0, 20.0)) <= 10.0 else 0.0
            fresh = seen * min(max(local, 0.25 * one.clutter_density), 0.001)
        normalisers.append(one.clutter_density + fresh + found_here)
    assert found == pytest.approx(sum(1.0 - one.clutter_density / norm for norm in normalisers), abs=1e-9)


def test_an_empty_scan_is_information() -> None:
    """Of a target that is there with probability r a miss leaves r (1 - p_d) / (1 - r p_d), of many far apart each its own."""
    places, masses = [(15.5, 20.5), (20.5, 26.5), (20.5, 14.5), (26.5, 20.5), (31.5, 20.5)], np.array([0.001, 0.3, 0.9, 4.0, 0.7])
    after = correct_all(unlabelled(np.hstack([places, np.zeros((5, 2))]), masses, np.arange(5, dtype=np.uint64)), [scan([])])
    sure = np.minimum(masses[:4], POINTS.certainty)
    assert after.weights[:4] == pytest.approx(masses[:4] * 0.2 / (1.0 - 0.8 * sure), rel=1e-12)
    assert after.weights[0] == pytest.approx(0.0002, rel=1e-3)  # as in the PHD filter, where there is little
    assert after.weights[4] == 0.7  # out of view


def test_the_width_of_a_particle_follows_silvermans_rule_for_a_step_of_noise() -> None:
    """h = .4 N^(-1/6) s in the plane, N = 75 particles a target, s = .1 m in each step: .0195 m beside a noise of .05 m."""
    assert likelihood_noise(0.05, FILTER) == pytest.approx(math.hypot(0.05, 0.4 * 0.1 * 75.0 ** (-1.0 / 6.0)), rel=1e-12)
    assert likelihood_noise(0.05, POINTS) == 0.05


def test_scans_of_separate_footprints_commute() -> None:
    here, there = scan([(8.0, 8.0)], (8.0, 8.0, 0.0)), scan([(31.0, 32.0)], (32.0, 32.0, 0.0), salt=8)
    before = cloud(5, 400)
    assert (correct_all(before, [here, there]).weights == correct_all(before, [there, here]).weights).all()


def test_scans_of_one_place_do_not_commute_so_their_order_is_fixed() -> None:
    one, other = scan([(20.0, 20.0)]), scan([(20.4, 20.0), (21.0, 20.0)], (22.0, 20.0, 0.0), salt=8)
    before = cloud(6, 20000, mass=40.0)
    forth, back = correct_all(before, [one, other]).weights, correct_all(before, [other, one]).weights
    assert np.abs(forth - back).max() > 1e-4
    assert forth.sum() == pytest.approx(back.sum(), rel=0.05)


def test_particles_that_a_scan_cannot_reach_keep_their_bits() -> None:
    """The filter of one cell equals the filter of the arena where they overlap: distant particles add exact zeros."""
    before = cloud(7, 500)
    near = np.hypot(before.states[:, 0] - 20.0, before.states[:, 1] - 20.0) <= 14.0
    scans = [scan([(20.0, 20.0), (23.0, 19.0)]), scan([(21.0, 20.0)], (19.0, 18.0, 0.4), salt=8)]
    assert (correct_all(before, scans).weights[near] == correct_all(select(before, near), scans).weights).all()


def test_no_particles_and_no_scans_are_cases() -> None:
    assert len(correct_all(NO_PARTICLES, [scan([(20.0, 20.0)])]).weights) == 0
    assert len(correct_all(NO_PARTICLES, [scan([(20.0, 20.0)])], BirthSettings()).weights) == 10
    before = cloud(8, 5)
    assert all((ours == theirs).all() for ours, theirs in zip(correct_all(before, []), before))


@given(seeds, st.sampled_from(["cross", "reflect"]))
@settings(max_examples=30)
def test_whoever_holds_a_copy_moves_it_to_the_same_place(seed: int, border: str) -> None:
    motion = FilterSettings(border=border)  # type: ignore[arg-type]
    particles, some = cloud(seed, 40), np.random.default_rng(seed).random(40) < 0.5
    whole, part = predict(particles, step(9, motion)), predict(select(particles, some), step(9, motion))
    assert all((ours == theirs).all() for ours, theirs in zip(select(whole, some), part))


def test_prediction_is_a_straight_step_where_there_is_no_noise() -> None:
    still = FilterSettings(heading_noise=0.0, position_noise=0.0, lifetime=0.0)
    particle = unlabelled(np.array([[10.0, 10.0, 1.2, -1.6]]), np.array([0.5]), np.array([3], dtype=np.uint64))
    moved = predict(particle, step(1, still))
    assert moved.states[0] == pytest.approx([10.6, 9.2, 1.2, -1.6])
    assert moved.weights.tolist() == [0.5]


def test_prediction_noise_has_the_moments_of_the_settings() -> None:
    """20000 particles that head east for 0.5 s: heading s.d. 0.3 sqrt(0.5) rad, place s.d. 0.1 m north plus 2 x 0.5 x sin(turn)."""
    count = 20000
    states = np.tile([20.0, 20.0, 2.0, 0.0], (count, 1))
    moved = predict(unlabelled(states, np.ones(count), np.arange(count, dtype=np.uint64)), step(4))
    turns = np.arctan2(moved.states[:, 3], moved.states[:, 2])
    assert turns.mean() == pytest.approx(0.0, abs=4 * 0.21 / math.sqrt(count))
    assert turns.std() == pytest.approx(0.3 * math.sqrt(0.5), rel=0.02)
    assert np.hypot(moved.states[:, 2], moved.states[:, 3]) == pytest.approx(2.0)
    noise = moved.states[:, 1] - 20.0 - 0.5 * moved.states[:, 3]
    assert noise.std() == pytest.approx(0.1, rel=0.02)
    assert moved.weights == pytest.approx(math.exp(-0.5 / 1000.0))


def test_a_particle_that_crosses_the_border_loses_its_mass_or_is_reflected() -> None:
    particle = unlabelled(np.array([[0.2, 10.0, -2.0, 0.0]]), np.ones(1), np.ones(1, dtype=np.uint64))
    quiet = {"heading_noise": 0.0, "position_noise": 0.0, "lifetime": 0.0}
    crossed = predict(particle, step(1, FilterSettings(border="cross", **quiet)))
    mirrored = predict(particle, step(1, FilterSettings(border="reflect", **quiet)))
    assert (crossed.states[0, 0], crossed.weights[0]) == (pytest.approx(-0.8), 0.0)
    assert mirrored.states[0].tolist() == pytest.approx([0.8, 10.0, 2.0, 0.0]) and mirrored.weights[0] == 1.0


@pytest.mark.parametrize(
    ("way", "place", "heading"), [(30.0, 30.0, 1), (70.0, 10.0, -1), (110.0, 30.0, 1), (-50.0, 30.0, 1), (-90.0, 10.0, -1)]
)
def test_a_way_of_several_widths_of_a_closed_arena_is_folded_into_it(way: float, place: float, heading: int) -> None:
    """From x = 0 in 40 m; each wall turns the velocity round."""
    speed = abs(way) / 0.5
    particle = unlabelled(np.array([[0.0, 10.0, math.copysign(speed, way), 0.0]]), np.ones(1), np.ones(1, dtype=np.uint64))
    filters = FilterSettings(border="reflect", heading_noise=0.0, position_noise=0.0, lifetime=0.0, speed=speed)
    moved = predict(particle, step(1, filters))
    assert moved.weights.tolist() == [1.0]
    assert moved.states[0].tolist() == pytest.approx([place, 10.0, heading * math.copysign(speed, way), 0.0])


def test_survival_in_many_short_steps_is_survival_in_one_long_step() -> None:
    assert survival_probability(0.25, FILTER) ** 40 == pytest.approx(survival_probability(10.0, FILTER))
    assert survival_probability(0.25, FilterSettings(lifetime=0.0)) == 1.0


@given(seeds, st.integers(1, 300), st.floats(1e-6, 30.0))
@settings(max_examples=60)
def test_resampling_keeps_the_mass_and_every_parent_its_share(seed: int, count: int, mass: float) -> None:
    """Systematic: a parent of weight w has floor(n w / m) or one more children, n the number of the sample."""
    before = cloud(seed, count, mass)
    after = resample(before, "s3", step(12))
    number = sample_size(total(before.weights), FILTER)
    assert len(after.weights) == number and after.weights.sum() == pytest.approx(mass)
    assert (after.weights == after.weights[0]).all()
    assert (after.ids[1:] > after.ids[:-1]).all()
    assert (after.states == after.states.astype(np.float32)).all()
    rounded = before.states.astype(np.float32).astype(float)
    children = np.array([(after.states == parent).all(axis=1).sum() for parent in rounded])
    shares = number * before.weights / before.weights.sum()
    assert (np.abs(children - shares) < 1.0 + 1e-9).all()


def test_the_first_copy_keeps_its_id_and_the_owner_keeps_what_it_said() -> None:
    before = cloud(9, 3, mass=1.0)
    after = resample(before, "s3", step(12))
    assert len(after.ids) == 75 and set(before.ids.tolist()) <= set(after.ids.tolist())
    again = resample(after, "s3", step(13))
    assert set(again.ids.tolist()) == set(after.ids.tolist())  # equal weights: every particle once


def test_no_mass_leaves_no_particles() -> None:
    assert len(resample(NO_PARTICLES, "s1", step(1)).ids) == 0
    assert len(resample(cloud(1, 5)._replace(weights=np.zeros(5)), "s1", step(1)).ids) == 0


def test_more_mass_than_a_gossip_may_state_is_cut() -> None:
    after = resample(cloud(1, 50, mass=3000.0), "s1", step(1))
    assert after.weights.sum() == pytest.approx(999.0) and len(after.ids) * after.weights[0] <= 1000.0


def test_the_size_of_a_sample_stays_within_its_limits() -> None:
    assert [sample_size(mass, FILTER) for mass in (1e-9, 0.4, 2.0, 1e6)] == [30, 30, 150, 2000]
