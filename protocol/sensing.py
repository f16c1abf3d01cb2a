"""The sensing contract and the sensors of the paper.

A *sensor model* is any hashable object with `reach`, `area`, `probability` and `footprint` (`SensorModel`). A *pose* is (x m, y m,
heading rad). A peer announces a wedge sensor on the wire by its numbers. A scenario names other models as `module:Class`.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Protocol, runtime_checkable

import msgspec
import numpy as np

from protocol.arithmetic import elementwise, wedge_probability
from protocol.measuring import MeasurementModel

Pose = tuple[float, float, float]


@runtime_checkable
class SensorModel(Protocol):
    """What the swarm needs to know of a sensor. It is time-invariant; shape and falloff are free (paper, section III).

    It keeps no state between two calls: in a simulation one object serves all agents of its class.
    """

    @property
    def reach(self) -> float:
        """The greatest distance at which a point can be detected, m."""

    @property
    def area(self) -> float:
        """Area of the footprint, m^2."""

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        """Detection probability p_d of targets at points (N, 2): (N,), 0 outside the footprint."""

    def footprint(self, pose: Pose) -> np.ndarray:
        """Outline of the field of view (V, 2), counter-clockwise; it need not be convex."""

    def __hash__(self) -> int:
        """The default of every object, or that of its parameters: D, the COD and outlines are kept in tables by sensor."""


LEAST_ANGLE, LEAST_RADIUS = 1.0e-6, 1.0e-3  # of a wedge, rad and m: quotients by its area stay finite
_SLIT = 1e-9  # rad


class WedgeSensor(msgspec.Struct, frozen=True, dict=True, omit_defaults=True):
    """A wedge of `angle` rad and `radius` m, centred on the heading (21), figure 2.

    The detection probability is constant, or falls linearly from `prob_detection` at the sensor to `prob_detection_far` at `radius`.
    `measures` is None for a sensor that measures positions.
    """

    angle: float
    radius: float
    prob_detection: float
    measures: MeasurementModel | None = None
    prob_detection_far: float | None = None

    def __post_init__(self) -> None:
        if not LEAST_ANGLE <= self.angle <= 2.0 * math.pi:
            raise ValueError(f"angle = {self.angle}: should lie in [{LEAST_ANGLE:g}, 2 pi] rad")
        if not LEAST_RADIUS <= self.radius <= 1.0e6:
            raise ValueError(f"radius = {self.radius}: should lie in [{LEAST_RADIUS:g}, 1e6] m")
        if not 0.0 < self.prob_detection <= 1.0:
            raise ValueError(f"prob_detection = {self.prob_detection}: should be more than 0 and at most 1")
        if self.prob_detection_far is not None and not 0.0 < self.prob_detection_far <= self.prob_detection:
            right = f"should be more than 0 and at most prob_detection = {self.prob_detection}"
            raise ValueError(f"prob_detection_far = {self.prob_detection_far}: {right}")

    @property
    def reach(self) -> float:
        return self.radius

    @cached_property
    def area(self) -> float:
        return self.angle * self.radius**2 / 2.0

    @cached_property
    def cos_half_angle(self) -> float:
        """Cosine of half the viewing angle; below -1 for a full disc, so that rounding excludes no point."""
        return math.cos(self.angle / 2.0) if self.angle < 2.0 * math.pi else -2.0

    @property
    def far_probability(self) -> float:
        """p_d at the far edge."""
        return self.prob_detection if self.prob_detection_far is None else self.prob_detection_far

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        """p_d inside the wedge, 0 outside, of points (N, 2): (N,)."""
        dx, dy = points[:, 0] - pose[0], points[:, 1] - pose[1]
        cos, sin, shape = math.cos(pose[2]), math.sin(pose[2]), (self.radius, self.cos_half_angle)
        return wedge_probability(dx, dy, cos, sin, *shape, self.prob_detection, self.far_probability)

    def footprint(self, pose: Pose) -> np.ndarray:
        """The outline with an arc point about every 5 degrees (V, 2).

        A full disc has no apex. Neither has a disc with a slit as narrow as rounding: the sides of the slit would cross.
        """
        steps = max(2, math.ceil(self.angle / math.radians(5.0)))
        bearings = pose[2] + np.linspace(-self.angle / 2.0, self.angle / 2.0, steps + 1)
        arc = np.column_stack(
            [pose[0] + self.radius * elementwise(math.cos, bearings), pose[1] + self.radius * elementwise(math.sin, bearings)]
        )
        return arc[:-1] if self.angle > 2.0 * math.pi - _SLIT else np.vstack([[pose[:2]], arc])


def wedge_probabilities(sensors: Sequence[WedgeSensor], poses: Sequence[Pose], who: np.ndarray, points: np.ndarray) -> np.ndarray:
    """p_d (P,) of the points (P, 2), each for the sensor of its index in `who` (P,); the bits are those of `probability`."""
    facts = np.array(
        [
            (x, y, math.cos(heading), math.sin(heading), one.radius, one.cos_half_angle, one.prob_detection, one.far_probability)
            for one, (x, y, heading) in zip(sensors, poses)
        ]
    )
    x, y, cos, sin, radius, cos_half, near, far = facts.reshape(-1, 8)[who].T
    return wedge_probability(points[:, 0] - x, points[:, 1] - y, cos, sin, radius, cos_half, near, far)


def measurement_of(sensor: SensorModel) -> MeasurementModel | None:
    """What a sensor measures; None: positions. Only a wedge measures anything else."""
    return sensor.measures if isinstance(sensor, WedgeSensor) else None


def _degrees(angle: float, radius: float, prob_detection: float) -> WedgeSensor:
    return WedgeSensor(math.radians(angle), radius, prob_detection)


SENSOR_CLASSES: dict[str, WedgeSensor] = {  # Table I: viewing angle in degrees, radius in m, p_d
    "A": _degrees(240.0, 8.0, 0.99),
    "B": _degrees(45.0, 8.0, 0.99),
    "C": _degrees(45.0, 8.0, 0.7),
    "D": _degrees(240.0, 25.0, 0.99),
    "E": _degrees(45.0, 10.0, 1.0),
    "F": _degrees(240.0, 10.0, 1.0),
    "G": _degrees(240.0, 14.142, 1.0),
    "H": _degrees(240.0, 20.0, 1.0),
}
