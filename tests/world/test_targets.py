"""Targets move, bounce, leave and enter as section IV of the paper says, and nothing else in the world changes their tracks."""

import math

import numpy as np
import pytest

from protocol.fields import MAX_DETECTIONS
from protocol.random_streams import stream
from protocol.settings import ArenaSettings, BadSetting
from world.config import TargetSettings
from world.targets import Targets, arrival_rate, arrivals, reflect

SQUARE = ArenaSettings(width=40.0, height=40.0)


def after(targets: Targets, ticks: int) -> Targets:
    for _ in range(ticks):
        targets.step()
    return targets


def bounce(x: float, y: float, heading: float, arena: ArenaSettings = SQUARE) -> tuple[float, float, float]:
    positions, headings = reflect(np.array([[x, y]]), np.array([heading]), arena)
    return float(positions[0, 0]), float(positions[0, 1]), float(headings[0])


def test_a_target_inside_is_not_reflected() -> None:
    assert bounce(0.0, 40.0, 0.3) == (0.0, 40.0, 0.3)


def test_the_east_wall_mirrors_the_way_and_the_heading() -> None:
    x, y, heading = bounce(41.0, 10.0, math.radians(30))
    assert (x, y) == (39.0, 10.0)
    assert heading == pytest.approx(math.radians(150))


def test_the_south_wall_mirrors_the_way_and_the_heading() -> None:
    x, y, heading = bounce(10.0, -0.5, math.radians(-30))
    assert (x, y) == (10.0, 0.5)
    assert heading == pytest.approx(math.radians(30))


def test_a_corner_sends_a_target_back_where_it_came_from() -> None:
    x, y, heading = bounce(40.5, 40.25, math.radians(45))
    assert (x, y) == (39.5, 39.75)
    assert math.cos(heading - math.radians(225)) == pytest.approx(1.0)


def test_a_narrow_arena_is_crossed_more_than_once_in_one_tick() -> None:
    x, _, heading = bounce(2.5, 0.5, 0.0, ArenaSettings(width=1.0, height=1.0))
    assert x == 0.5
    assert heading == 0.0  # two walls: the heading is as before


def test_targets_start_everywhere_and_head_everywhere() -> None:
    many = Targets(TargetSettings(count=4000), SQUARE, dt=0.5, seed=1)
    x, y = many.positions.T
    for values, low, high in ((x, 0.0, 40.0), (y, 0.0, 40.0), (many.headings, -math.pi, math.pi)):
        np.testing.assert_allclose(np.histogram(values, 4, (low, high))[0], 1000, rtol=0.1)


def test_a_target_with_a_fixed_heading_goes_straight_at_its_speed() -> None:
    settings = TargetSettings(count=5, speed=2.0, heading_noise=0.0, border="reflect")
    targets = Targets(settings, ArenaSettings(width=1.0e6, height=1.0e6), 0.25, seed=1)
    start, headings = targets.positions, targets.headings
    after(targets, 8)
    way = 2.0 * 2.0
    np.testing.assert_allclose(targets.positions - start, way * np.column_stack([np.cos(headings), np.sin(headings)]), atol=1e-8)


def test_reflected_targets_stay_inside_and_keep_their_names() -> None:
    targets = Targets(TargetSettings(count=50, border="reflect"), SQUARE, 0.5, seed=2)
    for _ in range(300):
        targets.step()
        assert SQUARE.holds(*targets.positions.T).all()
        assert (np.abs(targets.headings) <= math.pi).all()
    assert targets.ids.tolist() == list(range(1, 51))


@pytest.mark.parametrize("dt", [0.1, 0.5])
def test_the_heading_spreads_with_the_square_root_of_time_whatever_the_tick(dt: float) -> None:
    settings = TargetSettings(count=4000, heading_noise=0.2, border="reflect")
    targets = Targets(settings, ArenaSettings(width=1.0e6, height=1.0e6), dt, seed=3)
    before = targets.headings
    after(targets, round(5.0 / dt))
    turned = (targets.headings - before + math.pi) % (2.0 * math.pi) - math.pi
    assert np.std(turned) == pytest.approx(0.2 * math.sqrt(5.0), rel=0.05)


