"""The control law (18), with the two readings of the heading and the limits of section IV."""

import math
from typing import Any

import numpy as np


def command(goal: np.ndarray, driven: np.ndarray, pose: np.ndarray, settings: dict[str, Any]) -> tuple[float, float, float]:
    """vx, vy in m/s and the turn rate in rad/s: `driven`, the COD, goes to the goal in one step of dt if the limits allow it.

    "literal" looks at the goal from the driven point, as printed; "centroid" looks at it from the sensor (docs/evidence/paper.md).
    """
    limits, dt = settings["limits"], settings["run"]["dt"]
    wanted = (goal - driven) / dt
    slower = min(1.0, limits["speed"] / max(float(np.hypot(*wanted)), 1e-300))
    offset = goal - (driven if settings["control"]["heading"] == "literal" else pose[:2])
    turn = math.remainder(math.atan2(offset[1], offset[0]) - pose[2], 2.0 * math.pi) / dt if offset.any() else 0.0
    return float(wanted[0] * slower), float(wanted[1] * slower), min(max(turn, -limits["turn_rate"]), limits["turn_rate"])
