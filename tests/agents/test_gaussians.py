"""The Gaussian-mixture PHD against numbers by hand and closed forms: motion, correction, splitting, merging, dropping, extraction."""

import math
import tracemalloc

import numpy as np
import pytest

from agents.backend import PLAIN
from agents.config import AgentConfig, BirthSettings, FilterSettings, MixtureSettings
from agents.tracking import gaussian_belief, gaussian_phd
from agents.tracking.births import Scan
from agents.tracking.claims import NO_CLAIM, Claim, make_claim
from agents.tracking.gaussian_belief import MixturePhd
from agents.tracking.gaussian_reduction import ALIKE, STRIP, _near_pairs, estimate_and_label, limited, merged
from agents.tracking.gaussians import (
    EMPTY,
    Mixture,
    clamped,
    packed,
    quadrature_mean,
    quadrature_points,
    unpacked,
    weighted_points,
)
from agents.tracking.particles import canonical, join, select
from agents.tracking.step import Step
from agents.tracking.tracker import Belief, OwnedState
from protocol.fields import pack
from protocol.gaussian_components import check_components
from protocol.messages import Gossip
from protocol.sensing import MeasurementModel, Pose, WedgeSensor
from protocol.settings import ArenaSettings, DetectionSettings, RunSettings
from tests.agents.gossip_table import table

ARENA = ArenaSettings(width=40.0, height=40.0)
STRAIGHT = FilterSettings(kind="gaussian-mixture", speed=2.0, heading_noise=0.0, position_noise=0.0, lifetime=0.0)
NO_BIRTH = BirthSettings(measurement=False, background=False)
DISC = WedgeSensor(2.0 * math.pi, 10.0, 0.8)


def config(filters: FilterSettings = STRAIGHT, birth: BirthSettings = NO_BIRTH) -> AgentConfig:
    return AgentConfig(run=RunSettings(dt=0.5), arena=ARENA, filter=filters, birth=birth, detection=DetectionSettings(noise=1.0))


def component(
    x: float, y: float, place: float, weight: float = 1.0, velocity: tuple[float, float] = (2.0, 0.0), id: int = 1, label: int = 0
) -> Mixture:
    """One component with the variance `place` m^2 on each axis and a sure velocity."""
    covariance, numbers = np.diag([place, place, 1e-6, 1e-6])[None], (np.array([number], dtype=np.uint64) for number in (id, label))
    return Mixture(np.array([weight]), np.array([[x, y, *velocity]]), covariance, *numbers)


def scan(detections: list[tuple[float, float]], pose: Pose = (20.0, 20.0, 0.0), clutter: float = 0.0, sensor: WedgeSensor = DISC) -> Scan:
    places = np.array(detections, dtype=float).reshape(-1, 2)
    return Scan(7, sensor, pose, places, np.arange(len(places), dtype=np.uint64), clutter)


# ---------------------------------------------------------------------- motion


def test_a_component_moves_by_its_velocity_and_its_place_spreads_by_the_spread_of_the_velocity() -> None:
    one = component(10.0, 20.0, 1.0)
    one.covariances[0, 2:, 2:] = np.diag([0.5, 0.5])
    moved = gaussian_phd.predict(one, Step(config(), 3))
    scale = 2.0 / math.sqrt(2.0**2 + 0.5 + 0.5)  # of the velocity, to the speed that all targets have
    assert moved.means[0] == pytest.approx([10.0 + 0.5 * 2.0 * scale, 20.0, 2.0 * scale, 0.0])
    assert moved.covariances[0, :2, :2] == pytest.approx(np.diag([1.0 + 0.25 * 0.5 * scale**2] * 2))
    assert moved.covariances[0, :2, 2:] == pytest.approx(np.diag([0.5 * 0.5 * scale**2] * 2))