def test_the_arrival_rate_of_thirty_targets_on_a_hectare() -> None:
    rate = arrival_rate(TargetSettings(count=30, speed=2.0), ArenaSettings())
    assert rate == pytest.approx(0.003 * 2.0 * 400.0 / math.pi)
    assert rate == pytest.approx(0.764, abs=5e-4)  # the figure of the design notes


def test_arrivals_come_in_by_the_cosine_law_through_every_side_alike() -> None:
    arena = ArenaSettings(width=100.0, height=50.0)
    positions, headings = arrivals(stream(7, "test"), 60000, arena, step=0.0)
    x, y = positions[:, 0], positions[:, 1]
    south = y == 0.0
    assert np.mean(south) == pytest.approx(1 / 3, abs=0.01)
    assert np.mean(x == arena.width) == pytest.approx(1 / 6, abs=0.01)
    assert np.mean(x[south]) == pytest.approx(50.0, abs=1.0)
    for side, normal in ((south, 90), (x == 100.0, 180), (y == 50.0, 270), (x == 0.0, 0)):
        slant = np.cos(headings[side] - math.radians(normal))
        assert slant.min() > 0.0
        assert np.mean(slant) == pytest.approx(math.pi / 4.0, abs=0.01)  # mean of cos under the density cos / 2


def test_arrivals_have_gone_part_of_their_first_tick() -> None:
    arena = ArenaSettings()
    positions, _ = arrivals(stream(8, "test"), 20000, arena, step=1.0)
    assert arena.holds(*positions.T).all()
    border = np.minimum(np.minimum(positions[:, 0], 100.0 - positions[:, 0]), np.minimum(positions[:, 1], 100.0 - positions[:, 1]))
    assert border.max() <= 1.0
    assert np.mean(border) == pytest.approx(math.pi / 8.0, abs=0.01)  # mean of cos times mean of a uniform time


def test_the_mean_number_of_crossing_targets_stays_where_it_was() -> None:
    settings, arena = TargetSettings(count=30, speed=2.0, border="cross"), ArenaSettings(width=50.0, height=50.0)
    seeds = range(12)
    counts, places = [], []
    for seed in seeds:
        targets = after(Targets(settings, arena, 0.5, seed), 100)  # 50 s, two crossings of the arena
        for _ in range(10):
            after(targets, 40)
            counts.append(len(targets.ids))
            places.append(targets.positions)
    error = math.sqrt(30.0 / len(counts))  # of the mean of as many Poisson counts
    assert abs(np.mean(counts) - 30.0) < 4.5 * error, f"seeds {seeds}"
    assert 30.0 / 2 < np.var(counts) < 30.0 * 2
    np.testing.assert_allclose(np.vstack(places).mean(axis=0), [25.0, 25.0], atol=1.0)


def test_targets_that_cross_leave_and_new_ones_get_new_names() -> None:
    targets = Targets(TargetSettings(count=20, border="cross"), SQUARE, 0.5, seed=4)
    seen = set(targets.ids.tolist())
    for _ in range(200):
        before = set(targets.ids.tolist())
        targets.step()
        now = set(targets.ids.tolist())
        assert SQUARE.holds(*targets.positions.T).all()
        assert len(now) == len(targets.ids) == len(targets.positions) == len(targets.headings)
        assert not (now - before) & seen, "an id came back"
        seen |= now
    assert len(seen) > 20


def test_tracks_depend_on_the_seed_and_the_number_of_steps_alone() -> None:
    first = after(Targets(TargetSettings(), ArenaSettings(), 0.25, seed=5), 50)
    second = after(Targets(TargetSettings(), ArenaSettings(), 0.25, seed=5), 50)
    other = after(Targets(TargetSettings(), ArenaSettings(), 0.25, seed=6), 50)
    assert first.positions.tobytes() == second.positions.tobytes()
    assert first.ids.tobytes() == second.ids.tobytes()
    assert first.positions.tobytes() != other.positions.tobytes()


