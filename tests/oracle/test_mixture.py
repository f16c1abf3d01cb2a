"""A scan of the Gaussian-mixture tracker beside the corrector that Vo and Ma print: weights, means and covariances to 1e-9.

The sensor sees the whole scene. Two departures are left out of the comparison: births, and the rule of misses near detections
(docs/explanation/decisions/0008-a-miss-is-weighed-against-one-target.md). So components are in two groups. One is detected, and the other
is missed far from it with `certainty` 0, where the rule is the printed one.
"""

import math

import numpy as np
import pytest

from agents.config import AgentConfig, BirthSettings, FilterSettings, MixtureSettings
from agents.tracking import gaussian_phd
from agents.tracking.births import Scan
from agents.tracking.gaussians import Mixture, unlabelled
from agents.tracking.particles import join
from agents.tracking.step import Step
from protocol.sensing import WedgeSensor
from protocol.settings import DetectionSettings
from tests.oracle.mixture_filter import Component, detected, missed

EXACT, NOISE, PROBABILITY, CLUTTER = 1e-9, 0.7, 0.85, 0.003
CONFIG = AgentConfig(
    filter=FilterSettings(kind="gaussian-mixture", gate=10.0, certainty=0.0),
    birth=BirthSettings(measurement=False, background=False),
    detection=DetectionSettings(noise=NOISE),
    mixture=MixtureSettings(pruned=0.0),
)


def group(rng: np.random.Generator, middle: tuple[float, float], first: int) -> Mixture:
    """Four components within 2 m of a place, with any correlations."""
    factor = rng.normal(size=(4, 4, 4))
    covariances = 0.3 * factor @ factor.transpose(0, 2, 1) + 0.2 * np.eye(4)
    means = np.column_stack([np.array(middle) + rng.uniform(-2.0, 2.0, (4, 2)), rng.normal(size=(4, 2))])
    return unlabelled(rng.uniform(0.1, 0.9, 4), means, covariances, np.arange(first, first + 4, dtype=np.uint64))


def components(mixture: Mixture) -> list[Component]:
    return list(zip(mixture.weights.tolist(), mixture.means, mixture.covariances))


@pytest.mark.parametrize("seed", range(5))
def test_a_scan_corrects_as_the_paper_of_the_filter_prints_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    near, far = group(rng, (50.0, 50.0), 0), group(rng, (250.0, 50.0), 4)
    detections = np.array([50.0, 50.0]) + rng.uniform(-3.0, 3.0, (3, 2))
    sensor = WedgeSensor(2.0 * math.pi, 900.0, PROBABILITY)
    scan = Scan(7, sensor, (100.0, 50.0, 0.0), detections, np.arange(3, dtype=np.uint64), CLUTTER)
    ours = gaussian_phd.correct(join([near, far]), [scan], Step(CONFIG, 3))
    known = join([near, far])
    theirs = detected(components(known), detections, NOISE**2 * np.eye(2), PROBABILITY, CLUTTER) + missed(components(far), PROBABILITY)
    rest = components(ours)
    for weight, mean, covariance in theirs:
        if weight > EXACT:
            number = min(range(len(rest)), key=lambda one: float(np.abs(rest[one][1] - mean).max()) + abs(rest[one][0] - weight))
            found = rest.pop(number)
            assert abs(found[0] - weight) <= EXACT
            assert np.abs(found[1] - mean).max() <= EXACT and np.abs(found[2] - covariance).max() <= EXACT
    as_missed = [one for one in rest if any(np.array_equal(one[1], mean) for mean in near.means)]
    assert sum(weight for weight, _, _ in rest) == pytest.approx(sum(weight for weight, _, _ in as_missed), abs=EXACT)
