"""The proximity sensor of a body: the centres of the bodies close by, which its agent keeps away from.

Every body has one where `limits.radius` is more than 0. It tells no names, and sees wrecks, strangers and bodies of silent agents alike.
The world senses all bodies of a tick. A body process knows others by their observations, so it senses those that stand; the gossips of
the same tick say where the others are.
"""

from collections.abc import Collection, Sequence

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


class StandingBodies:
    """The bodies that stand, as a body process hears of them; wrecks among them."""

    def __init__(self) -> None:
        self._poses: dict[str, Pose] = {}
        self._stands: set[str] = set()

    def hear(self, name: str, pose: Pose) -> None:
        """Note where a body is."""
        (self._stands.add if self._poses.get(name) == pose else self._stands.discard)(name)
        self._poses[name] = pose

    def places(self, alive: Collection[str]) -> list[Vector]:
        """The centres of those that stand, or have no process any more; `alive`: the names of the bodies that have one."""
        return [pose[:2] for name, pose in self._poses.items() if name in self._stands or name not in alive]