def test_more_targets_leave_the_first_ones_on_their_tracks() -> None:
    few = after(Targets(TargetSettings(count=3, border="reflect"), SQUARE, 0.5, seed=9), 60)
    many = after(Targets(TargetSettings(count=9, border="reflect"), SQUARE, 0.5, seed=9), 60)
    assert few.positions.tobytes() == many.positions[:3].tobytes()


def test_no_targets_and_standing_targets_are_fine() -> None:
    empty = after(Targets(TargetSettings(count=0), SQUARE, 0.5, seed=1), 20)
    assert empty.positions.shape == (0, 2)
    standing = Targets(TargetSettings(count=4, speed=0.0), SQUARE, 0.5, seed=1)
    before = standing.positions
    np.testing.assert_array_equal(after(standing, 20).positions, before)


def test_there_are_never_more_targets_than_one_message_can_carry() -> None:
    settings = TargetSettings(count=4000, speed=200.0, heading_noise=0.0)
    targets = Targets(settings, SQUARE, 1.0, seed=1)  # the whole arena is exchanged in a tick: Poisson with mean 4000
    most = max(len(after(targets, 1).ids) for _ in range(60))
    assert 4000 < most <= MAX_DETECTIONS


class Eastward:
    """A motion of a user's own: one metre east each tick."""

    def __init__(self, settings: TargetSettings, dt: float, seed: int) -> None:
        self.made_of = (settings.count, dt, seed)

    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> tuple[np.ndarray, np.ndarray]:
        return positions + np.array([1.0, 0.0]), np.zeros(len(headings))


class Scribbling(Eastward):
    """A motion that writes into what it is given."""

    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> tuple[np.ndarray, np.ndarray]:
        moved = super().move(positions, headings, ids, tick)
        ids[:], positions[:] = 0, 0.0
        return moved


def test_a_motion_that_writes_into_what_it_is_given_renames_no_target() -> None:
    motions = (f"{__name__}:{name}" for name in ("Eastward", "Scribbling"))
    plain, scribbled = (Targets(TargetSettings(count=5, motion=motion), SQUARE, 0.25, seed=1) for motion in motions)
    for tick in (1, 2):
        after(plain, tick)
        after(scribbled, tick)
    assert scribbled.ids.tolist() == plain.ids.tolist() and np.array_equal(scribbled.positions, plain.positions)


class Motionless:
    def __init__(self, settings: TargetSettings, dt: float, seed: int) -> None:
        pass


def test_a_scenario_may_bring_its_own_motion_and_the_border_still_holds() -> None:
    settings = TargetSettings(count=5, border="reflect", motion=f"{__name__}:Eastward")
    targets = Targets(settings, SQUARE, 0.25, seed=1)
    before = targets.positions[:, 0]
    after(targets, 1)
    expected = np.where(before + 1.0 > 40.0, 79.0 - before, before + 1.0)
    np.testing.assert_allclose(targets.positions[:, 0], expected)


@pytest.mark.parametrize(
    ("motion", "complaint"),
    [
        ("wavy", "should read module:Name"),
        ("no_such_module_here:Thing", "No module named"),
        ("math:Wave", "module math has no Wave"),
        ("math:pi", "math:pi is an object of the class float: should be a class"),
        (f"{__name__}:Motionless", "has no method move"),
    ],
)
def test_a_motion_that_cannot_be_built_is_named(motion: str, complaint: str) -> None:
    with pytest.raises(BadSetting, match=complaint) as caught:
        Targets(TargetSettings(motion=motion), SQUARE, 0.25, seed=1)
    assert str(caught.value).startswith(f"targets.motion = '{motion}'")
