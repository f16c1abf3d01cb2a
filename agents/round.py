"""One closed round: from what was heard of a tick to the belief, the cell and the command that follow.

`play` is a pure function of the outcome of the last round and of the gossips of this one, the agent's own included.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from agents.arithmetic import Arithmetic, Refreshed, Task
from agents.belief import Belief, Copies, Round, Share
from agents.capacity import SensorFacts, power_radius, sensor_facts, unused_capacity
from agents.cells import NO_CELL, Cell
from agents.chorus import chorus_of
from agents.claims import NO_CLAIM, Claim, make_claim
from agents.config import AgentConfig
from agents.control import STAND, Command, ControlLaw, Situation, control_law
from agents.neighbours import LOCAL_VIEW, Neighbours
from agents.places import Far
from agents.step import Step
from agents.words import Words, announced, side_by_side
from protocol.geometry import EMPTY, polygon_centroid, rectangle
from protocol.keys import order
from protocol.messages import Gossip
from protocol.sensing import Pose, SensorModel
from protocol.settings import sensor_of

HORIZON = 40.0  # m around the own cell: who hears but a part keeps no older copies of what lies farther away
NO_TARGETS = np.empty((0, 2))


class Self(NamedTuple):
    """What does not change about an agent."""

    name: str
    sensor: SensorModel
    facts: SensorFacts
    law: ControlLaw
    arithmetic: Arithmetic
    config: AgentConfig
    arena: np.ndarray  # its corners
    sensor_class: str = ""


def oneself(config: AgentConfig, name: str, sensor_class: str, arithmetic: Arithmetic) -> Self:
    """The agent of that name with a sensor of that class."""
    sensor, corners = sensor_of(config, sensor_class), rectangle(config.arena.width, config.arena.height)
    return Self(name, sensor, sensor_facts(sensor), control_law(config), arithmetic, config, corners, sensor_class)


@dataclass
class Outcome:
    """What a round leaves behind."""

    belief: Belief
    unused: float  # U, m^2
    load: float = 0.0  # expected targets in the footprint
    mass: float = 0.0  # expected targets in the cell
    cell: np.ndarray = field(default_factory=lambda: EMPTY)
    targets: np.ndarray = field(default_factory=lambda: NO_TARGETS)  # estimates in the cell, (M, 2) m
    command: Command = STAND

    @property
    def power_radius(self) -> float:
        """g(U), m (13)."""
        return power_radius(self.unused)


def play(me: Self, last: Outcome, neighbours: Neighbours, mine: Gossip, heard: dict[str, Gossip]) -> Outcome:
    """The outcome of the round of `mine.tick`, given the gossips of that tick by name, in the order of names."""
    config, tick, arithmetic = me.config, mine.tick, me.arithmetic
    step = Step(config, tick)
    words = _with_mine(me, neighbours, heard, mine)
    speaking = _speaking(me, neighbours, mine, heard, words)
    told = last.belief.awake(step, arithmetic).merge(words, tick, arithmetic, config)
    chorus = chorus_of(words, me.name, arithmetic, config, me.arena) if speaking is words is told else None
    if chorus is not None:
        place = words.names.index(me.name)
        cell, claim, near = chorus.parts.cells[place], chorus.parts.claims[place], chorus.refreshed(words, step)[place]
    else:
        cell = _own_cell(me, speaking, neighbours.far)
        claim = _claim(speaking, cell, neighbours.far)
        near = arithmetic.refresh(Task(me.name, me.sensor, mine.pose, told, words, arithmetic.births(step), cell.polygon, claim, step))
    updated, kept = near.updated, near.kept
    return Outcome(
        belief=Belief(
            stamp=tick,
            mine=Share(me.name, claim, kept, _view(neighbours, heard, speaking, claim)),
            copies=Copies(updated, Round(step, arithmetic, told, cell.polygon, claim, HORIZON if neighbours.local else math.inf)),
            everyone=speaking.everyone,
            acquainted=neighbours.acquainted if neighbours.local else None,
        ),
        unused=unused_capacity(me.facts.capability, near.detected, near.load, config.capacity),
        load=near.load,
        mass=near.mass,
        cell=cell.polygon,
        targets=near.targets,
        command=me.law.command(_situation(me, mine, cell, near, speaking, words)),
    )


def _with_mine(me: Self, neighbours: Neighbours, heard: dict[str, Gossip], mine: Gossip) -> Words:
    """Gossips in the order of names, mine in its place."""
    gossips = list(heard.values())
    gossips.insert(bisect_left(list(heard), order(mine.sender), key=order), mine)
    return _table(me, neighbours, gossips)


def _table(me: Self, neighbours: Neighbours, gossips: list[Gossip]) -> Words:
    """Gossips side by side, with the sensors that their senders announced."""
    circle, own = neighbours.circle, announced(me.name, me.sensor, me.config.detection.clutter)
    sensors = [own if gossip.sender == me.name else circle[gossip.sender].outfit for gossip in gossips]
    return side_by_side(gossips, sensors, me.config)  # type: ignore[arg-type]  # who was accepted has announced a sensor


def _speaking(me: Self, neighbours: Neighbours, mine: Gossip, heard: dict[str, Gossip], words: Words) -> Words:
    """All generators of the tick, mine included unless I listen."""
    if len(heard) == len(neighbours.circle) and not words.listening:
        return words
    speaking = neighbours.generators(mine.tick, heard)
    return _table(me, neighbours, list(speaking.values())) if mine.listening else _with_mine(me, neighbours, speaking, mine)


def _view(neighbours: Neighbours, heard: dict[str, Gossip], speaking: Words, claim: Claim) -> int:
    """Agents with equal views cut the same diagram: all that they know of it, or, when each hears a part only, that this part was whole.

    Two who heard their whole circles at the same tick cannot differ about a generator that both know. Who owns nothing needs no
    certificate: whom he does not know could only take from him.
    """
    if neighbours.local and (neighbours.certified or not claim.names) and len(heard) == len(neighbours.circle):
        return LOCAL_VIEW if neighbours.circle.keys() >= set(claim.names[1:]) else speaking.view
    return speaking.view


def _own_cell(me: Self, speaking: Words, far: Far) -> Cell:
    if me.name not in speaking.names:
        return NO_CELL
    points, radii = speaking.points, speaking.radii
    if len(far.generators):
        generators = np.concatenate([speaking.generators, far.generators])
        points, radii = generators[:, :2].copy(), generators[:, 2].copy()
    return me.arithmetic.cut(speaking.names.index(me.name), points, radii, me.arena)


def _claim(speaking: Words, cell: Cell, far: Far) -> Claim:
    """The cell as generators, the own one first; the names that speak are in order, so whose index is smaller comes first."""
    if not cell.bounds:
        return NO_CLAIM
    bounds = np.array(cell.bounds)
    if max(cell.bounds) < len(speaking.names):
        names = tuple([speaking.names[index] for index in cell.bounds])
        return Claim(names, speaking.generators[bounds], bounds < cell.bounds[0])
    everybody = (*speaking.names, *far.names())
    names = tuple([everybody[index] for index in cell.bounds])
    generators = np.concatenate([speaking.generators, far.generators])[bounds]
    return make_claim(names, generators, tuple([order(name) for name in names]))


def _centroid(near: Refreshed, cell: Cell) -> tuple[float, float] | None:
    """Centroid in m of the PHD in the cell (17); of the cell's area when there is no mass; None without a cell."""
    if near.mass > 0.0:
        return near.east / near.mass, near.north / near.mass
    if not len(cell.polygon):
        return None
    x, y = polygon_centroid(cell.polygon)
    return float(x), float(y)


