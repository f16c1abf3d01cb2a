"""One scan of a particle PHD filter, and OSPA, by Stone Soup (SMC-PHD predictor and updater) beside ours, on the same numbers of things.

Both sides predict, correct with every detection and draw new particles. Stone Soup is imported here and nowhere else; it is no dependency.
"""

from datetime import datetime, timedelta
from typing import Any

import numpy as np

from agents.backend import Backend
from agents.gossip.table import GossipTable, announced_sensor
from agents.tracking import phd
from agents.tracking.claims import NO_CLAIM
from agents.tracking.particles import Particles, unlabelled
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput
from deploy.bench.timing import BenchRow, median_seconds
from deploy.scenario import agent_config, resolve
from protocol.fields import pack
from protocol.geometry import rectangle
from protocol.messages import Gossip
from protocol.settings import sensor_of
from world.score import ospa

PARTICLES, DETECTIONS, TARGETS, SIDE = 1000, 5, 30, 40.0
REPEATS = 20
WIDE = {"angle": 360.0, "radius": 60.0, "prob_detection": 0.9}


def _points(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 2)) * SIDE


def our_scan(backend: Backend) -> Any:
    """A call that plays one scan of the whole arena with one sensor that sees all of it."""
    scenario = resolve("convergence", {"team.composition": "L1", "sensors.L": WIDE})
    sensor, step, corners = sensor_of(scenario, "L"), Step(agent_config(scenario), 1), rectangle(SIDE, SIDE)
    pose = (SIDE / 2.0, SIDE / 2.0, 0.0)
    seen = pack(_points(DETECTIONS, 2), "<f4")
    said = Gossip(sender="s1", incarnation=1, tick=1, pose=pose, cod=pose[:2], power_radius=1.0, unused=0.0, detections_bytes=seen)
    words = GossipTable([said], [announced_sensor("s1", sensor, 0.1)], step.config)
    states = np.hstack([_points(PARTICLES, 1), np.ones((PARTICLES, 2))])
    particles = unlabelled(states, np.full(PARTICLES, DETECTIONS / PARTICLES), np.arange(1, PARTICLES + 1, dtype=np.uint64))

    region = RegionInput("s1", 0, sensor, pose, corners, NO_CLAIM)

    def scan() -> Particles:
        [found] = backend.update_regions(words, particles, backend.background_births(step), [region], step)
        return phd.resample(found.updated, "s1", step)

    assert len(scan().ids) >= PARTICLES // 4
    return scan


def their_scan() -> Any:
    """The same by Stone Soup: constant-velocity model, linear Gaussian measurements, systematic resampling."""
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.particle import SMCPHDPredictor
    from stonesoup.resampler.particle import SystematicResampler
    from stonesoup.sampler.particle import ParticleSampler
    from stonesoup.types.array import StateVectors
    from stonesoup.types.detection import Detection, MissedDetection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.multihypothesis import MultipleHypothesis
    from stonesoup.types.numeric import Probability
    from stonesoup.types.state import ParticleState
    from stonesoup.updater.particle import SMCPHDUpdater

    start = datetime(2021, 1, 1)
    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.1), ConstantVelocity(0.1)])
    sensor = LinearGaussian(4, (0, 2), np.diag([0.0625, 0.0625]))
    rng = np.random.default_rng(3)
    sampler = ParticleSampler(
        distribution_func=lambda num_samples: StateVectors(rng.random((4, num_samples)) * SIDE), params={"num_samples": 50}, ndim_state=4
    )
    predictor = SMCPHDPredictor(
        transition_model=model,
        death_probability=Probability(0.001),
        birth_probability=Probability(0.05),
        birth_rate=0.1,
        birth_sampler=sampler,
    )
    updater = SMCPHDUpdater(
        measurement_model=sensor,
        prob_detect=Probability(0.9),
        clutter_intensity=0.1 / SIDE**2,
        resampler=SystematicResampler(),
        num_samples=PARTICLES,
    )
    places = _points(PARTICLES, 1).T
    states = StateVectors(np.array([places[0], np.ones(PARTICLES), places[1], np.ones(PARTICLES)]))
    weights = np.full(PARTICLES, np.log(DETECTIONS / PARTICLES))
    later = start + timedelta(seconds=0.25)
    detections = [Detection(point.reshape(2, 1), timestamp=later, measurement_model=sensor) for point in _points(DETECTIONS, 2)]

    def scan() -> Any:
        prior = ParticleState(states, log_weight=weights, timestamp=start)  # a new one: predictions are cached
        prediction = predictor.predict(prior, timestamp=later)
        seen = [SingleHypothesis(prediction, detection) for detection in detections]
        return updater.update(MultipleHypothesis([SingleHypothesis(prediction, MissedDetection(timestamp=later)), *seen]))

    assert len(scan()) == PARTICLES
    return scan


def their_ospa() -> Any:
    """OSPA of 30 against 30 by Stone Soup; checked to give our number."""
    from stonesoup.metricgenerator.ospametric import OSPAMetric
    from stonesoup.types.state import State

    start = datetime(2021, 1, 1)
    one, other = _points(TARGETS, 4), _points(TARGETS, 5)
    first, second = ([State(point.reshape(2, 1), timestamp=start) for point in points] for points in (one, other))
    metric = OSPAMetric(p=1, c=10.0)
    assert abs(metric.compute_OSPA_distance(first, second).value - ospa(one, other)) < 1e-9
    return lambda: metric.compute_OSPA_distance(first, second)


def measure(backend: Backend) -> list[BenchRow]:
    """Milliseconds of CPU, and how many times faster ours are."""
    one, other = _points(TARGETS, 4), _points(TARGETS, 5)
    pairs = [
        (f"particle PHD scan, {PARTICLES} particles, {DETECTIONS} detections", our_scan(backend), their_scan()),
        (f"OSPA, {TARGETS} against {TARGETS}", lambda: ospa(one, other), their_ospa()),
    ]
    rows: list[BenchRow] = []
    for what, ours, theirs in pairs:
        mine = 1000.0 * median_seconds(lambda call=ours: [call() for _ in range(REPEATS)]) / REPEATS  # type: ignore[misc]
        foreign = 1000.0 * median_seconds(theirs)
        rows.append({"what": what, "ours, ms": mine, "theirs, ms": foreign, "times faster": foreign / mine, "theirs": "Stone Soup"})
    return rows