def test_a_heading_that_walks_has_the_moments_of_a_normal_turn() -> None:
    filters = FilterSettings(speed=2.0, heading_noise=0.4, position_noise=0.1, lifetime=100.0)
    moved = gaussian_phd.predict(component(10.0, 20.0, 1.0), Step(config(filters), 3))
    variance = 0.4**2 * 0.5
    draws = np.random.default_rng(5).normal(0.0, math.sqrt(variance), 400_000)
    velocities = 2.0 * np.column_stack([np.cos(draws), np.sin(draws)])
    assert moved.means[0, 2:] == pytest.approx(velocities.mean(axis=0), abs=5e-3)
    assert moved.covariances[0, 2:, 2:] == pytest.approx(np.cov(velocities.T), abs=5e-3)
    assert moved.means[0, 2] == pytest.approx(2.0 * math.exp(-variance / 2.0))
    assert moved.covariances[0, 0, 0] == pytest.approx(1.0 + 0.25 * moved.covariances[0, 2, 2] + 0.01, rel=1e-5)
    assert moved.weights[0] == pytest.approx(math.exp(-0.5 / 100.0))


@pytest.mark.parametrize(("border", "left"), [("cross", []), ("reflect", [(0.5, 2.0)])])
def test_a_component_that_crosses_the_border_is_gone_or_turns_round(border: str, left: list[tuple[float, float]]) -> None:
    filters = FilterSettings(speed=2.0, heading_noise=0.0, position_noise=0.0, lifetime=0.0, border=border)  # type: ignore[arg-type]
    moved = gaussian_phd.predict(component(0.5, 20.0, 1.0, velocity=(-2.0, 0.0)), Step(config(filters), 3))
    assert [(x, vx) for x, _, vx, _ in moved.means.round(5).tolist()] == left


def test_what_turns_round_keeps_place_and_velocity_in_step() -> None:
    filters = FilterSettings(speed=2.0, heading_noise=0.0, position_noise=0.0, lifetime=0.0, border="reflect")
    one = component(-0.5, 20.0, 1.0, velocity=(-2.0, 0.0))
    one.covariances[0] = np.array([[1.0, 0.3, 0.5, 0.0], [0.3, 1.0, 0.0, 0.2], [0.5, 0.0, 1.0, 0.0], [0.0, 0.2, 0.0, 1.0]])
    turned = gaussian_phd._in_arena(one, Step(config(filters), 3)).covariances[0]
    assert (turned[0, 2], turned[0, 1], turned[1, 3]) == (0.5, -0.3, 0.2)


def test_a_wide_component_splits_along_its_long_axis_and_keeps_mass_mean_and_covariance() -> None:
    wide = component(20.0, 20.0, 1.0, weight=0.4, velocity=(0.0, 0.0))
    wide.covariances[0] = np.array([[40.0, 10.0, 3.0, 0.0], [10.0, 20.0, 0.0, 1.0], [3.0, 0.0, 2.0, 0.0], [0.0, 1.0, 0.0, 2.0]])
    halves = gaussian_phd._split(wide, Step(config(), 3))
    assert len(halves.ids) == 2 and halves.weights.tolist() == [0.2, 0.2] and halves.ids[0] == 1
    whole = sum(0.5 * (c + np.outer(m - wide.means[0], m - wide.means[0])) for m, c in zip(halves.means, halves.covariances))
    assert whole == pytest.approx(wide.covariances[0])
    assert halves.means.mean(axis=0) == pytest.approx(wide.means[0])
    axis = np.linalg.eigh(wide.covariances[0, :2, :2])[1][:, 1]
    apart = halves.means[0, :2] - halves.means[1, :2]
    assert abs(apart @ axis) == pytest.approx(np.hypot(*apart))
    assert np.hypot(*apart) == pytest.approx(2.0 * 0.7 * math.sqrt(np.linalg.eigvalsh(wide.covariances[0, :2, :2])[1]))
    assert np.all(np.linalg.eigvalsh(halves.covariances) > 0.0)


