"""The detector: what the sensors return in one tick, with misses, Gaussian noise and Poisson clutter.

A die is keyed by (seed, sensor name, tick, target id) or (seed, sensor name, tick, number), never by the order of calls.
So a scan does not depend on which other agents there are. All sensors of a tick are thrown together, because numpy pays per call.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from protocol.arithmetic import elementwise
from protocol.fields import MAX_DETECTIONS
from protocol.measuring import MeasurementModel, to_measurements
from protocol.random_streams import random_key, scramble, uniform
from protocol.sensing import Pose, SensorModel, WedgeSensor, measurement_of, wedge_probabilities
from protocol.settings import DetectionSettings
from world.targets import wrap

_MISS, _RADIUS, _ANGLE, _COUNT, _EAST, _NORTH = range(1, 7)  # one salt per use of a word, so that its draws are independent
_MOST_BATCHES = 100
ALL_PAIRS = 20_000  # of sensors and targets: up to so many are looked at one by one, more through a tree


class Sightings(NamedTuple):
    """Every pair of a sensor and a target inside its footprint, by sensor: three arrays (P,)."""

    sensors: np.ndarray  # index
    targets: np.ndarray  # index
    probabilities: np.ndarray  # p_d, above 0


def sightings(sensors: Sequence[SensorModel], poses: Sequence[Pose], positions: np.ndarray) -> Sightings:
    """Which of S sensors at their poses have which targets at positions (T, 2) in view, and with what probability."""
    empty = Sightings(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp), np.empty(0))
    if not sensors or not len(positions):
        return empty
    places, reaches = np.array(poses), np.array([sensor.reach for sensor in sensors])
    who, what = _near(places[:, :2], reaches, positions)
    if not len(who):
        return empty
    close, wedges = positions[what], [sensor for sensor in sensors if isinstance(sensor, WedgeSensor)]
    if len(wedges) == len(sensors):
        probabilities = wedge_probabilities(wedges, poses, who, close)
    else:
        probabilities, starts = np.zeros(len(who)), np.searchsorted(who, np.arange(len(sensors) + 1)).tolist()
        for index, (start, end) in enumerate(pairwise(starts)):
            if end > start:
                probabilities[start:end] = sensors[index].probability(close[start:end], poses[index])
    seen = probabilities > 0.0
    return Sightings(who[seen], what[seen], probabilities[seen])


def _near(places: np.ndarray, reaches: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the S places (S, 2) and of the positions (T, 2) within reach of them: two arrays (P,), by place and then by position."""
    limits = reaches * reaches * (1.0 + 1e-9)
    if len(places) * len(positions) <= ALL_PAIRS:
        x, y = positions[:, 0] - places[:, :1], positions[:, 1] - places[:, 1:]
        who, what = np.nonzero(x * x + y * y <= limits[:, None])
        return who, what
    from scipy.spatial import cKDTree  # a fifth of a second that a small swarm need not wait for before it starts

    found = cKDTree(positions).query_ball_point(places, reaches * 1.001, return_sorted=True)
    who = np.repeat(np.arange(len(places)), [len(some) for some in found])
    what = np.concatenate([np.asarray(some, dtype=np.intp) for some in found])
    x, y = (positions[what] - places[who]).T
    near = x * x + y * y <= limits[who]
    return who[near], what[near]


def count_in_view(seen: Sightings) -> int:
    """Number of different targets among the sightings."""
    return len(np.unique(seen.targets))


def poisson_table(mean: float) -> np.ndarray:
    """P(count <= n) of a Poisson count for n = 0, 1, ... until it is 1 to the last digit, or one message is full; (N,)."""
    longest = min(MAX_DETECTIONS, math.ceil(mean + 12.0 * math.sqrt(mean) + 20.0))
    if mean == 0.0:
        return np.ones(1)
    logs = [n * math.log(mean) - mean - math.lgamma(n + 1.0) for n in range(longest)]
    return np.cumsum([math.exp(log) for log in logs])


