"""The proximity sensor of a body: the centres of the bodies close by, which its agent keeps away from.

Every body has one where `limits.radius` is more than 0. It tells no names, and sees wrecks, strangers and bodies of silent agents alike.
The world senses all bodies of a tick. A body process knows the others by the poses that they say, which may be a tick old; the gossips of
the same tick say where those with an agent are. A body that falls silent stays where it was last.
"""

from collections.abc import Sequence

import numpy as np

from protocol.message import Vector
from protocol.sensing import Pose
from world.config import WorldConfig


def sight(config: WorldConfig) -> float:
    """How far a body senses others, m from centre to centre: two of them approach each other for four ticks at full speed within it."""
    return 2.0 * config.limits.radius + 8.0 * config.limits.speed * config.run.dt


def around(pose: Pose, others: Sequence[Vector], config: WorldConfig) -> np.ndarray:
    """The centres (K, 2) in m of those of the others that are in sight, in the given order."""
    points = np.array(others, dtype=float).reshape(-1, 2)
    offsets = points - np.array(pose[:2])
    return points[(offsets * offsets).sum(axis=1) <= sight(config) ** 2]
