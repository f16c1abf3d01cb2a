"""Particles in six bytes each, for links of little bandwidth: places on a grid, directions instead of velocities, and ids that follow from
the sender and the tick.

An agent keeps the particles as it states them: `quantised` of `quantised` changes nothing. Receivers compute the same states and ids.
Layout, little-endian: float32 west and south of the grid, its step and the common speed; then for N particles their columns, their rows and
their directions, N uint16 each.
"""

import math

import numpy as np

from protocol.arithmetic import elementwise
from protocol.fields import MAX_ROWS, Malformed
from protocol.random_streams import random_key, scramble

STEP = 1.0 / 256.0  # m, of the grid; doubled until the cell fits into 16 bits
DIRECTIONS = np.array([(math.cos(2.0 * math.pi * n / 4096), math.sin(2.0 * math.pi * n / 4096)) for n in range(4096)])
HEAD_BYTES, ROW_BYTES = 16, 6  # bytes
LARGEST_GRID_NUMBER = 65535  # of a number of the grid


def packed(states: np.ndarray, speed: float) -> bytes:
    """The bytes of states (N, 4): x, y in m and a velocity of `speed` m/s; empty without particles."""
    if not len(states):
        return b""
    step = STEP
    while True:
        grid = np.rint(states[:, :2] / step)
        low = grid.min(axis=0)
        if (grid.max(axis=0) - low).max() <= LARGEST_GRID_NUMBER:
            break
        step *= 2.0
    turns = np.rint(elementwise(math.atan2, states[:, 3], states[:, 2]) * (4096 / (2.0 * math.pi))).astype(np.int64) % 4096
    numbers = np.concatenate([*(grid - low).T, turns])
    return np.array([*(low * step), step, speed], dtype="<f4").tobytes() + numbers.astype("<u2").tobytes()


def unpacked(data: bytes, sender: str, tick: int) -> tuple[np.ndarray, np.ndarray]:
    """States (N, 4) float32 and ids (N,) uint64, ascending, of the particles that a sender owns at the tick `tick`. Raises Malformed."""
    count, rest = divmod(len(data) - HEAD_BYTES, ROW_BYTES)
    if count < 1 or rest:
        raise Malformed("shape", f"particles: {len(data)} bytes are not {HEAD_BYTES} and a whole number of {ROW_BYTES}")
    if count > MAX_ROWS:
        raise Malformed("size", f"particles: {count} particles, at most {MAX_ROWS} are allowed")
    west, south, step, speed = np.frombuffer(data, "<f4", 4).astype(float).tolist()
    columns, rows, turns = np.frombuffer(data, "<u2", 3 * count, HEAD_BYTES).reshape(3, count)
    with np.errstate(all="ignore"):  # wrong bits give numbers that the check of the message refuses
        velocities = DIRECTIONS[turns % 4096] * speed
        states = np.column_stack([west + columns * step, south + rows * step, velocities]).astype("<f4")
    return states, np.sort(scramble(np.arange(count, dtype=np.uint64), random_key("compact", sender, tick)))


def quantised(states: np.ndarray, speed: float, sender: str, tick: int) -> tuple[np.ndarray, np.ndarray]:
    """The states (N, 4) and ids (N,) that receivers of `packed` compute."""
    if not len(states):
        return states, np.empty(0, dtype=np.uint64)
    return unpacked(packed(states, speed), sender, tick)