# ---------------------------------------------------------------------- correction


def test_one_detection_corrects_one_component_as_a_kalman_filter_does() -> None:
    found = gaussian_phd.correct(component(20.0, 20.0, 3.0), [scan([(22.0, 20.0)])], Step(config(), 3))
    heaviest = int(found.weights.argmax())
    assert found.means[heaviest, :2] == pytest.approx([20.0 + 3.0 / 4.0 * 2.0, 20.0])  # gain 3 / (3 + 1)
    assert found.covariances[heaviest, :2, :2] == pytest.approx(np.diag([0.75, 0.75]))
    assert found.weights[heaviest] == pytest.approx(1.0)  # no clutter and no births: the detection is this target
    assert len(found.ids) == 1  # and nothing is left of the missed one


def test_the_noise_of_ranges_and_bearings_lies_along_and_across_the_ray() -> None:
    """Against draws of the sensor: a target 10 m away at 45 degrees, sigma .1 m and .05 rad, the own heading unsure by .03 rad."""
    sensor = WedgeSensor(2.0 * math.pi, 20.0, 0.9, MeasurementModel("range-bearing", bearing_noise=0.05, range_noise=0.1))
    ray = np.array([[math.sqrt(0.5), math.sqrt(0.5), 10.0, 0.0]])
    place = 20.0 + 10.0 * math.sqrt(0.5)
    one = scan([(place, place)], sensor=sensor)._replace(rays=ray, pose_noise=(0.0, 0.03))
    rng = np.random.default_rng(8)
    far, angle = 10.0 + rng.normal(0.0, 0.1, 200_000), 0.25 * math.pi + rng.normal(0.0, math.hypot(0.05, 0.03), 200_000)
    drawn = np.cov(np.array([far * np.cos(angle), far * np.sin(angle)]))
    assert gaussian_phd.measured_covariances(one, AgentConfig())[0] == pytest.approx(drawn, abs=0.005)
    assert drawn[0, 1] < -0.15


def test_a_detection_shares_its_weight_among_two_components_and_the_clutter() -> None:
    kappa = 0.01
    two = join([component(19.0, 20.0, 3.0, weight=0.6), component(22.0, 20.0, 1.0, weight=0.5, id=2)])
    found = gaussian_phd.correct(two, [scan([(20.0, 20.0)], clutter=kappa)], Step(config(), 3))
    first = 0.6 * 0.8 * math.exp(-0.5 / 4.0) / (2.0 * math.pi * 4.0)
    second = 0.5 * 0.8 * math.exp(-0.5 * 4.0 / 2.0) / (2.0 * math.pi * 2.0)
    gained = found.weights[[not any(np.array_equal(mean, old) for old in two.means) for mean in found.means]]
    assert gained == pytest.approx([first / (kappa + first + second), second / (kappa + first + second)])


def test_a_sure_target_that_is_missed_loses_little_and_an_unsure_one_what_bayes_says() -> None:
    for weight in (0.999, 0.3):
        found = gaussian_phd.correct(component(20.0, 20.0, 0.01, weight=weight), [scan([])], Step(config(), 3))
        assert found.weights[0] == pytest.approx(weight * (1.0 - 0.8) / (1.0 - 0.8 * weight))


def test_a_birth_beside_a_component_explains_a_part_of_it() -> None:
    whole, seen, place = component(20.0, 20.0, 0.01, weight=0.6), np.full((1, 9), 0.8), np.array([[20.5, 20.0]])
    found = gaussian_phd.missed(whole, seen, np.array([0.1]), place, np.array([0.2]), config())
    assert found.weights == pytest.approx([0.3 * (1.0 - 0.8) / (1.0 - 0.8 * 0.3)])  # 0.3 of 0.6 is explained


