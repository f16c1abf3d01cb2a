"""A platform to begin with: a differential drive that obeys forward speed and turn rate, simulated in steps of 20 ms.

    [bodies]
    host = "own"
    platform = "covey.examples.robots:DifferentialDrive"
    parameters = {places = {s1 = [10.0, 10.0, 0.0], s2 = [30.0, 30.0, 0.0]}}

For a robot of your own replace `_spin` by what its driver needs, let `read` return what its odometry says, and take out `simulated`.
"""

import math
from typing import Any

from covey import Pose
from protocol.settings import LimitSettings
from world.unicycle import twist

INNER = 0.02  # s between two commands to the wheels


class DifferentialDrive:
    """The sensor sits `offset` m ahead of the axle. `places`: x m, y m and heading rad of the sensor by name; `dt` as in the scenario."""

    simulated = True  # it moves by its ticks alone, so that simulations may drive it

    def __init__(
        self, name: str, places: dict[str, Pose], dt: float = 0.25, offset: float = 0.2, speed: float = 2.0, turn_rate: float = 5.0
    ) -> None:
        if name not in places:
            raise ValueError(f"places.{name}: is missing; should be [x m, y m, heading rad]")
        self._x, self._y, self._heading = (float(number) for number in places[name])
        self._dt, self._offset, self._limits = dt, offset, LimitSettings(speed=speed, turn_rate=turn_rate)
        self._velocity = 0.0, 0.0
        self._tick: int | None = None

    def read(self, tick: int) -> tuple[Pose, Any]:
        """The pose of the sensor at this tick; None: its detections are simulated."""
        for _ in range(tick - (tick if self._tick is None else self._tick)):
            for _ in range(round(self._dt / INNER)):
                self._spin(*twist(self._heading, self._velocity, self._offset, self._limits), self._dt / round(self._dt / INNER))
        self._tick = tick
        return (self._x, self._y, self._heading), None

    def drive(self, velocity: tuple[float, float], turn_rate: float) -> None:
        """Move the sensor at this velocity; the heading follows the motion."""
        self._velocity = velocity

    def stop(self) -> None:
        """Stand."""
        self._velocity = 0.0, 0.0

    def _spin(self, forward: float, turn: float, seconds: float) -> None:
        """Turn the wheels for some seconds: the axle moves on an arc, and the sensor ahead of it with it."""
        axle = self._x - self._offset * math.cos(self._heading), self._y - self._offset * math.sin(self._heading)
        middle, self._heading = self._heading + 0.5 * turn * seconds, math.remainder(self._heading + turn * seconds, 2.0 * math.pi)
        chord = forward * seconds * (1.0 if turn == 0.0 else math.sin(0.5 * turn * seconds) / (0.5 * turn * seconds))
        self._x = axle[0] + chord * math.cos(middle) + self._offset * math.cos(self._heading)
        self._y = axle[1] + chord * math.sin(middle) + self._offset * math.sin(self._heading)
