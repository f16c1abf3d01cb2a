"""Stone Soup's GM-PHD filter beside the swarm on the same recorded scans: `python -m deploy.bench.recorded_scans FOLDER [--seconds S]`.

FOLDER is a copy of the MRCLAM data set. Both sides get every scan of `covey simulate mrclam`, its pose and its ranges and bearings, and the
same settings: noise, clutter, survival. Stone Soup's updater knows one detection probability: the mean over the footprint, if not given.
Both estimates are scored with the same OSPA and cut-off.

Stone Soup's updater knows no field of view. Here it gets one: only components whose mean lies in view of a scan are corrected with it. A
component that moves little stands for a landmark as well as for a robot. Births lie at the detections of the same robot's scan before.
Stone Soup is imported here and in `deploy.bench.stone_soup` alone, and is no dependency.
"""

import argparse
import json
import math
import sys
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from agents.coverage.capacity import detecting_capability
from deploy.cli.errors import guarded
from deploy.scenario import Scenario, resolve
from deploy.simulation import Simulation, rare_collections
from protocol.measuring import to_places
from protocol.messages import Observation
from protocol.node import Event, messages_of
from protocol.observer_messages import Truth
from protocol.sensing import Pose, WedgeSensor
from protocol.settings import BadSetting, sensor_of
from world.score import ospa

SETTLED = 300.0  # s after which the means begin
EDGES = (0.0, 60.0, 150.0, 300.0, 450.0, 600.0, 750.0, 901.0)  # s, of the periods that are told one by one
BIRTH_WEIGHT = 0.02  # of a birth at each detection of the scan before
BIRTH_NOISE = 0.2  # of a birth on each axis, m
PRUNED, MERGED, MOST = 1e-3, 4.0, 120  # weight, squared distance, number of components
GATE = 4.0  # deviations
REPORTED = 0.5  # weight
START = datetime(2011, 1, 1)


class RecordedScan(NamedTuple):
    """What one robot measured in one tick."""

    tick: int
    name: str
    pose: Pose
    detections: np.ndarray  # (M, 2): range m, bearing rad


class PlayedRun(NamedTuple):
    """A run of the swarm: its scans, the truth, and its figures by tick."""

    scans: list[RecordedScan]
    truths: list[Truth]
    ospa: list[float]
    expected: list[float]


def play(scenario: Scenario) -> PlayedRun:
    """Simulate the swarm and keep what its sensors returned."""
    simulation, scans, truths = Simulation(scenario), list[RecordedScan](), list[Truth]()

    def hear(event: Event, now: float) -> None:
        for message in messages_of(event):
            if isinstance(message, Observation):
                scans.append(RecordedScan(message.tick, message.recipient, message.pose, message.detections.astype(float)))

    simulation.scorer.on_event, simulation.on_truth = hear, truths.append
    with rare_collections():
        simulation.run()
    scores = simulation.scorer.scores
    return PlayedRun(scans, truths, [score.ospa for score in scores], [score.mass for score in scores])