def test_a_component_out_of_view_stays_as_it_is() -> None:
    far = component(35.0, 20.0, 0.5)
    found = gaussian_phd.correct(far, [scan([(20.0, 20.0)])], Step(config(), 3))
    assert all(np.array_equal(one, other) for one, other in zip(found, far))


def test_a_light_component_that_is_hardly_seen_stays_until_components_are_merged() -> None:
    light = join([component(20.0, 20.0, 0.5, weight=0.5e-4), component(31.5, 20.0, 0.5, weight=0.5e-4, id=2)])
    assert gaussian_phd.correct(light, [scan([])], Step(config(), 3)).ids.tolist() == [2]


def test_a_component_across_the_edge_of_the_footprint_moves_to_the_part_that_was_not_seen() -> None:
    sure = WedgeSensor(2.0 * math.pi, 10.0, 1.0)
    across = component(30.0, 20.0, 4.0, weight=0.1)  # the disc ends at x = 30
    across.covariances[0, 0, 2] = across.covariances[0, 2, 0] = 1e-3
    found = gaussian_phd.correct(across, [scan([], sensor=sure)], Step(config(), 3))
    assert len(found.ids) == 1 and 0.02 < found.weights[0] < 0.09
    assert found.means[0, 0] > 30.5 and found.means[0, 1] == pytest.approx(20.0)
    assert found.covariances[0, 0, 0] < 4.0 and found.means[0, 2] > 2.0


def test_the_velocity_follows_the_place_by_regression_on_both_axes() -> None:
    rng = np.random.default_rng(3)
    root, factors = rng.normal(size=(4, 4)), 0.5 + rng.random((1, 9))
    old, before = root @ root.T + np.eye(4), component(20.0, 20.0, 1.0)
    after = gaussian_phd._reshaped(before._replace(covariances=old[None]), factors / quadrature_mean(factors)[:, None])
    follow, new, moved = old[2:, :2] @ np.linalg.inv(old[:2, :2]), after.covariances[0], (after.means - before.means)[0]
    assert np.abs(moved[:2]).min() > 0.01 and moved[2:] == pytest.approx(follow @ moved[:2])
    assert new[2:, :2] == pytest.approx(follow @ new[:2, :2]) and new == pytest.approx(new.T)
    assert new[2:, 2:] == pytest.approx(old[2:, 2:] + follow @ (new - old)[:2, :2] @ follow.T)


def test_a_birth_has_the_noise_of_the_sensor_and_the_share_of_the_least_density() -> None:
    kappa, birth = 0.001, BirthSettings(background=False)
    found = gaussian_phd.correct(EMPTY, [scan([(20.0, 20.0)], clutter=kappa)], Step(config(birth=birth), 3))
    density = 0.25 * kappa
    assert found.weights == pytest.approx([0.8 * density / (kappa + 0.8 * density)])
    assert found.means[0].tolist() == [20.0, 20.0, 0.0, 0.0]
    assert found.covariances[0] == pytest.approx(np.diag([1.0, 1.0, 2.0, 2.0]))


# ---------------------------------------------------------------------- fewer components


def test_two_close_components_become_one_of_the_same_mass_mean_and_covariance() -> None:
    two = join([component(10.0, 10.0, 1.0, weight=0.3), component(11.0, 10.0, 1.0, weight=0.1, id=2)])
    one = merged(two, MixtureSettings())
    assert one.weights == pytest.approx([0.4]) and one.ids.tolist() == [1]
    assert one.means[0] == pytest.approx([10.25, 10.0, 2.0, 0.0])
    assert one.covariances[0, 0, 0] == pytest.approx(1.0 + 0.75 * 0.25**2 + 0.25 * 0.75**2)
    assert one.covariances[0, 1, 1] == pytest.approx(1.0)
    assert merged(select(two, np.array([1, 0])), MixtureSettings()).ids.tolist() == [1]


