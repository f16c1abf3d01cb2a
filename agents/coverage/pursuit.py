"""Pursuit: a control law beyond the paper whose sensor turns to mass out of sight; the law of the paper is `control.Lloyd`.

Data types: `Pursuit` keeps for each particle of the own cell the time of its last sight.

Rules. The heading is chosen among those reachable within the step: its footprint holds the most mass of the own cell, and mass out of
sight counts more. The body moves until its distance to the centroid is the distance of the COD, in any direction; Lloyd's law moves the
COD onto the centroid. An agent without a cell drives to the centroid of its Voronoi cell.
"""

import math

import numpy as np

from agents.coverage.capacity import sensor_facts
from agents.coverage.cells import power_cell
from agents.coverage.control import STAND, ControlInput, ControlLaw, Situation, middle_of
from agents.tracking.particles import total
from protocol.arithmetic import elementwise
from protocol.geometry import rectangle, wrap_angle
from protocol.pose import clip

HEADING_COUNT = 37  # compared headings, between the reachable extremes
VALUE_IN_VIEW = 0.1  # weight of mass in view in this tick
REGAIN_TIME = 0.5  # s: mass out of sight for this time has regained most of its weight
STALE_AGE = 5.0  # s: mass out of sight for longer has weight `STALE_WEIGHT` in the centroid
STALE_WEIGHT = 0.1
NEW_PARTICLE_AGE = 2.5  # s: the time out of sight assumed for a particle new in the cell


class Pursuit(ControlLaw):
    """The pursuit law, with the time when each particle of the own cell was last in a field of view, by particle id."""

    uses_nearby_sensors = True

    def __init__(self) -> None:
        self._ids = np.empty(0, dtype=np.uint64)  # ascending
        self._seen = np.empty(0)  # s of world time

    def command(self, situation: Situation) -> ControlInput:
        """Velocity and turn rate until the next command."""
        ages = self._ages(situation)
        goal = _goal(situation, ages)
        if goal is None:
            return STAND
        x, y, heading = situation.pose
        vx, vy = _lead((x, y), goal, math.hypot(*sensor_facts(situation.sensor).cod_offset), situation)
        seconds = situation.dt * situation.ticks
        place = x + vx * seconds, y + vy * seconds
        turn = _best_turn(situation, ages, place)
        if turn is None:
            turn = wrap_angle(math.atan2(goal[1] - place[1], goal[0] - place[0]) - heading)
        return (vx, vy), clip(turn / seconds, situation.limits.turn_rate)

    def _ages(self, situation: Situation) -> np.ndarray:
        """Times since each particle was last in sight, s: (N,)."""
        particles, now = situation.particles, situation.tick * situation.dt
        seen = np.full(len(particles.ids), now - NEW_PARTICLE_AGE)
        if len(self._ids):
            places = np.minimum(np.searchsorted(self._ids, particles.ids), len(self._ids) - 1)
            seen = np.where(self._ids[places] == particles.ids, self._seen[places], seen)
        for sensor, pose in situation.nearby_sensors:
            seen[sensor.probability(particles.states[:, :2], pose) > 0.0] = now
        self._ids, self._seen = particles.ids, seen
        return now - seen


def _goal(situation: Situation, ages: np.ndarray) -> tuple[float, float] | None:
    """The goal, m: the centroid of the mass in the cell with stale mass at `STALE_WEIGHT`.

    Without mass it is the centroid of the situation, without a cell the centroid of the Voronoi cell, and None without either.
    """
    weights = situation.particles.weights * np.where(ages > STALE_AGE, STALE_WEIGHT, 1.0)
    mass = total(weights)
    if mass > 0.0:
        x, y = (total(weights * situation.particles.states[:, axis]) / mass for axis in (0, 1))
        return x, y
    if situation.centroid is not None:
        return situation.centroid
    if situation.own_generator < 0:
        return None
    arena, points = rectangle(*situation.arena), situation.generators
    return middle_of(power_cell(situation.own_generator, points, np.zeros(len(points)), arena))


def _lead(place: tuple[float, float], goal: tuple[float, float], offset: float, situation: Situation) -> tuple[float, float]:
    """The velocity in m/s that brings the distance from `place` to the goal closest to `offset` m by the next command."""
    dx, dy = goal[0] - place[0], goal[1] - place[1]
    apart = math.hypot(dx, dy)
    if apart == 0.0:
        return 0.0, 0.0
    speed = clip((apart - offset) / (situation.dt * situation.ticks), situation.limits.speed)
    return speed * dx / apart, speed * dy / apart


def _best_turn(situation: Situation, ages: np.ndarray, place: tuple[float, float]) -> float | None:
    """The turn in rad after which the footprint at `place` holds the most mass out of sight; None if no footprint holds mass."""
    particles, heading = situation.particles, situation.pose[2]
    reach = situation.sensor.reach
    dx, dy = particles.states[:, 0] - place[0], particles.states[:, 1] - place[1]
    near = dx * dx + dy * dy <= reach * reach
    if not near.any():
        return None
    points = particles.states[near, :2]
    values = particles.weights[near] * (VALUE_IN_VIEW + 1.0 - elementwise(math.exp, -ages[near] / REGAIN_TIME))
    most = min(math.pi, situation.limits.turn_rate * situation.dt * situation.ticks)
    turns = sorted(np.linspace(-most, most, HEADING_COUNT).tolist(), key=abs)  # the least turn first, so that it wins ties
    held = [total(situation.sensor.probability(points, (*place, heading + turn)) * values) for turn in turns]
    best = max(range(HEADING_COUNT), key=held.__getitem__)
    return turns[best] if held[best] > 0.0 else None
