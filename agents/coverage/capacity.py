"""Sensing capacity: detecting capability, unused capacity, power radius and centroid of detection (paper, section III-A, III-B).

Data types: `SensorFacts` holds the detecting capability and the COD of a sensor, which do not depend on its pose.

Rules. For constant detection probability the literal unused capacity (11) is D - p_d whenever mass is in view. It subtracts a mean of
p_d, which has no unit, from an area. `CapacitySettings.mode` chooses other readings (docs/evidence/paper.md).
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from agents.config import CapacitySettings
from agents.tracking.particles import total
from protocol.sensing import Pose, SensorModel, WedgeSensor
from protocol.settings import BadSetting

_AT_REST: Pose = (0.0, 0.0, 0.0)
_GRID = 1024  # quadrature points per axis over the square of side 2 reach
_LEAST_SEEN = 400  # of these points with a probability above 0: fewer give D and the COD to several percent only


class SensorFacts(NamedTuple):
    """The pose-free facts of a sensor: D in m^2 (6) and the COD in the frame of the sensor, m (14)."""

    capability: float
    cod_offset: tuple[float, float]


def sensor_facts(sensor: SensorModel) -> SensorFacts:
    """D in m^2 (6) and the COD in the frame of the sensor, m (14): closed form for wedges, midpoint quadrature otherwise.

    Raises BadSetting if the detection probability is 0 at all points of the quadrature, or above 0 at fewer than `_LEAST_SEEN`.
    """
    found = _facts_or_reason(sensor)
    if isinstance(found, str):
        raise BadSetting(found)
    return found


@lru_cache(maxsize=1024)
def _facts_or_reason(sensor: SensorModel) -> SensorFacts | str:
    """What `sensor_facts` returns, or why it raises; a pure memo: many agents carry sensors of one class, and say so again and again."""
    if isinstance(sensor, WedgeSensor):
        half, fall = sensor.angle / 2.0, sensor.far_probability / sensor.prob_detection
        mean, outwards = (1.0 + 2.0 * fall) / 3.0, 0.75 * (1.0 + 3.0 * fall) / (1.0 + 2.0 * fall)  # both 1 for a constant p_d
        cod = 2.0 * sensor.radius * math.sin(half) / (3.0 * half) * outwards
        return SensorFacts(sensor.prob_detection * sensor.area * mean, (cod, 0.0))
    step = 2.0 * sensor.reach / _GRID
    ticks = (np.arange(_GRID) + 0.5) * step - sensor.reach
    points = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    probability = sensor.probability(points, _AT_REST)
    detected = total(probability)
    if not detected > 0.0:
        return f"{sensor}: the detection probability is 0 everywhere within its reach of {sensor.reach} m"
    seen = points[probability > 0.0]
    if len(seen) < _LEAST_SEEN:
        farthest = f"the farthest at {np.sqrt((seen * seen).sum(axis=1)).max():.3g} m"
        few = f"only {len(seen)} of {_GRID} x {_GRID} places within its reach of {sensor.reach:g} m are seen, {farthest}"
        return f"{sensor}: {few}: its reach is too far, or its beam too narrow, to compute with"
    x, y = (total(probability * points[:, axis]) / detected for axis in (0, 1))
    return SensorFacts(detected * step * step, (x, y))


def detecting_capability(sensor: SensorModel) -> float:
    """Total detecting capability D in m^2: the integral of p_d over the footprint (6), (8)."""
    return sensor_facts(sensor).capability


def to_world(offset: tuple[float, float], pose: Pose) -> tuple[float, float]:
    """The world coordinates, m, of a point `offset` in the frame of a sensor at `pose`."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + cos * offset[0] - sin * offset[1], pose[1] + sin * offset[0] + cos * offset[1]


def centroid_of_detection(sensor: SensorModel, pose: Pose) -> np.ndarray:
    """Centroid of detection (2,) in m: the p_d-weighted centroid of the footprint (14)."""
    return np.array(to_world(sensor_facts(sensor).cod_offset, pose))


def unused_capacity(capability: float, detected: float, load: float, settings: CapacitySettings = CapacitySettings()) -> float:
    """Unused sensing capacity U in m^2 (11), between 0 and D.

    `capability` is D in m^2. `detected` is the integral of p_d v and `load` the integral of v over the footprint, expected targets (10).
    """
    if settings.mode == "static":
        return capability
    if settings.mode == "expected":
        return max(0.0, capability - detected)
    if settings.mode == "saturating":
        return capability * max(0.0, 1.0 - load / settings.limit)
    return max(0.0, capability - (detected / load if load > 0.0 else 0.0))


def power_radius(unused: float) -> float:
    """Power radius g(U) = sqrt(U / pi) in m: the radius of a perfect disc with the same unused capacity (13)."""
    return math.sqrt(unused / math.pi)
