"""What a sensor measures of a target: its position, range and bearing, or the bearing alone.

Data types: `MeasurementModel` is the kind of a sensor's detections and their noise. A detection is a row of two numbers: x and y in m in
the frame of the world for a position, else range in m (0 for a bearing alone) and bearing in rad from the heading, to the left positive.
"""

import math
from typing import Literal

import msgspec
import numpy as np

from protocol.geometry import wrap_angle

MEDIAN_RANGE = math.sqrt(0.5)  # of the radius of a wedge: half of its area lies nearer


class MeasurementModel(msgspec.Struct, frozen=True):
    """Kind and standard deviations of the detections of a sensor; without one it measures positions with `detection.noise`."""

    kind: Literal["range-bearing", "bearing"]
    bearing_noise: float  # rad
    range_noise: float = 0.0  # m

    def __post_init__(self) -> None:
        if not 1e-6 <= self.bearing_noise <= 1.0:
            raise ValueError(f"bearing_noise = {self.bearing_noise}: should lie in [1e-6, 1] rad")
        if self.kind == "range-bearing" and not 1e-4 <= self.range_noise <= 1e6:
            raise ValueError(f"range_noise = {self.range_noise}: should lie in [1e-4, 1e6] m")


def to_measurements(measurement: MeasurementModel | None, pose: tuple[float, float, float], points: np.ndarray) -> np.ndarray:
    """The detections (N, 2) without noise of points (N, 2) in the plane."""
    if measurement is None:
        return points
    offset = points - np.array(pose[:2])
    bearings = np.array([wrap_angle(math.atan2(y, x) - pose[2]) for x, y in offset.tolist()])
    ranges = np.sqrt(offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1])
    return np.column_stack([ranges if measurement.kind == "range-bearing" else np.zeros(len(points)), bearings])


def to_places(measurement: MeasurementModel | None, radius: float, pose: tuple[float, float, float], detections: np.ndarray) -> np.ndarray:
    """The places (N, 2) in m of detections (N, 2); of a bearing alone the middle of the beam of a sensor of that radius, m."""
    if measurement is None or not len(detections):
        return detections
    rows = np.asarray(detections, dtype=float).tolist()
    ranges = [first if measurement.kind == "range-bearing" else MEDIAN_RANGE * radius for first, _ in rows]
    angles = [pose[2] + bearing for _, bearing in rows]
    return np.array(
        [(pose[0] + distance * math.cos(angle), pose[1] + distance * math.sin(angle)) for distance, angle in zip(ranges, angles)]
    )
