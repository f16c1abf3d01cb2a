"""One closed round: from what was heard of a tick to the belief, the cell and the command that follow.

`run_round` is a pure function of the result of the last round and of the gossips of this one, the agent's own included. How targets are
tracked is the tracker's.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from agents.backend import Backend
from agents.config import AgentConfig
from agents.coverage.capacity import SensorFacts, power_radius, sensor_facts, unused_capacity
from agents.coverage.cells import NO_CELL, Cell
from agents.coverage.control import STAND, ControlInput, ControlLaw, Situation, control_law
from agents.gossip.table import GossipTable, announced_sensor, gossip_table
from agents.interest.position_table import UnsubscribedGenerators
from agents.membership.peer_table import LOCAL_VIEW, PeerTable
from agents.shared_round import claim_of, shared_round
from agents.tracking.belief import ParticlePhd
from agents.tracking.claims import Claim, make_claim
from agents.tracking.step import Step
from agents.tracking.tracker import AnyTracker, Diagram, RegionInput, TrackerState, Update
from protocol.geometry import EMPTY, distances, polygon_centroid, rectangle
from protocol.keys import order
from protocol.messages import Gossip
from protocol.sensing import Pose, SensorModel
from protocol.settings import sensor_of

HORIZON = 40.0  # m around the own cell: who hears but a part keeps no older copies of what lies farther away
NO_TARGETS = np.empty((0, 2))


class AgentContext(NamedTuple):
    """What does not change about an agent."""

    name: str
    sensor: SensorModel
    facts: SensorFacts
    law: ControlLaw
    backend: Backend
    tracker: AnyTracker
    config: AgentConfig
    arena: np.ndarray  # its corners
    sensor_class: str = ""


def context_of(config: AgentConfig, name: str, sensor_class: str, backend: Backend) -> AgentContext:
    """The agent of that name with a sensor of that class."""
    sensor, corners = sensor_of(config, sensor_class), rectangle(config.arena.width, config.arena.height)
    law, tracker = control_law(config), ParticlePhd(backend)
    return AgentContext(name, sensor, sensor_facts(sensor), law, backend, tracker, config, corners, sensor_class)


@dataclass
class RoundResult:
    """What a round leaves behind."""

    belief: TrackerState
    unused: float  # U, m^2
    load: float = 0.0  # expected targets in the footprint
    mass: float = 0.0  # expected targets in the cell
    cell: np.ndarray = field(default_factory=lambda: EMPTY)
    targets: np.ndarray = field(default_factory=lambda: NO_TARGETS)  # estimates in the cell, (M, 2) m
    command: ControlInput = STAND

    @property
    def power_radius(self) -> float:
        """g(U), m (13)."""
        return power_radius(self.unused)


def run_round(me: AgentContext, last: RoundResult, neighbours: PeerTable, mine: Gossip, heard: dict[str, Gossip]) -> RoundResult:
    """The result of the round of `mine.tick`, given the gossips of that tick by name, in the order of names."""
    config, step = me.config, Step(me.config, mine.tick)
    table = _with_mine(me, neighbours, heard, mine)
    speaking = _speaking(me, neighbours, mine, heard, table)
    received = me.tracker.merge(me.tracker.predict(last.belief, step), table, step)
    shared = shared_round(table, me.backend, me.tracker, step, me.arena) if speaking is table is received else None
    row = table.names.index(me.name)
    if shared is not None:
        region, near = shared.regions[row], shared.updates[row]
    else:
        cell = _own_cell(me, speaking, neighbours.far)
        region = RegionInput(me.name, row, me.sensor, mine.pose, cell.polygon, _claim(speaking, cell, neighbours.far))
        near = me.tracker.update(received, table, [region], step)[0]
    diagram = Diagram(
        view=_view(neighbours, heard, speaking, region.claim),
        everyone=speaking.everyone,
        acquainted=neighbours.acquainted if neighbours.local else None,
        horizon=HORIZON if neighbours.local else math.inf,
    )
    return RoundResult(
        belief=me.tracker.share(received, region, near, diagram, step),
        unused=unused_capacity(me.facts.capability, near.detected, near.load, config.capacity),
        load=near.load,
        mass=near.mass,
        cell=region.polygon,
        targets=near.targets,
        command=me.law.command(_situation(me, mine, region.polygon, near, speaking, table)),
    )


def _with_mine(me: AgentContext, neighbours: PeerTable, heard: dict[str, Gossip], mine: Gossip) -> GossipTable:
    """Gossips in the order of names, mine in its place."""
    gossips = list(heard.values())
    gossips.insert(bisect_left(list(heard), order(mine.sender), key=order), mine)
    return _table(me, neighbours, gossips)


def _table(me: AgentContext, neighbours: PeerTable, gossips: list[Gossip]) -> GossipTable:
    """Gossips side by side, with the sensors that their senders announced."""
    interest_set, own = neighbours.interest_set, announced_sensor(me.name, me.sensor, me.config.detection.clutter)
    sensors = [own if gossip.sender == me.name else interest_set[gossip.sender].announced for gossip in gossips]
    return gossip_table(gossips, sensors, me.config)  # type: ignore[arg-type]  # who was accepted has announced a sensor


def _speaking(me: AgentContext, neighbours: PeerTable, mine: Gossip, heard: dict[str, Gossip], table: GossipTable) -> GossipTable:
    """All generators of the tick, mine included unless I listen."""
    if len(heard) == len(neighbours.interest_set) and not table.listening:
        return table
    speaking = neighbours.generators(mine.tick, heard)
    return _table(me, neighbours, list(speaking.values())) if mine.listening else _with_mine(me, neighbours, speaking, mine)


def _view(neighbours: PeerTable, heard: dict[str, Gossip], speaking: GossipTable, claim: Claim) -> int:
    """Agents with equal views cut the same diagram: all that they know of it, or, when each hears a part only, that this part was whole.

    Two who heard their whole circles at the same tick cannot differ about a generator that both know. Who owns nothing needs no
    certificate: whom he does not know could only take from him.
    """
    if neighbours.local and (neighbours.certified or not claim.names) and len(heard) == len(neighbours.interest_set):
        return LOCAL_VIEW if neighbours.interest_set.keys() >= set(claim.names[1:]) else speaking.view
    return speaking.view


def _own_cell(me: AgentContext, speaking: GossipTable, far: UnsubscribedGenerators) -> Cell:
    if me.name not in speaking.names:
        return NO_CELL
    points, radii = speaking.points, speaking.radii
    if len(far.generators):
        generators = np.concatenate([speaking.generators, far.generators])
        points, radii = generators[:, :2].copy(), generators[:, 2].copy()
    return me.backend.cut_cells([speaking.names.index(me.name)], points, radii, me.arena)[0]


def _claim(speaking: GossipTable, cell: Cell, far: UnsubscribedGenerators) -> Claim:
    """The cell as generators, the own one first. The names that speak are in order; those far away come behind them in any order."""
    if not cell.bounds or max(cell.bounds) < len(speaking.names):
        return claim_of(cell, speaking.names, speaking.generators)
    everybody = (*speaking.names, *far.names())
    names = tuple([everybody[index] for index in cell.bounds])
    generators = np.concatenate([speaking.generators, far.generators])[np.array(cell.bounds)]
    return make_claim(names, generators, tuple([order(name) for name in names]))


def _centroid(near: Update, cell: np.ndarray) -> tuple[float, float] | None:
    """Centroid in m of the PHD in the cell (17); of the cell's area when there is no mass; None without a cell."""
    if near.mass > 0.0:
        return near.east / near.mass, near.north / near.mass
    if not len(cell):
        return None
    x, y = polygon_centroid(cell)
    return float(x), float(y)


