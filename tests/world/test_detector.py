"""The detector misses, blurs and invents as often as the scenario says, and its dice belong to one sensor alone."""

import math

import numpy as np
import pytest

from protocol.fields import MAX_DETECTIONS
from protocol.random_streams import scramble, uniform
from protocol.sensing import SENSOR_CLASSES, MeasurementModel, Pose, SensorModel, WedgeSensor
from protocol.settings import DetectionSettings
from world import detector as detector_module
from world.detector import Detector, clutter_points, count_in_view, poisson_table, sightings

NO_EFFECTS = DetectionSettings(noise=0.25, clutter=0.0)
SEED = 11
DISC = WedgeSensor(2.0 * math.pi, 10.0, 1.0)
FALLING = WedgeSensor(2.0 * math.pi, 20.0, 0.9, None, 0.1)


@pytest.mark.parametrize("seed", range(3))
def test_a_tree_finds_the_sightings_that_a_look_at_all_pairs_finds(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    sensors = [SENSOR_CLASSES[name] for name in "ACD" * 40]
    poses = [(x, y, turn) for x, y, turn in (rng.random((120, 3)) * [300.0, 300.0, 6.0]).tolist()]
    positions = rng.random((400, 2)) * 300.0
    tree = sightings(sensors, poses, positions)
    monkeypatch.setattr(detector_module, "ALL_PAIRS", 10**9)
    for found, expected in zip(tree, sightings(sensors, poses, positions)):
        assert len(found) and np.array_equal(found, expected)


@pytest.mark.parametrize("seed", range(5))
def test_wedges_together_see_what_each_sees_alone(seed: int) -> None:
    """Bit for bit; a sensor of another kind among them makes no difference."""
    print(f"seed {seed}")

    class Other:
        """A wedge by another name."""

        reach, area = DISC.reach, DISC.area
        probability, footprint = DISC.probability, DISC.footprint

    rng = np.random.default_rng(seed)
    sensors: list[SensorModel] = [FALLING, *(SENSOR_CLASSES[name] for name in "ABCDEFGH" * 5)][:40]
    poses = [(x, y, turn) for x, y, turn in (rng.random((40, 3)) * [100.0, 100.0, 6.0]).tolist()]
    positions = rng.random((60, 2)) * 100.0
    for some in (sensors, [*sensors[:20], Other(), *sensors[21:]]):
        seen = sightings(some, poses, positions)
        alone = [sensor.probability(positions, pose) for sensor, pose in zip(some, poses)]
        assert [np.nonzero(p_d)[0].tolist() for p_d in alone] == [seen.targets[seen.sensors == index].tolist() for index in range(40)]
        assert np.array_equal(np.concatenate([p_d[p_d > 0.0] for p_d in alone]), seen.probabilities)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("clutter", [0.1, 2.0, 40.0])
def test_the_clutter_of_wedges_together_is_that_of_each_alone(seed: int, clutter: float) -> None:
    """Bit for bit, those included of whose first draws too few lie in the footprint."""
    print(f"seed {seed}")
    rng, detector = np.random.default_rng(seed), Detector(DetectionSettings(clutter=clutter), seed)
    thin = WedgeSensor(math.radians(1.0), 10.0, 1.0)
    sensors = [*(SENSOR_CLASSES[name] for name in "ABCDEFGH" * 5), thin, thin]
    poses = [(x, y, turn) for x, y, turn in (rng.random((42, 3)) * [100.0, 100.0, 6.0]).tolist()]
    for _ in range(10):
        words = rng.integers(0, 2**63, size=42, dtype=np.uint64)
        numbers = np.searchsorted(poisson_table(clutter), uniform(scramble(words, detector_module._COUNT)), side="right").tolist()
        owners, points = detector._clutter(words, sensors, poses)
        alone = [clutter_points(one, pose, number, int(word)) for one, pose, number, word in zip(sensors, poses, numbers, words)]
        assert np.bincount(owners, minlength=42).tolist() == numbers
        assert np.array_equal(points[np.argsort(owners, kind="stable")], np.vstack(alone))


def ids_of(positions: np.ndarray) -> np.ndarray:
    return np.arange(1, len(positions) + 1, dtype=np.uint64)


def scan(
    detector: Detector,
    sensor: SensorModel,
    pose: Pose,
    positions: np.ndarray,
    tick: int = 0,
    name: str = "s1",
    ids: np.ndarray | None = None,
) -> np.ndarray:
    """The detections of one sensor alone."""
    ids = ids_of(positions) if ids is None else ids
    return detector.scans([sensor], [pose], [name], positions, ids, tick, sightings([sensor], [pose], positions))[0]


def test_targets_in_the_wedge_are_seen_and_others_are_not() -> None:
    positions = np.array([[5.0, 0.0], [11.0, 0.0], [-5.0, 0.0], [3.0, 1.0], [0.0, 5.0]])
    seen = sightings([SENSOR_CLASSES["E"]], [(0.0, 0.0, 0.0)], positions)
    assert seen.targets.tolist() == [0, 3]
    assert seen.sensors.tolist() == [0, 0]
    assert seen.probabilities.tolist() == [1.0, 1.0]


def test_a_target_at_the_very_reach_is_seen() -> None:
    assert len(sightings([DISC], [(0.0, 0.0, 0.0)], np.array([[10.0, 0.0]])).targets) == 1


def test_a_target_that_two_sensors_see_counts_once() -> None:
    positions = np.array([[5.0, 0.0], [50.0, 0.0], [8.0, 0.0]])
    seen = sightings([DISC, DISC], [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], positions)
    assert len(seen.targets) == 4
    assert count_in_view(seen) == 2


def test_nobody_to_see_and_nothing_to_see_are_fine() -> None:
    detector = Detector(NO_EFFECTS, SEED)
    assert count_in_view(sightings([], [], np.zeros((3, 2)))) == 0
    assert scan(detector, DISC, (0.0, 0.0, 0.0), np.empty((0, 2))).shape == (0, 2)
    nothing = np.empty((0, 2))
    assert detector.scans([], [], [], nothing, ids_of(nothing), 0, sightings([], [], nothing)) == []


def test_a_sensor_of_class_c_detects_seven_targets_of_ten() -> None:
    detector, positions = Detector(NO_EFFECTS, SEED), np.array([[4.0, 0.0]])
    hits = sum(len(scan(detector, SENSOR_CLASSES["C"], (0.0, 0.0, 0.0), positions, tick)) for tick in range(3000))
    assert hits / 3000 == pytest.approx(0.7, abs=3.5 * math.sqrt(0.7 * 0.3 / 3000)), f"seed {SEED}"


def test_the_noise_is_gaussian_with_the_set_deviation_on_both_axes() -> None:
    positions = np.tile([3.0, -2.0], (4000, 1))
    errors = scan(Detector(NO_EFFECTS, SEED), DISC, (0.0, 0.0, 0.0), positions) - np.array([3.0, -2.0])
    assert errors.shape == (4000, 2)
    np.testing.assert_allclose(errors.mean(axis=0), [0.0, 0.0], atol=3.5 * 0.25 / math.sqrt(4000))
    np.testing.assert_allclose(errors.std(axis=0), [0.25, 0.25], rtol=0.04)
    scaled = np.sum((errors / 0.25) ** 2, axis=1)
    assert np.mean(scaled > 2.0 * math.log(10.0)) == pytest.approx(0.1, abs=0.017)  # P(|e| > sigma sqrt(2 ln 10)) = 1/10
    # Sorting by x hides nothing from a correlation of products.
    assert abs(np.mean(errors[:, 0] * errors[:, 1])) < 3.5 * 0.25**2 / math.sqrt(4000)


def test_clutter_comes_as_a_poisson_count() -> None:
    detector = Detector(DetectionSettings(clutter=2.0), SEED)
    counts = [len(scan(detector, SENSOR_CLASSES["A"], (0.0, 0.0, 0.0), np.empty((0, 2)), tick)) for tick in range(2000)]
    assert np.mean(counts) == pytest.approx(2.0, abs=3.5 * math.sqrt(2.0 / 2000))
    assert np.var(counts) == pytest.approx(2.0, rel=0.15)
    assert counts.count(0) / 2000 == pytest.approx(math.exp(-2.0), abs=0.027)


@pytest.mark.parametrize("mean", [0.0, 0.1, 2.0, 600.0])
def test_the_poisson_table_has_the_mean_of_its_name(mean: float) -> None:
    table = poisson_table(mean)
    assert table[-1] == pytest.approx(1.0, abs=1e-9)
    assert np.sum(1.0 - table) == pytest.approx(mean, rel=1e-6, abs=1e-9)  # the mean is the sum of P(count > n)


def test_clutter_is_uniform_in_the_footprint() -> None:
    sensor, pose = SENSOR_CLASSES["E"], (20.0, 30.0, 1.0)
    points = clutter_points(sensor, pose, 6000, word=123)
    assert points.shape == (6000, 2)
    assert (sensor.probability(points, pose) > 0.0).all()
    ranges2 = np.sum((points - [20.0, 30.0]) ** 2, axis=1)
    bearings = np.arctan2(points[:, 1] - 30.0, points[:, 0] - 20.0) - 1.0
    assert np.mean(ranges2 < 50.0) == pytest.approx(0.5, abs=0.023)  # half of the area lies within r / sqrt(2)
    assert np.mean(bearings > 0.0) == pytest.approx(0.5, abs=0.023)
    assert np.mean(np.abs(bearings) < math.radians(22.5 / 2)) == pytest.approx(0.5, abs=0.023)


def test_the_clutter_of_a_camera_is_ranges_and_bearings_in_its_footprint() -> None:
    camera = WedgeSensor(1.0, 5.0, 0.9, MeasurementModel("range-bearing", 0.01, 0.1))
    ranges, bearings = scan(Detector(DetectionSettings(clutter=200.0), 1), camera, (70.0, 30.0, 2.0), np.empty((0, 2))).T
    assert len(ranges) > 100 and ranges.max() <= 5.0 + 1e-5 and np.abs(bearings).max() <= 0.5 + 1e-5


def test_a_thin_footprint_still_gets_its_clutter_and_an_empty_one_ends_the_search() -> None:
    thin = WedgeSensor(math.radians(1.0), 10.0, 1.0)
    assert len(clutter_points(thin, (0.0, 0.0, 0.0), 5, word=1)) == 5

    class Blind:
        reach = 5.0
        area = 0.0

        def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
            return np.zeros(len(points))

        def footprint(self, pose: Pose) -> np.ndarray:
            return np.empty((0, 2))

    assert len(clutter_points(Blind(), (0.0, 0.0, 0.0), 5, word=1)) == 0


class Fading:
    """A sensor of a user's own: p_d falls off linearly with the distance."""

    reach = 10.0
    area = math.pi * 100.0

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        return np.clip(1.0 - np.hypot(points[:, 0] - pose[0], points[:, 1] - pose[1]) / self.reach, 0.0, 1.0)

    def footprint(self, pose: Pose) -> np.ndarray:
        return DISC.footprint(pose)


def test_a_sensor_whose_probability_falls_off_detects_accordingly() -> None:
    near, far = np.full((2000, 2), [2.5, 0.0]), np.full((2000, 2), [0.0, 7.5])
    detections = scan(Detector(NO_EFFECTS, SEED), Fading(), (0.0, 0.0, 0.0), np.vstack([near, far]))
    assert np.sum(detections[:, 0] > 1.25) / 2000 == pytest.approx(0.75, abs=0.034)
    assert np.sum(detections[:, 0] < 1.25) / 2000 == pytest.approx(0.25, abs=0.034)


def test_detections_are_sorted_float32_and_do_not_follow_the_order_of_the_targets() -> None:
    positions = np.array([[6.0, 0.0], [2.0, 1.0], [4.0, -1.0]])
    detector = Detector(DetectionSettings(noise=0.01, clutter=0.0), SEED)
    detections = scan(detector, DISC, (0.0, 0.0, 0.0), positions)
    assert detections.dtype == np.float32
    np.testing.assert_allclose(detections, [[2.0, 1.0], [4.0, -1.0], [6.0, 0.0]], atol=0.06)


def test_the_same_targets_in_another_order_give_the_same_scan() -> None:
    positions = np.array([[6.0, 0.0], [2.0, 1.0], [4.0, -1.0]])
    detector, ids, back = Detector(NO_EFFECTS, SEED), np.array([3, 1, 2], dtype=np.uint64), [2, 0, 1]
    first = scan(detector, DISC, (0.0, 0.0, 0.0), positions, 5, ids=ids)
    second = scan(detector, DISC, (0.0, 0.0, 0.0), positions[back], 5, ids=ids[back])
    assert first.tobytes() == second.tobytes()


def test_a_scan_is_the_same_in_any_company() -> None:
    detector = Detector(DetectionSettings(clutter=1.5), SEED)
    positions = np.column_stack([np.linspace(0.0, 40.0, 60), np.linspace(5.0, 35.0, 60)])
    names = [f"s{number}" for number in range(1, 9)]
    sensors = [SENSOR_CLASSES[letter] for letter in "ABCDEFGH"]
    poses = [(5.0 * number, 4.0 * number, float(number)) for number in range(8)]
    together = detector.scans(sensors, poses, names, positions, ids_of(positions), 3, sightings(sensors, poses, positions))
    for sensor, pose, name, expected in zip(sensors, poses, names, together):
        alone = scan(detector, sensor, pose, positions, 3, name)
        assert alone.tobytes() == expected.tobytes()
    assert sum(len(some) for some in together) > 20


def test_other_targets_do_not_change_how_one_is_seen() -> None:
    detector, ids = Detector(NO_EFFECTS, SEED), np.array([7, 8], dtype=np.uint64)
    both = scan(detector, DISC, (0.0, 0.0, 0.0), np.array([[1.0, 0.0], [5.0, 0.0]]), 2, ids=ids)
    one = scan(detector, DISC, (0.0, 0.0, 0.0), np.array([[1.0, 0.0]]), 2, ids=ids[:1])
    assert one.tobytes() == both[:1].tobytes()


@pytest.mark.parametrize("other", [(12, "s1", 0), (11, "s2", 0), (11, "s1", 1)])
def test_seed_sensor_and_tick_each_make_other_dice(other: tuple[int, str, int]) -> None:
    seed, name, tick = other
    positions = np.array([[3.0, 0.0]])
    mine = scan(Detector(NO_EFFECTS, SEED), DISC, (0.0, 0.0, 0.0), positions)
    assert scan(Detector(NO_EFFECTS, seed), DISC, (0.0, 0.0, 0.0), positions, tick, name).tobytes() != mine.tobytes()


def test_the_dice_of_two_sensors_and_of_two_ticks_are_unrelated() -> None:
    detector, positions = Detector(DetectionSettings(noise=1.0, clutter=0.0), SEED), np.array([[0.0, 0.0]])
    errors = np.array([[scan(detector, DISC, (0.0, 0.0, 0.0), positions, tick, name)[0, 0] for tick in range(1500)] for name in ("a", "b")])
    assert abs(np.corrcoef(errors[0], errors[1])[0, 1]) < 3.5 / math.sqrt(1500)
    assert abs(np.corrcoef(errors[0, :-1], errors[0, 1:])[0, 1]) < 3.5 / math.sqrt(1500)


def test_a_scan_never_holds_more_than_one_message_can_carry() -> None:
    detections = scan(Detector(DetectionSettings(clutter=1.0e9), SEED), DISC, (0.0, 0.0, 0.0), np.array([[1.0, 1.0]]))
    assert len(detections) == MAX_DETECTIONS
