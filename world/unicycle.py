"""A tracking layer for platforms that cannot move sideways: from a velocity in the plane to forward speed and turn rate.

The sensor sits `offset` m ahead of the axle. That point can move in any direction: forward speed moves it ahead, turning moves it
sideways. With heading t and velocity (x, y) of the point,

    forward = x cos t + y sin t        turn = (y cos t - x sin t) / offset

moves it at exactly (x, y) at this instant. Where a limit is exceeded both are shortened by one factor, so the direction stays.

The error. Held for h s while the robot turns, the point leaves its course by at most |velocity| h (turn h / 2) per step. Over a tick
of dt s that is at most |velocity| dt turn_rate h / 2: 2.5 cm for 2 m/s, 0.25 s, 5 rad/s and h = 0.02 s. While the turn rate is at its limit
the point is slower than asked, by the factor offset turn_rate / |velocity| at worst. The heading follows the motion and obeys no command.
"""

import math

from protocol.message import Vector
from protocol.settings import LimitSettings


def twist(heading: float, velocity: Vector, offset: float, limits: LimitSettings) -> tuple[float, float]:
    """Forward speed m/s and turn rate rad/s that move the point `offset` m ahead of the axle at the velocity, m/s in the arena's frame."""
    east, north = math.cos(heading), math.sin(heading)
    forward = velocity[0] * east + velocity[1] * north
    turn = (velocity[1] * east - velocity[0] * north) / offset
    excess = max(
        1.0, abs(forward) / limits.speed if limits.speed else math.inf, abs(turn) / limits.turn_rate if limits.turn_rate else math.inf
    )
    return forward / excess, turn / excess
