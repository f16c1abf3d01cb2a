"""Control laws: the velocity in m/s and the turn rate in rad/s of a body, from the situation of its agent (18).

Data types: a `Situation` is the input of a control law; a `ControlInput` is its output ((vx, vy), turn rate).

Rules. A control law has a method `command(situation)`. `laws.control_law` makes the one that a scenario names.
Inputs that take time to compute are left out unless the law sets `uses_nearby_sensors` or `uses_surroundings`. Numbers in brackets
are equations of the paper.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np

from agents.gossip.table import GossipTable
from agents.tracking.particles import Particles
from protocol.geometry import EMPTY, polygon_centroid, wrap_angle
from protocol.pose import clip_motion
from protocol.random_streams import random_key
from protocol.sensing import Pose, SensorModel
from protocol.settings import LimitSettings

ControlInput = tuple[tuple[float, float], float]
STAND: ControlInput = ((0.0, 0.0), 0.0)


class Surroundings(NamedTuple):
    """What a law that announces goals reads besides."""

    density: Particles  # the particles everywhere that counted one tick before
    around: Particles  # those around the own cell, after the scans of this tick
    table: GossipTable  # the gossips of this tick
    partners: np.ndarray  # (K, 5): goal x, y in m, utilisation there, reach in m, 1 if the name comes before the own one
    goal: tuple[float, float]  # the own one, as it was announced, m
    is_open: bool  # targets cross the border of the arena


class Intent(NamedTuple):
    """What a law announces: its new goal in m, and its utilisation around the goal that it announced before."""

    goal: tuple[float, float]
    utilisation: float  # a multiple of what the sensor can hold


class Situation(NamedTuple):
    """The input of a control law."""

    name: str  # of the agent
    seed: int  # that all agents share
    tick: int  # of the round
    dt: float  # length of a tick, s
    pose: Pose  # x, y, heading of the own body, m, rad
    control_point: tuple[float, float]  # the point to drive to the centroid, m: the COD, or the position for plain Voronoi cells
    cell: np.ndarray  # (V, 2) m, empty when the agent has no cell
    centroid: tuple[float, float] | None  # m (17): of the PHD in the cell, of its area without mass, None without a cell
    particles: Particles  # in the cell
    sensor: SensorModel  # the own one
    limits: LimitSettings  # `speed` in m/s, `turn_rate` in rad/s
    heading: str  # "centroid" or "literal", the setting `control.heading`
    arena: tuple[float, float]  # width, height, m
    nearby_sensors: tuple[tuple[SensorModel, Pose], ...] = ()  # around the cell, that scanned; if a law `uses_nearby_sensors`
    generators: np.ndarray = EMPTY  # (N, 2) m, of the diagram
    own_generator: int = -1  # the row of the agent's generator; -1 without one
    surroundings: Surroundings | None = None  # if a law `uses_surroundings`
    ticks: int = 1  # for about so many the command will last


class ControlLaw(Protocol):
    """A law that drives a body."""

    uses_nearby_sensors: bool = False  # it reads `Situation.nearby_sensors`
    uses_surroundings: bool = False  # it reads `Situation.surroundings`
    intent: Intent | None = None  # after a command: what the next gossip announces

    def command(self, situation: Situation) -> ControlInput:
        """The velocity and turn rate until the next command, about `situation.ticks` ticks later."""


class Lloyd(ControlLaw):
    """The law of the paper: drives the COD to the centroid of the own cell and faces it (18); stands still without a cell."""

    def command(self, situation: Situation) -> ControlInput:
        return approach(situation, situation.centroid) if situation.centroid else STAND


class UniformDensity(ControlLaw):
    """Lloyd's algorithm for a uniform density: drives to the centroid of the area of the own cell."""

    def command(self, situation: Situation) -> ControlInput:
        middle = middle_of(situation.cell)
        return approach(situation, middle) if middle else STAND


class Static(ControlLaw):
    """Never moves the body."""

    def command(self, situation: Situation) -> ControlInput:
        return STAND


class RandomWalk(ControlLaw):
    """Drives to a random point of the arena, another one every 20 s."""

    def command(self, situation: Situation) -> ControlInput:
        leg = int(situation.tick * situation.dt // 20.0)
        bits = random_key(situation.seed, "waypoint", situation.name, leg)
        goal = ((bits >> 32) * 2.0**-32 * situation.arena[0], (bits & 0xFFFFFFFF) * 2.0**-32 * situation.arena[1])
        return approach(situation, goal)


def middle_of(cell: np.ndarray) -> tuple[float, float] | None:
    """The centroid of the area of a cell (V, 2), m; None without a cell."""
    if not len(cell):
        return None
    x, y = polygon_centroid(cell).tolist()
    return x, y


def approach(situation: Situation, goal: tuple[float, float]) -> ControlInput:
    """The command towards a goal, m: the control point reaches it by the next command and the body faces it, within the limits (18)."""
    dt = situation.dt * situation.ticks
    vx, vy = (goal[0] - situation.control_point[0]) / dt, (goal[1] - situation.control_point[1]) / dt
    seen_from = situation.control_point if situation.heading == "literal" else situation.pose
    dx, dy = goal[0] - seen_from[0], goal[1] - seen_from[1]
    turn = wrap_angle(math.atan2(dy, dx) - situation.pose[2]) / dt if dx or dy else 0.0
    return clip_motion((vx, vy), turn, situation.limits)