def test_components_without_weight_are_dropped_before_any_are_merged() -> None:
    """Where hardly anything survives a tick, weights underflow: their shares of a mass of 0 were no numbers."""
    places = ((10.0, 0.0), (30.0, 0.3), (10.5, 0.0))
    three = join([component(x, 10.0, 1.0, weight=weight, id=number) for number, (x, weight) in enumerate(places, 1)])
    with np.errstate(all="raise"):
        assert merged(three, MixtureSettings()).ids.tolist() == [2]


def test_components_far_apart_in_place_in_velocity_or_in_size_stay_two() -> None:
    first = component(10.0, 10.0, 1.0, weight=0.3)
    for other in (
        component(12.0, 10.0, 1.0, id=2),
        component(10.0, 10.0, 1.0, velocity=(-2.0, 0.0), id=2),
        component(10.0, 10.0, 10.0, id=2),
    ):
        assert len(merged(join([first, other]), MixtureSettings()).ids) == 2


def test_a_difference_below_the_precision_of_the_wire_does_not_decide_what_merges() -> None:
    places = [(10.0, 1), (11.5, 2), (13.0, 3)]
    even, uneven = ([component(x, 5.0, 1.0, weight=0.5 + grown * id, id=id) for x, id in places] for grown in (0.0, 1e-12))
    found = [canonical(merged(join(parts), MixtureSettings())).means[:, 0] for parts in (even, uneven)]
    assert len(found[0]) == 2 and found[1] == pytest.approx(found[0])


def test_of_too_many_components_the_heaviest_are_kept_with_the_mass_of_all() -> None:
    mixture = join([component(float(x), 1.0, 1.0, weight=weight, id=x) for x, weight in ((1, 0.5), (2, 1e-6), (3, 0.3), (4, 0.2))])
    left = limited(mixture, 2)
    assert left.ids.tolist() == [1, 3]
    assert left.weights.sum() == pytest.approx(mixture.weights.sum()) and left.weights[0] / left.weights[1] == pytest.approx(5.0 / 3.0)


def test_components_of_more_mass_than_a_gossip_may_state_are_scaled_down() -> None:
    mixture = join([component(float(x), 1.0, 1.0, weight=weight, id=x) for x, weight in ((1, 900.0), (2, 300.0))])
    left = limited(mixture, 1000)
    assert left.ids.tolist() == [1, 2] and left.weights.tolist() == pytest.approx([749.25, 249.75])
    check_components(packed(left).tobytes())


def test_an_estimate_is_a_peak_of_at_least_the_threshold_and_two_targets_are_two() -> None:
    parts = [(10.0, 0.3, 1), (10.5, 0.3, 2), (20.0, 0.4, 3), (30.0, 1.8, 4)]
    mixture = join([component(x, 5.0, 0.1, weight=weight, id=number) for x, weight, number in parts])
    assert estimate_and_label(mixture, 0.5, 0.0, 2.0)[0].positions == pytest.approx(np.array([[30.0, 5.0], [30.0, 5.0], [10.25, 5.0]]))


# ---------------------------------------------------------------------- labels


def test_a_detection_of_something_new_founds_a_label_and_one_beside_a_track_bears_the_label_of_the_track() -> None:
    track = component(20.0, 20.0, 1.0, weight=0.9, label=77)
    step = Step(config(birth=BirthSettings(background=False)), 3)
    found = gaussian_phd.correct(track, [scan([(20.5, 20.0), (27.0, 20.0)], clutter=0.001)], step)
    beside = found.means[:, 0] < 25.0
    assert found.labels[beside].tolist() == [77, 77, 77]  # as missed, as detected, and a birth
    (founded,) = found.labels[~beside].tolist()
    assert founded >> 29 == 4 and founded & 1 == 1  # the tick plus one


def test_a_component_without_a_label_takes_that_of_its_detection() -> None:
    found = gaussian_phd.correct(component(20.0, 20.0, 1.0), [scan([(20.5, 20.0)])], Step(config(birth=BirthSettings(background=False)), 3))
    heaviest = int(found.weights.argmax())
    assert len(found.ids) >= 1 and found.labels[heaviest] >> np.uint64(29) == 4


