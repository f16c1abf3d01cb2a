"""Targets: the ground truth of what moves, as arrays of positions (T, 2) m, headings (T,) rad and ids (T,) uint64.

Tracks depend on the seed, the scenario and the number of ticks alone, never on the sensors. Two runs with the same seed see the same
targets whatever the swarm does. A restarted world reaches tick k again by stepping k times.
"""

import math
from typing import Protocol

import numpy as np

from protocol.arithmetic import elementwise
from protocol.fields import MAX_DETECTIONS
from protocol.random_streams import normal, random_key, scramble, stream
from protocol.settings import ArenaSettings, BadSetting
from protocol.user_classes import as_bad_setting, build, real_array, shown
from world.config import TargetSettings


class Motion(Protocol):
    """How targets move on an unbounded plane; a scenario's own `module:Class` is built as Class(settings, dt, seed)."""

    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions (T, 2) and headings (T,) one tick after `tick`; random numbers must be keyed by (seed, id, tick)."""


class ConstantSpeed:
    """Constant speed; the heading is a random walk of `heading_noise` rad/sqrt(s) (paper, section IV)."""

    def __init__(self, settings: TargetSettings, dt: float, seed: int) -> None:
        self._step = settings.speed * dt
        self._turn = settings.heading_noise * math.sqrt(dt)
        self._seed = seed

    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> tuple[np.ndarray, np.ndarray]:
        """Turn by a keyed normal variate, then go straight for one tick."""
        if self._turn > 0.0:
            headings = headings + self._turn * normal(scramble(ids, random_key(self._seed, "heading", tick)))
        return positions + self._step * _directions(headings), headings


def _directions(headings: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 2) of headings (N,)."""
    return np.column_stack([elementwise(math.cos, headings), elementwise(math.sin, headings)])


def build_motion(settings: TargetSettings, dt: float, seed: int) -> Motion:
    """The motion that a scenario names; raises BadSetting naming the field."""
    if settings.motion == "constant-speed":
        return ConstantSpeed(settings, dt, seed)
    try:
        motion = build(settings.motion, "Class(settings, dt, seed) with a method move", ("move",), settings, dt, seed)
    except ValueError as error:
        raise BadSetting(f"targets.motion = {settings.motion!r}: {error}; should be constant-speed or module:Class") from error.__cause__
    return CheckedMotion(motion, settings.motion)


class CheckedMotion:
    """A motion of the user's own: an answer that is none raises BadSetting naming the class."""

    def __init__(self, motion: Motion, name: str) -> None:
        self._motion, self._name = motion, name

    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> tuple[np.ndarray, np.ndarray]:
        """As the motion says."""
        what = f"{self._name}.move of {len(ids)} targets"
        with as_bad_setting(what):
            answer = self._motion.move(positions.copy(), headings.copy(), ids.copy(), tick)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise BadSetting(f"{what} returned {shown(answer)}: should be positions (T, 2) and headings (T,)")
        count = len(ids)
        return real_array(f"{what}, positions:", answer[0], (count, 2)), real_array(f"{what}, headings:", answer[1], (count,))


def arrival_rate(settings: TargetSettings, arena: ArenaSettings) -> float:
    """Expected targets that enter per second, density x speed x perimeter / pi: what leaves a uniform crowd, so the mean number stays."""
    density = settings.count / (arena.width * arena.height)
    return density * settings.speed * 2.0 * (arena.width + arena.height) / math.pi