class Detector:
    """Scans of one run; pure in (seed, settings, arguments)."""

    def __init__(self, settings: DetectionSettings, seed: int) -> None:
        self._noise = settings.noise
        self._counts = poisson_table(settings.clutter)
        self._seed = seed

    def scans(
        self,
        sensors: Sequence[SensorModel],
        poses: Sequence[Pose],
        names: Sequence[str],
        positions: np.ndarray,
        ids: np.ndarray,
        tick: int,
        seen: Sightings,
    ) -> list[np.ndarray]:
        """The detections (M, 2) float32 of each of S sensors, sorted by x so that their order tells nothing of the truth.

        `positions` (T, 2) and `ids` (T,) are the targets, `seen` their sightings. Detections may lie a little outside arena or footprint.
        """
        words = scramble(np.array([random_key("scan", name) for name in names], dtype=np.uint64), random_key(self._seed, "scans", tick))
        true_owners, true_points = self._detections(words, positions, ids, seen, sensors, poses)
        clutter_owners, clutter_points = self._clutter(words, sensors, poses)
        for index, sensor in enumerate(sensors):
            if (measurement := measurement_of(sensor)) is not None:
                own = clutter_owners == index
                clutter_points[own] = to_measurements(measurement, poses[index], clutter_points[own])
        owners = np.concatenate([true_owners, clutter_owners])
        points = np.vstack([true_points, clutter_points]).astype(np.float32)
        order = np.lexsort((points[:, 1], points[:, 0], owners))
        starts = np.searchsorted(owners[order], np.arange(len(names) + 1)).tolist()
        points = points[order]
        return [points[start : min(end, start + MAX_DETECTIONS)] for start, end in pairwise(starts)]

    def _detections(
        self,
        words: np.ndarray,
        positions: np.ndarray,
        ids: np.ndarray,
        seen: Sightings,
        sensors: Sequence[SensorModel],
        poses: Sequence[Pose],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sensor indices (M,) and noisy detections (M, 2) of the sightings that are not missed."""
        bits = scramble(ids, random_key("target"))[seen.targets] ^ words[seen.sensors]
        hit = uniform(scramble(bits, _MISS)) < seen.probabilities
        bits, owners, points = bits[hit], seen.sensors[hit], positions[seen.targets[hit]]
        # Box and Muller: two normal variates from two uniform ones.
        radius = self._noise * np.sqrt(-2.0 * elementwise(math.log1p, -uniform(scramble(bits, _RADIUS))))
        angle = 2.0 * math.pi * uniform(scramble(bits, _ANGLE))
        noise = np.column_stack([radius * elementwise(math.cos, angle), radius * elementwise(math.sin, angle)])
        found = points + noise
        for index, sensor in enumerate(sensors):
            if (measurement := measurement_of(sensor)) is not None:
                own = owners == index
                found[own] = with_noise(measurement, to_measurements(measurement, poses[index], points[own]), noise[own] / self._noise)
        return owners, found

    def _clutter(self, words: np.ndarray, sensors: Sequence[SensorModel], poses: Sequence[Pose]) -> tuple[np.ndarray, np.ndarray]:
        """Sensor indices (M,) and points (M, 2) of the clutter."""
        numbers = np.searchsorted(self._counts, uniform(scramble(words, _COUNT)), side="right")
        busy = np.nonzero(numbers)[0]
        those, places = [sensors[index] for index in busy.tolist()], [poses[index] for index in busy.tolist()]
        wedges = [sensor for sensor in those if isinstance(sensor, WedgeSensor)]
        if wedges and len(wedges) == len(those):
            owners, points = _first_draws(wedges, places, numbers[busy], words[busy])
            short = np.nonzero(np.bincount(owners, minlength=len(busy)) < numbers[busy])[0]
            full = np.isin(owners, short, invert=True)
            owners, points = owners[full], points[full]
        else:
            owners, points, short = np.empty(0, dtype=np.intp), np.empty((0, 2)), np.arange(len(busy))
        more = [clutter_points(those[index], places[index], int(numbers[busy[index]]), int(words[busy[index]])) for index in short.tolist()]
        owners = np.concatenate([owners, np.repeat(short, [len(some) for some in more])])
        return busy[owners], np.vstack([points, *more])


def with_noise(measurement: MeasurementModel, exact: np.ndarray, deviations: np.ndarray) -> np.ndarray:
    """Ranges and bearings (M, 2) with standard normal `deviations` (M, 2) of their noise; no range is below 1 mm."""
    if measurement.kind == "bearing":
        ranges = exact[:, 0]
    else:
        ranges = np.maximum(exact[:, 0] + measurement.range_noise * deviations[:, 0], 1e-3)
    return np.column_stack([ranges, wrap(exact[:, 1] + measurement.bearing_noise * deviations[:, 1])])


def _first_draws(
    wedges: Sequence[WedgeSensor], poses: Sequence[Pose], numbers: np.ndarray, words: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of each of S wedges the first draws of its `clutter_points`: sensor indices (M,) and points (M, 2), no more than are asked for."""
    batches = np.array([_batch(sensor, number) for sensor, number in zip(wedges, numbers.tolist())])
    who = np.repeat(np.arange(len(wedges)), batches)
    starts = np.cumsum(batches) - batches
    bits = scramble((np.arange(len(who)) - starts[who]).astype(np.uint64), words[who])
    points = _in_squares(bits, np.array([sensor.reach for sensor in wedges])[who, None], np.array(poses)[who, :2])
    inside = wedge_probabilities(wedges, poses, who, points) > 0.0
    so_far = np.cumsum(inside)
    before = so_far[starts] - inside[starts]
    taken = inside & (so_far - before[who] <= numbers[who])
    return who[taken], points[taken]


def _batch(sensor: SensorModel, number: int) -> int:
    """How many points are drawn at once to get `number` of them inside a footprint."""
    return 8 + min(2000 + 4 * number, math.ceil(number * 6.0 * sensor.reach**2 / max(sensor.area, 1e-300)))


def _in_squares(bits: np.ndarray, reach: np.ndarray | float, places: np.ndarray) -> np.ndarray:
    """Points (N, 2) uniform in the squares of half a side `reach` around the places."""
    east, north = uniform(scramble(bits, _EAST)), uniform(scramble(bits, _NORTH))
    return np.column_stack([2.0 * east - 1.0, 2.0 * north - 1.0]) * reach + places


def clutter_points(sensor: SensorModel, pose: Pose, number: int, word: int) -> np.ndarray:
    """`number` points (number, 2) uniform in the footprint, keyed by `word`: drawn in the square around it until enough lie inside.

    A footprint that fills less than about 1e-4 of its square may get fewer.
    """
    batch = _batch(sensor, number)
    accepted: list[np.ndarray] = []
    found = 0
    for start in range(0, batch * _MOST_BATCHES, batch):
        bits = scramble(np.arange(start, start + batch, dtype=np.uint64), word)
        points = _in_squares(bits, sensor.reach, np.array(pose[:2]))
        accepted.append(points[sensor.probability(points, pose) > 0.0])
        found += len(accepted[-1])
        if found >= number:
            break
    return np.vstack(accepted)[:number]