def _situation(me: AgentContext, mine: Gossip, cell: np.ndarray, near: Update, speaking: GossipTable, table: GossipTable) -> Situation:
    config = me.config
    return Situation(
        name=me.name,
        seed=config.filter.seed,
        tick=mine.tick,
        dt=config.run.dt,
        pose=mine.pose,
        driven=mine.pose[:2] if config.partition.kind == "voronoi" else mine.cod,
        cell=cell,
        centroid=_centroid(near, cell),
        particles=near.own,
        sensor=me.sensor,
        limits=config.limits,
        heading=config.control.heading,
        arena=(config.arena.width, config.arena.height),
        fields=_fields(me, cell, table) if getattr(me.law, "uses_fields", False) else (),
        generators=speaking.points,
        own_generator=speaking.names.index(me.name) if me.name in speaking.names else -1,
    )


def _fields(me: AgentContext, cell: np.ndarray, table: GossipTable) -> tuple[tuple[SensorModel, Pose], ...]:
    """The sensors whose reach touches the region around my cell and that scanned in this tick, and their poses."""
    scanned = [(each.sensor, gossip.pose) for each, gossip in zip(table.sensors, table.gossips) if gossip.scanned]
    apart = distances(cell, np.array([pose for _, pose in scanned]).reshape(-1, 3)).tolist()
    return tuple(field for field, distance in zip(scanned, apart) if distance <= me.config.filter.halo + field[0].reach)
