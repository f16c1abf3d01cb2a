"""Sensors as section III of the paper has them: footprints, detecting capability D, centroid of detection, unused capacity U.

Integrals are computed by quadrature in polar coordinates, and a footprint is judged by bearings.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import dblquad

TABLE_1 = {  # viewing angle in degrees, radius in m, p_d
    "A": (240.0, 8.0, 0.99),
    "B": (45.0, 8.0, 0.99),
    "C": (45.0, 8.0, 0.7),
    "D": (240.0, 25.0, 0.99),
    "E": (45.0, 10.0, 1.0),
    "F": (240.0, 10.0, 1.0),
    "G": (240.0, 14.142, 1.0),
    "H": (240.0, 20.0, 1.0),
}
Pose = tuple[float, float, float]


class Wedge(NamedTuple):
    """A wedge with constant p_d (21): viewing angle in rad, radius in m."""

    angle: float
    radius: float
    prob: float

    @property
    def area(self) -> float:
        """Of the footprint, m^2."""
        return capability(self) / self.prob


def wedge_of(settings: dict[str, Any], name: str) -> Wedge:
    """The sensor of a member: that of Table I, but for what the run sets otherwise."""
    sensor_class = settings["members"][name]
    own = settings["sensors"].get(sensor_class, {})
    angle, radius, prob = TABLE_1.get(sensor_class, (None, None, 1.0))
    angle, radius, prob = own.get("angle") or angle, own.get("radius") or radius, own.get("prob_detection") or prob
    assert angle and radius and prob, sensor_class
    return Wedge(math.radians(angle), radius, prob)


def sees(wedge: Wedge, pose: Pose, points: np.ndarray) -> np.ndarray:
    """Which of the points (N, 2) lie in the footprint: (N,) bool."""
    offset = points[:, 0] - pose[0] + 1j * (points[:, 1] - pose[1])
    bearing = np.angle(offset * np.exp(-1j * pose[2]))
    return (np.abs(offset) <= wedge.radius) & (np.abs(bearing) <= wedge.angle / 2.0)


def integral(wedge: Wedge, value: Callable[[float, float], float]) -> float:
    """Of a function of x and y over the footprint of a wedge at the origin that looks east."""

    def ring(bearing: float, r: float) -> float:
        return r * value(r * math.cos(bearing), r * math.sin(bearing))

    return dblquad(ring, 0.0, wedge.radius, -wedge.angle / 2.0, wedge.angle / 2.0, epsabs=1e-10, epsrel=1e-10)[0]


@lru_cache
def capability(wedge: Wedge) -> float:
    """D = C_max, m^2 (6), (8)."""
    return integral(wedge, lambda x, y: wedge.prob)


def cod(wedge: Wedge, pose: Pose) -> np.ndarray:
    """The centroid of detection (2,) of a wedge in a pose, m (14)."""
    (east, north), cos, sin = _cod_at_rest(wedge), math.cos(pose[2]), math.sin(pose[2])
    return np.array([pose[0] + cos * east - sin * north, pose[1] + sin * east + cos * north])


@lru_cache
def _cod_at_rest(wedge: Wedge) -> tuple[float, float]:
    total = capability(wedge)
    return integral(wedge, lambda x, y: wedge.prob * x) / total, integral(wedge, lambda x, y: wedge.prob * y) / total


def unused(wedge: Wedge, load: float, settings: dict[str, Any]) -> float:
    """U, m^2 (11), in the reading that the run has chosen; `load` is the integral of v over the footprint (docs/evidence/paper.md)."""
    d, detected = capability(wedge), wedge.prob * load
    readings = {
        "literal": d - (detected / load if load > 0.0 else 0.0),
        "expected": d - detected,
        "static": d,
        "saturating": d * (1.0 - load / settings["capacity"]["limit"]),
    }
    return max(0.0, readings[settings["capacity"]["mode"]])


def power_radius(unused_area: float) -> float:
    """g(U), m (13)."""
    return math.sqrt(unused_area / math.pi)
