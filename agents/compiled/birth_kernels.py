"""Compiled background births: the bit-for-bit twin of `births.background_births`, without a temporary array for each operation.

Rules as in agents/compiled/particle_kernels.py.
"""

import math

import numpy as np

from agents.compiled.cache import cached
from agents.compiled.particle_kernels import scramble, uniform

_S52 = np.uint64(52)


@cached
def background(
    count: int, on_border: int, salt: np.uint64, width: float, height: float, speed: float, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """States (count, 4) and ids (count,) of the births of the tick with key `salt`; the first `on_border` start on the border."""
    states, ids = np.empty((count, 4)), np.empty(count, np.uint64)
    perimeter = 2.0 * (width + height)
    for row in range(count):
        new_id = ids[row] = scramble(np.uint64(row), salt)
        along = uniform(scramble(new_id, np.uint64(1))) * perimeter
        if row < on_border:
            sideways = 2.0 * uniform(scramble(new_id, np.uint64(2))) - 1.0
            inward = math.sqrt(1.0 - sideways * sideways)
            if along < width:  # south, then counter-clockwise: a corner, the tangent from it, and the normal inwards
                rest, corner, tangent, normal = along, (0.0, 0.0), (1.0, 0.0), (0.0, 1.0)
            elif along < width + height:
                rest, corner, tangent, normal = along - width, (width, 0.0), (0.0, 1.0), (-1.0, 0.0)
            elif along < 2.0 * width + height:
                rest, corner, tangent, normal = along - (width + height), (width, height), (-1.0, 0.0), (0.0, -1.0)
            else:
                rest, corner, tangent, normal = along - (2.0 * width + height), (0.0, height), (0.0, -1.0), (1.0, 0.0)
            x, y = corner[0] + tangent[0] * rest, corner[1] + tangent[1] * rest
            vx, vy = tangent[0] * sideways + normal[0] * inward, tangent[1] * sideways + normal[1] * inward
        else:
            x, y = along / perimeter * width, uniform(scramble(new_id, np.uint64(4))) * height
            direction = directions[np.int64(scramble(new_id, np.uint64(3)) >> _S52)]
            vx, vy = direction[0], direction[1]
        states[row, 0], states[row, 1], states[row, 2], states[row, 3] = x, y, vx * speed, vy * speed
    return states, ids