def test_moving_and_splitting_keep_labels_and_a_merged_component_has_that_of_the_heavier_one() -> None:
    wide = component(20.0, 20.0, 40.0, label=77)
    assert gaussian_phd.predict(wide, Step(config(), 3)).labels.tolist() == [77, 77]
    two = join([component(10.0, 10.0, 1.0, weight=0.3, label=5), component(10.5, 10.0, 1.0, weight=0.1, id=2, label=3)])
    assert merged(two, MixtureSettings()).labels.tolist() == [5]


def test_no_two_estimates_have_one_label_and_the_components_of_the_second_take_the_new_one() -> None:
    places = [(10.0, 0.9, 1), (20.0, 0.8, 2), (20.4, 0.1, 3), (30.0, 0.7, 4)]
    parts = [component(x, 5.0, 0.1, weight=weight, id=number, label=9 if x < 25.0 else 0) for x, weight, number in places]
    estimates, mixture = estimate_and_label(join(parts), 0.5, 0.0, 2.0)
    first, second, third = estimates.labels.tolist()
    assert first == 9 and second not in (0, 9) and third == 0
    assert mixture.labels.tolist() == [9, second, second, 0]


# ---------------------------------------------------------------------- the belief of an agent


def halves(border: float) -> list[Claim]:
    """The claims of two agents that share the arena, with a border at x = `border` m."""
    places = np.array([[border - 5.0, 20.0, 1.0], [border + 5.0, 20.0, 1.0]])
    return [make_claim(names, places[rows]) for names, rows in ((("a", "b"), [0, 1]), (("b", "a"), [1, 0]))]