def _situation(me: Self, mine: Gossip, cell: Cell, near: Refreshed, speaking: Words, words: Words) -> Situation:
    config = me.config
    return Situation(
        name=me.name,
        seed=config.filter.seed,
        tick=mine.tick,
        dt=config.run.dt,
        pose=mine.pose,
        driven=mine.pose[:2] if config.partition.kind == "voronoi" else mine.cod,
        cell=cell.polygon,
        centroid=_centroid(near, cell),
        particles=near.own,
        sensor=me.sensor,
        limits=config.limits,
        heading=config.control.heading,
        arena=(config.arena.width, config.arena.height),
        fields=_fields(me, cell, words) if getattr(me.law, "uses_fields", False) else (),
        generators=speaking.points,
        own_generator=speaking.names.index(me.name) if me.name in speaking.names else -1,
    )


def _fields(me: Self, cell: Cell, words: Words) -> tuple[tuple[SensorModel, Pose], ...]:
    """The sensors whose reach touches the region around my cell and that scanned in this tick, and their poses."""
    scanned = [(announced.sensor, gossip.pose) for announced, gossip in zip(words.sensors, words.gossips) if gossip.scanned]
    apart = me.arithmetic.distances(cell.polygon, np.array([pose for _, pose in scanned]).reshape(-1, 3)).tolist()
    return tuple(field for field, distance in zip(scanned, apart) if distance <= me.config.filter.halo + field[0].reach)