def arrivals(rng: np.random.Generator, number: int, arena: ArenaSettings, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 2) and headings (N,) at a tick's end of `number` targets that entered during it.

    Each crosses the border at a uniform place and time of the tick, by the cosine law inward, and goes on straight.
    `step` is the way of a whole tick, m. One that has cut a corner and left again is not returned.
    """
    draws = rng.random((number, 3))
    along = draws[:, 0] * 2.0 * (arena.width + arena.height)
    corners = np.array([0.0, arena.width, arena.width + arena.height, 2.0 * arena.width + arena.height])
    side = np.searchsorted(corners, along, side="right") - 1  # south, east, north, west; walked counter-clockwise
    offset = along - corners[side]
    x = np.choose(side, [offset, arena.width, arena.width - offset, 0.0])
    y = np.choose(side, [0.0, offset, arena.height, arena.height - offset])
    headings = wrap((side + 1.0) * (math.pi / 2.0) + elementwise(math.asin, 2.0 * draws[:, 1] - 1.0))
    way = step * draws[:, 2]
    positions = np.column_stack([x, y]) + way[:, None] * _directions(headings)
    kept = arena.holds(*positions.T)
    return positions[kept], headings[kept]


def wrap(headings: np.ndarray) -> np.ndarray:
    """The same directions in [-pi, pi): (N,)."""
    return (headings + math.pi) % (2.0 * math.pi) - math.pi


def reflect(positions: np.ndarray, headings: np.ndarray, arena: ArenaSettings) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 2) folded back into the arena and headings (N,) mirrored as often as the way met a wall (specular reflection)."""
    x, x_mirrored = _fold(positions[:, 0], arena.width)
    y, y_mirrored = _fold(positions[:, 1], arena.height)
    headings = np.where(x_mirrored, math.pi - headings, headings)
    return np.column_stack([x, y]), np.where(y_mirrored, -headings, headings)


def _fold(values: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    unfolded = values % (2.0 * size)
    mirrored = unfolded > size
    return np.where(mirrored, 2.0 * size - unfolded, unfolded), mirrored


class Targets:
    """All targets at the current tick; `step` goes on to the next. Arrays are replaced by a step, never changed in place."""

    def __init__(self, settings: TargetSettings, arena: ArenaSettings, dt: float, seed: int) -> None:
        self._settings, self._arena, self._seed = settings, arena, seed
        self._motion = build_motion(settings, dt, seed)
        self._arrivals_per_tick = arrival_rate(settings, arena) * dt
        self._way = settings.speed * dt
        draws = stream(seed, "targets").random((settings.count, 3))  # row by row: more targets leave the first ones as they were
        self.tick = 0
        self.positions = draws[:, :2] * np.array([arena.width, arena.height])
        self.headings = wrap(draws[:, 2] * (2.0 * math.pi))
        self.ids = np.arange(1, settings.count + 1, dtype=np.uint64)
        self._next_id = settings.count + 1

    def step(self) -> None:
        """Move everything on by one tick, and settle what happens at the border."""
        positions, headings = self._motion.move(self.positions, self.headings, self.ids, self.tick)
        if self._settings.border == "reflect":
            self.positions, headings = reflect(positions, headings, self._arena)
            self.headings = wrap(headings)
        else:
            kept = self._arena.holds(*positions.T)
            self.positions, self.headings, self.ids = positions[kept], wrap(headings[kept]), self.ids[kept]
            self._enter()
        self.tick += 1

    def place(self, number: int, position: tuple[float, float]) -> None:
        """Put the target of an id somewhere in the arena, m; no effect when it has left. Its heading stays."""
        self.positions = np.where((self.ids == number)[:, None], np.array(position), self.positions)

    def _enter(self) -> None:
        rng = stream(self._seed, "arrivals", self.tick)
        number = int(rng.poisson(self._arrivals_per_tick))
        if not number:
            return
        positions, headings = arrivals(rng, number, self._arena, self._way)
        room = MAX_DETECTIONS - len(self.ids)  # more would not fit into one message
        positions, headings = positions[:room], headings[:room]
        self.positions = np.vstack([self.positions, positions])
        self.headings = np.concatenate([self.headings, headings])
        self.ids = np.concatenate([self.ids, np.arange(self._next_id, self._next_id + len(positions), dtype=np.uint64)])
        self._next_id += len(positions)