class GaussianMixturePhd:
    """Stone Soup's predictor, hypothesiser, updater and reducer in a loop."""

    def __init__(self, scenario: Scenario, sensor: WedgeSensor, prob_detection: float) -> None:
        from stonesoup.hypothesiser.distance import DistanceHypothesiser
        from stonesoup.hypothesiser.gaussianmixture import GaussianMixtureHypothesiser
        from stonesoup.measures import Mahalanobis
        from stonesoup.mixturereducer.gaussianmixture import GaussianMixtureReducer
        from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, RandomWalk
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.updater.kalman import ExtendedKalmanUpdater
        from stonesoup.updater.pointprocess import PHDUpdater

        assert sensor.measures is not None
        filters, dt = scenario.filter, scenario.run.dt
        # the variance a second of our particles: that of the noise of each step, and that of a speed whose heading turns
        turning = filters.speed**2 / max(filters.heading_noise**2, 1e-12)
        diffusion = filters.position_noise**2 / dt + 2.0 * turning
        self._sensor = sensor
        self._noise = np.diag([sensor.measures.bearing_noise**2, sensor.measures.range_noise**2])
        self._predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([RandomWalk(diffusion), RandomWalk(diffusion)]))
        kalman = ExtendedKalmanUpdater(measurement_model=None)
        survival = math.exp(-dt / filters.lifetime) if filters.lifetime else 1.0
        field = sensor.angle * sensor.radius  # clutter that is uniform in range and bearing
        self._updater = PHDUpdater(
            kalman, clutter_spatial_density=scenario.detection.clutter / field, prob_detection=prob_detection, prob_survival=survival
        )
        inner = DistanceHypothesiser(self._predictor, kalman, Mahalanobis(), missed_distance=GATE)
        self._hypothesiser = GaussianMixtureHypothesiser(inner, order_by_detection=True)
        self._reducer = GaussianMixtureReducer(prune_threshold=PRUNED, merge_threshold=MERGED, max_number_components=MOST)
        self._dt = dt
        self.components: list[Any] = []
        self._newborn: dict[str, list[Any]] = {}  # of each robot, for its next scan

    def tick(self, number: int, scans: list[RecordedScan]) -> None:
        """Predict to a tick and correct with its scans, one after the other."""
        now = START + timedelta(seconds=number * self._dt)
        self.components = [self._moved(one, now) for one in self.components]
        for scan in scans:
            if len(scan.detections):
                self._correct(scan, now)

    def _moved(self, one: Any, now: datetime) -> Any:
        """A component at a later time."""
        from stonesoup.types.prediction import TaggedWeightedGaussianStatePrediction

        to = self._predictor.predict(one, timestamp=now)
        return TaggedWeightedGaussianStatePrediction(to.state_vector, to.covar, timestamp=now, weight=one.weight, tag=one.tag)

    def _correct(self, scan: RecordedScan, now: datetime) -> None:
        """The components after one scan."""
        from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
        from stonesoup.types.angle import Bearing
        from stonesoup.types.array import StateVector
        from stonesoup.types.detection import Detection

        model = CartesianToBearingRange(
            ndim_state=2,
            mapping=(0, 1),
            noise_covar=self._noise,
            translation_offset=StateVector([scan.pose[0], scan.pose[1]]),
            rotation_offset=StateVector([0.0, 0.0, scan.pose[2]]),
        )
        rows = scan.detections.tolist()
        seen = {Detection(StateVector([Bearing(angle), far]), timestamp=now, measurement_model=model) for far, angle in rows}
        born = [self._moved(one, now) for one in self._newborn.get(scan.name, [])]
        known = [*self.components, *born]
        places = np.array([one.mean.ravel().astype(float) for one in known]).reshape(-1, 2)
        inside = self._sensor.probability(places, scan.pose) > 0.0
        kept = [one for one, is_seen in zip(known, inside) if not is_seen and one.tag != "birth"]
        corrected = [one for one, is_seen in zip(known, inside) if is_seen]
        if corrected:
            updated = self._updater.update(self._hypothesiser.hypothesise(corrected, seen, now))
            kept += list(updated)
        self.components = list(self._reducer.reduce(kept)) if kept else []
        self._bear(scan, now)

    def _bear(self, scan: RecordedScan, now: datetime) -> None:
        """Births at the detections of a scan, for the next scan of the same robot."""
        from stonesoup.types.array import StateVector
        from stonesoup.types.prediction import TaggedWeightedGaussianStatePrediction

        spread = np.diag([BIRTH_NOISE**2] * 2)
        self._newborn[scan.name] = [
            TaggedWeightedGaussianStatePrediction(StateVector(place.tolist()), spread, timestamp=now, weight=BIRTH_WEIGHT, tag="birth")
            for place in to_places(self._sensor.measures, self._sensor.radius, scan.pose, scan.detections)
        ]

    @property
    def expected(self) -> float:
        """Expected number of targets."""
        return float(sum(float(one.weight) for one in self.components))

    def estimates(self) -> np.ndarray:
        """Places (M, 2) of the components that are more likely than not, as often as their weight rounds to."""
        heavy = [(one.mean.ravel().astype(float), round(float(one.weight))) for one in self.components if float(one.weight) >= REPORTED]
        return np.array([place for place, times in heavy for _ in range(max(1, times))]).reshape(-1, 2)


def compare(folder: str, seconds: float | None, prob_detection: float | None = None) -> dict[str, Any]:
    """Mean OSPA in m and mean |expected number - true number| of both sides after `SETTLED` s, or after half of a shorter run.

    `prob_detection`: of their filter; None: the mean of ours over the footprint. The means of each period between `EDGES` come as well.
    """
    options: dict[str, Any] = {"recorded.data": folder, **({"run.seconds": seconds} if seconds else {})}
    scenario = resolve("mrclam", options)
    sensor = sensor_of(scenario, next(iter(scenario.members.values())))
    assert isinstance(sensor, WedgeSensor)
    mean = detecting_capability(sensor) / sensor.area
    played, theirs = play(scenario), GaussianMixturePhd(scenario, sensor, prob_detection or mean)
    by_tick: dict[int, list[RecordedScan]] = {}
    for scan in played.scans:
        by_tick.setdefault(scan.tick, []).append(scan)
    apart, count = [], []
    for truth in played.truths:
        theirs.tick(truth.tick, by_tick.get(truth.tick, []))
        apart.append(ospa(truth.targets, theirs.estimates(), scenario.study.cutoff))
        count.append(abs(theirs.expected - len(truth.targets)))
    begin = round(min(SETTLED, scenario.run.seconds / 2.0) / scenario.run.dt)
    targets = [len(truth.targets) for truth in played.truths]
    errors = [abs(mass - true) for mass, true in zip(played.expected, targets)]
    rows = np.column_stack([played.ospa, apart, errors, count])
    marks = [min(round(edge / scenario.run.dt), len(rows)) for edge in EDGES]
    names = ("ours_ospa", "theirs_ospa", "ours_cardinality_error", "theirs_cardinality_error")
    periods = [
        {"from": edge, **dict(zip(names, rows[first:last].mean(axis=0).tolist()))}
        for edge, (first, last) in zip(EDGES, pairwise(marks))
        if last > first
    ]
    return {
        "seconds": scenario.run.seconds,
        "scans_with_detections": sum(1 for scan in played.scans if len(scan.detections)),
        "detections": sum(len(scan.detections) for scan in played.scans),
        **dict(zip(names, rows[begin:].mean(axis=0).tolist())),
        "periods": periods,
    }


def main() -> int:
    """Print the comparison as one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", help="a copy of the MRCLAM data set")
    parser.add_argument("--seconds", type=float, default=None, help="only so much of it")
    parser.add_argument("--their-prob-detection", type=float, default=None, help="of Stone Soup's filter; else the mean of ours")
    given = parser.parse_args()
    try:
        import stonesoup  # noqa: F401
    except ImportError:
        raise BadSetting("bench: Stone Soup is missing; python -m pip install stonesoup") from None
    print(json.dumps(compare(given.folder, given.seconds, given.their_prob_detection)))
    return 0


if __name__ == "__main__":
    sys.exit(guarded(main))