def test_what_the_agents_hold_together_does_not_depend_on_their_cells() -> None:
    """40 components in one cell, or divided between two."""
    parts = [component(4.0 + 8.0 * (n % 5), 2.5 + 5.0 * (n // 5), 1.0, weight=1e-3 * n + 1e-3, id=n) for n in range(40)]
    whole = join(parts)
    for border in (20.0, 34.9, 39.0):
        taken = [gaussian_belief.take(whole, claim, Step(config(), 3)) for claim in halves(border)]
        together = canonical(join(taken))
        assert all(np.array_equal(one, other) for one, other in zip(together, whole))


def test_an_agent_that_skipped_rounds_moves_its_components_and_its_copies_as_one_mixture() -> None:
    """Two components at the border merge, on whichever side each of them was."""
    close = [component(19.9, 20.0, 1.0, weight=0.3, velocity=(0.0, 2.0)), component(20.3, 20.0, 1.0, weight=0.2, velocity=(0.0, 2.0), id=2)]
    step, tracker, held = Step(config(), 6), MixturePhd(PLAIN), []
    for number, claim in enumerate(halves(20.1)):
        mine = OwnedState(claim.names[0], claim, close[number], 1)
        held.append(tracker.keep_claim(Belief(3, mine, close[1 - number], frozenset("ab")), step))
    assert [len(one.mine.targets.ids) for one in held] == [1, 0] and [len(one.copies.ids) for one in held] == [0, 1]
    assert all(np.array_equal(one, other) for one, other in zip(held[0].mine.targets, held[1].copies))
    assert held[0].mine.targets.weights == pytest.approx([0.5]) and held[0].claim_tick == 3


def gossip_of_scan(pose: Pose, detections: list[tuple[float, float]]) -> Gossip:
    """A gossip that states a scan and nothing else."""
    places = pack(np.array(detections), "<f4")
    return Gossip(sender="a", incarnation=1, tick=5, pose=pose, cod=pose[:2], power_radius=1.0, unused=1.0, detections_bytes=places)


def after(mixture: Mixture, settings: AgentConfig = config()) -> Mixture:
    """The mixture one step later, when nothing is heard."""
    belief = Belief(3, OwnedState("a", NO_CLAIM, EMPTY, 0), mixture)
    return MixturePhd(PLAIN).catch_up(belief, Step(settings, 5)).copies


def test_light_components_are_dropped_in_view_or_not() -> None:
    assert after(join([component(10.0, 10.0, 1.0, weight=2e-4), component(30.0, 10.0, 1.0, weight=0.5e-4, id=2)])).ids.tolist() == [1]


def test_a_detection_beyond_the_border_is_a_target_at_the_border() -> None:
    """Else it would belong to no cell. The border of 33.3 m is rounded inwards, as it lies between two numbers of the wire."""
    arena = ArenaSettings(width=33.3, height=40.0)
    moved = clamped(join([component(-0.2, 20.0, 1.0), component(33.5, 41.0, 1.0)]), arena)
    assert moved.means[0, :2].tolist() == [0.0, 20.0] and moved.means[1, 1] == 40.0
    assert 33.3 - 4e-6 < float(np.float32(moved.means[1, 0])) <= 33.3


def test_what_a_scan_moves_beyond_the_border_stays_in_a_cell() -> None:
    """A target at the western border is seen 0.5 m outside, where its component would be corrected to, and another would be born."""
    seen = gossip_of_scan((1.0, 20.0, 0.0), [(-0.5, 20.0)])
    step = Step(config(birth=BirthSettings(background=False)), 5)
    _, corrected = gaussian_belief.filter_step(component(0.2, 20.0, 1.0, velocity=(0.0, 0.0)), table([seen], DISC, step.config), step)
    owned = join([gaussian_belief.take(corrected, claim, step) for claim in halves(20.0)])
    assert corrected.weights.sum() > 0.9 and owned.weights.sum() == corrected.weights.sum()


# ---------------------------------------------------------------------- rows and points


def test_what_is_said_is_52_bytes_a_component_and_what_is_read_is_said_again_bit_for_bit() -> None:
    rng = np.random.default_rng(3)
    factor = np.tril(rng.normal(size=(20, 4, 4)))
    numbers = np.arange(20, dtype=np.uint64), np.arange(2**53 - 20, 2**53, dtype=np.uint64)
    mixture = Mixture(rng.random(20), rng.normal(size=(20, 4)) * 50.0, factor @ factor.transpose(0, 2, 1), *numbers)
    assert len(packed(mixture).tobytes()) == 20 * 52
    read = unpacked(packed(mixture))
    assert read.covariances == pytest.approx(mixture.covariances, rel=5e-3, abs=5e-3)
    assert read.means[:, :2] == pytest.approx(mixture.means[:, :2], rel=1e-7)
    assert read.means[:, 2:] == pytest.approx(mixture.means[:, 2:], rel=5e-4)
    assert np.array_equal(read.ids, mixture.ids) and np.array_equal(read.labels, mixture.labels)
    assert np.all(np.linalg.eigvalsh(read.covariances) >= -1e-12)


def test_the_quadrature_points_have_the_mean_and_but_for_the_kernel_the_covariance_of_their_component() -> None:
    one = component(10.0, 10.0, 1.0)
    one.covariances[0, :2, :2] = [[4.0, 1.0], [1.0, 2.0]]
    places = quadrature_points(one)[0]
    apart = places - [10.0, 10.0]
    assert quadrature_mean(places.T).tolist() == pytest.approx([10.0, 10.0])
    assert quadrature_mean(np.array([apart[:, 0] ** 2, apart[:, 0] * apart[:, 1], apart[:, 1] ** 2])) == pytest.approx([3.2, 0.8, 1.6])
    assert weighted_points(one).weights.sum() == pytest.approx(1.0)


def test_two_labels_of_a_target_each_are_two_places_however_close() -> None:
    close = join([component(10.0, 5.0, 0.1, weight=0.9, label=7), component(11.0, 5.0, 0.1, weight=0.8, id=2, label=8)])
    estimates, mixture = estimate_and_label(close, 0.5, 0.0, 2.0)
    assert estimates.positions[:, 0].tolist() == [10.0, 11.0] and estimates.labels.tolist() == [7, 8] and mixture.labels.tolist() == [7, 8]
    heavy = join([component(10.0, 5.0, 0.1, weight=1.8, label=7)])
    estimates, mixture = estimate_and_label(heavy, 0.5, 0.0, 2.0)
    assert estimates.labels[0] == 7 and estimates.labels[1] not in (0, 7) and mixture.labels.tolist() == [7]


def test_order_is_by_id_and_equal_ids_count_once() -> None:
    mixture = join([component(1.0, 1.0, 1.0, id=5), component(2.0, 1.0, 1.0, id=3), component(3.0, 1.0, 1.0, id=5)])
    assert canonical(mixture).means[:, 0].tolist() == [2.0, 1.0]


def test_the_prior_has_its_mass_everywhere() -> None:
    mixture = gaussian_phd.prior(config(FilterSettings(kind="gaussian-mixture", prior_density=0.01)))
    assert mixture.weights.sum() == pytest.approx(16.0)
    assert mixture.means[:, :2].mean(axis=0) == pytest.approx([20.0, 20.0])


# ---------------------------------------------------------------------- many components


def many(number: int, seed: int, *, side: float = 40.0, grid: float = 0.0) -> Mixture:
    """Components all over an arena, of variances from 0.01 to 25 m^2; on a grid where one is asked for."""
    rng = np.random.default_rng(seed)
    means = rng.uniform(0.0, side, (number, 4))
    if grid:
        means = np.round(means / grid) * grid
    sizes = rng.choice([0.01, 0.1, 0.3, 2.0, 25.0], (number, 1, 1))
    numbers = np.arange(number, dtype=np.uint64)
    return Mixture(rng.random(number), means, sizes * np.eye(4), numbers, numbers)


@pytest.mark.parametrize(("number", "side", "grid"), [(0, 40.0, 0.0), (1, 40.0, 0.0), (300, 40.0, 0.0), (300, 40.0, 4.0), (90, 0.0, 0.0)])
def test_near_pairs_are_those_that_a_comparison_of_all_with_all_finds(number: int, side: float, grid: float) -> None:
    for seed in range(5):
        print(f"seed {seed}")
        mixture = many(number, seed, side=side, grid=grid)
        (x, y), sizes = mixture.means[:, :2].T.tolist(), (2.0 * mixture.covariances[:, 0, 0]).tolist()
        wanted = []
        for one in range(number):
            for other in range(one + 1, number):
                least, most = sorted((sizes[one], sizes[other]))
                if (x[one] - x[other]) ** 2 + (y[one] - y[other]) ** 2 <= 4.0 * least and most <= ALIKE * least:
                    wanted.append((one, other))
        rows, columns = _near_pairs(mixture, 4.0)
        assert [*zip(rows.tolist(), columns.tolist())] == wanted
        assert number < 2 or wanted


def test_thousands_of_components_take_little_memory_and_no_pair_is_lost_between_two_strips() -> None:
    """One sensor that states a thousand false detections makes as many: all pairs at once would take 200 MB for each number of a pair."""
    number = 5 * STRIP
    mixture = many(number, 1, side=1000.0)
    mixture.covariances[:] = 0.1 * np.eye(4)
    mixture.means[:, 0] = np.arange(number) * 0.5  # each reaches the next one alone, 0.5 m on
    mixture.means[:, 1] = 0.0
    tracemalloc.start()
    rows, columns = _near_pairs(mixture, 4.0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert rows.tolist() == [*range(number - 1)] and columns.tolist() == [*range(1, number)]
    assert peak < 20e6, f"{peak / 1e6:.0f} MB"
