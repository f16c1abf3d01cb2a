"""One closed round: the belief, the cell and the command that follow from the gossips of a tick.

What `run_round` returns follows from its arguments alone: the last result, the peer table and the gossips of this tick, the own one
included. Only a control law may have a memory. What is computed once is kept in them: the copies of the last belief, and what all agents
with one table share (`batched_round`). The tracker decides how targets are tracked.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from agents.backend import Backend
from agents.batched_round import batched_round
from agents.config import AgentConfig
from agents.coverage.capacity import power_radius, unused_capacity
from agents.coverage.control import STAND, ControlInput, ControlLaw, Intent, Situation, Surroundings, middle_of
from agents.coverage.laws import control_law
from agents.gossip.table import REACH, AnnouncedSensor, GossipTable, announced_sensor, gossip_table
from agents.interest.position_table import UnsubscribedGenerators
from agents.membership.peer_table import COMPLETE_SET_HASH, PeerTable
from agents.tracking.belief import ParticlePhd
from agents.tracking.claims import NO_CLAIM, Claim, claim_of
from agents.tracking.extraction import NO_ESTIMATES, TargetEstimates
from agents.tracking.gaussian_belief import MixturePhd
from agents.tracking.step import Step
from agents.tracking.tracker import Belief, KnownDiagram, RegionInput, RegionUpdate, Tracker
from protocol.geometry import EMPTY, distances, rectangle
from protocol.keys import order
from protocol.messages import Gossip
from protocol.sensing import Pose, SensorModel
from protocol.settings import BadSetting, sensor_of

COPY_DISTANCE = (
    40.0  # m around the own cell; with neighbours only, an agent that has a cell keeps no older copies of particles farther away
)


class AgentContext(NamedTuple):
    """What stays the same in all rounds of an agent: its name, incarnation, sensor, settings, control law, backend and tracker."""

    name: str
    sensor: SensorModel
    announced: AnnouncedSensor  # the same sensor, as peers know it
    law: ControlLaw
    backend: Backend
    tracker: Tracker
    config: AgentConfig
    arena: np.ndarray  # corners (4, 2), m
    sensor_class: str
    incarnation: int = 1


def context_of(config: AgentConfig, name: str, sensor_class: str, backend: Backend, incarnation: int = 1) -> AgentContext:
    """The context of the agent `name` with a sensor of that class. Raises BadSetting for a class that is unknown or cannot be used."""
    sensor, corners = sensor_of(config, sensor_class), rectangle(config.arena.width, config.arena.height)
    if reason := config.why_not(sensor):
        raise BadSetting(f"sensors.{sensor_class}.{reason}")
    tracker: Tracker = MixturePhd(backend) if config.filter.kind == "gaussian-mixture" else ParticlePhd(backend)
    try:
        announced = announced_sensor(name, sensor, config.detection.clutter)
    except BadSetting as error:
        raise BadSetting(f"sensors.{sensor_class}: {error}") from error.__cause__
    law = control_law(config, backend)
    return AgentContext(name, sensor, announced, law, backend, tracker, config, corners, sensor_class, incarnation)


class RoundCell(NamedTuple):
    """The own cell of a round and the gossips whose generators it was cut from."""

    region: RegionInput
    generator_table: GossipTable


Replay = Callable[[GossipTable, np.ndarray], Any]  # see `look_ahead.replayed_density`


@dataclass
class RoundResult:
    """The result of a round."""

    belief: Belief
    unused: float  # U, m^2
    load: float = 0.0  # expected targets in the footprint
    mass: float = 0.0  # expected targets in the cell
    cell: np.ndarray = field(default_factory=lambda: EMPTY)
    estimates: TargetEstimates = NO_ESTIMATES  # estimates in the cell
    command: ControlInput = STAND
    intent: Intent | None = None  # for the next gossip
    round_cell: RoundCell | None = None  # of the round; None: none was played
    density: Any = None  # around the cell, as the tracker represents it; with it a round that is played alone begins

    @property
    def power_radius(self) -> float:
        """g(U), m (13)."""
        return power_radius(self.unused)


def result_at_start(context: AgentContext, box: tuple[float, float, float, float] | None = None) -> RoundResult:
    """The result before the first round: the prior, in the surroundings of a `box` alone if one is given, and all capacity unused."""
    return RoundResult(context.tracker.start(context.name, context.config, box), context.announced.facts.capability)


def run_round(
    context: AgentContext,
    last: RoundResult,
    peer_table: PeerTable,
    own: Gossip,
    fresh: dict[str, Gossip],
    replay: Replay | None = None,
    ticks: int = 1,
) -> RoundResult:
    """The result of the round of `own.tick`.

    `fresh` holds the gossips of that tick by name, in the order of names. `own` is the gossip of this agent. `replay` computes the
    density of the tick before where gossips state older ones. The command is to last some `ticks`; 0: there is none.
    """
    step, batched = Step(context.config, own.tick), None
    table = _with_own(context, peer_table, fresh, own)
    generator_table = _generator_table(context, peer_table, own, fresh, table)
    row = table.names.index(context.name)
    if replay is None:
        density = context.tracker.merge(context.tracker.catch_up(last.belief, step), table, step)
        if generator_table is table is density:
            batched = batched_round(table, context.backend, context.tracker, step, context.arena)
    if batched is not None:
        region, update = batched.regions[row], batched.updates[row]
    else:
        polygon, claim = _own_cell(context, generator_table, peer_table.unsubscribed)
        region = RegionInput(context.name, row, context.sensor, own.pose, polygon, claim)
        if replay is not None:
            density = replay(table, polygon)
        update = context.tracker.update(density, table, [region], step)[0]
    diagram = KnownDiagram(
        hash=_diagram_hash(peer_table, fresh, generator_table, region.claim),
        generator_names=generator_table.name_set,
        known_names=peer_table.known_names if peer_table.neighbours_only else None,
        copy_distance=COPY_DISTANCE if peer_table.neighbours_only and len(region.polygon) else math.inf,
    )
    belief = context.tracker.belief_after(density, region, update, diagram, step)
    return result_of(context, own, RoundCell(region, generator_table), update, table, density, belief, ticks)


def result_of(
    context: AgentContext,
    own: Gossip,
    round_cell: RoundCell,
    update: RegionUpdate,
    table: GossipTable,
    density: Any,
    belief: Belief,
    ticks: int,
) -> RoundResult:
    """The result of an `update` of the own cell at the pose of `own`; `ticks`: how long the command is to last, 0: there is none."""
    command = STAND
    if ticks:
        situation = _situation(context, own, round_cell.region.polygon, update, round_cell.generator_table, table, ticks)
        if context.law.uses_surroundings:
            situation = situation._replace(surroundings=_surroundings(context, own, density, update, table, round_cell.generator_table))
        command = context.law.command(situation)
    return RoundResult(
        belief=belief,
        unused=unused_capacity(context.announced.facts.capability, update.detected, update.load, context.config.capacity),
        load=update.load,
        mass=update.mass,
        cell=round_cell.region.polygon,
        estimates=update.estimates,
        command=command,
        intent=context.law.intent,
        round_cell=round_cell,
        density=update.updated,
    )


def _surroundings(
    context: AgentContext,
    own: Gossip,
    density: Any,
    update: RegionUpdate,
    table: GossipTable,
    generator_table: GossipTable,
) -> Surroundings:
    """What a law that announces goals reads besides the situation."""
    names = generator_table.names
    comes_first = np.arange(len(names)) < bisect_left(names, order(own.sender), key=order)
    partners = np.column_stack([generator_table.plans, generator_table.table[:, REACH], comes_first])
    return Surroundings(
        density=context.tracker.weighted_points(density),
        around=context.tracker.weighted_points(update.updated),
        table=table,
        partners=partners[[name != own.sender for name in names]],
        goal=own.goal if own.goal is not None else own.pose[:2],
        is_open=context.config.filter.border == "cross",
    )


def _with_own(context: AgentContext, peer_table: PeerTable, fresh: dict[str, Gossip], own: Gossip) -> GossipTable:
    """The gossips in the order of names, the own one in its place."""
    gossips, sensors, place = [*fresh.values()], _sensors(peer_table, fresh), bisect_left([*fresh], order(own.sender), key=order)
    gossips.insert(place, own)
    sensors.insert(place, context.announced)
    return gossip_table(gossips, sensors, context.config)


def _sensors(peer_table: PeerTable, names: Iterable[str]) -> list[AnnouncedSensor]:
    """The sensors that these peers announced."""
    interest_set = peer_table.interest_set
    return [interest_set[name].announced for name in names]  # type: ignore[misc]  # every accepted sender has announced a sensor


def _generator_table(
    context: AgentContext, peer_table: PeerTable, own: Gossip, fresh: dict[str, Gossip], table: GossipTable
) -> GossipTable:
    """The gossips that give the generators of the tick. The own one is among them unless the agent listens."""
    if len(fresh) == len(peer_table.interest_set) and not table.listening:
        return table
    latest = peer_table.generator_gossips(own.tick, fresh)
    if not own.listening:
        return _with_own(context, peer_table, latest, own)
    return gossip_table([*latest.values()], _sensors(peer_table, latest), context.config)


def _diagram_hash(peer_table: PeerTable, fresh: dict[str, Gossip], generator_table: GossipTable, claim: Claim) -> int:
    """The hash of the diagram of a round: agents with equal hashes cut the same diagram.

    In a swarm that hears everybody it is a hash of all generators. With neighbours only, `COMPLETE_SET_HASH` states that all gossips
    of the interest set came in time. Two agents with complete interest sets in the same tick agree about every generator that both know. An
    agent with an empty cell need not be certified: unknown peers could only shrink its cell.
    """
    if peer_table.neighbours_only and (peer_table.certified or not claim.names) and len(fresh) == len(peer_table.interest_set):
        return COMPLETE_SET_HASH if peer_table.interest_set.keys() >= set(claim.names[1:]) else generator_table.diagram_hash
    return generator_table.diagram_hash


def _own_cell(context: AgentContext, generator_table: GossipTable, unsubscribed: UnsubscribedGenerators) -> tuple[np.ndarray, Claim]:
    """The own cell (V, 2) m and the claim to it: its generators, the own one first. Both are empty while the agent listens."""
    if context.name not in generator_table.names:
        return EMPTY, NO_CLAIM
    names = generator_table.names
    generators = np.concatenate([generator_table.generators, unsubscribed.generators])
    cell = context.backend.cut_cells([names.index(context.name)], generators, context.arena)[0]
    if max(cell.bounding, default=0) >= len(names):  # rarely does a peer that is not heard bound the cell
        names = (*names, *unsubscribed.names())
    return cell.polygon, claim_of(cell, names, generators)


def _situation(
    context: AgentContext, own: Gossip, cell: np.ndarray, update: RegionUpdate, generator_table: GossipTable, table: GossipTable, ticks: int
) -> Situation:
    """What the control law reads; `ticks`: how long the command is to last."""
    config = context.config
    return Situation(
        name=context.name,
        seed=config.filter.seed,
        tick=own.tick,
        dt=config.run.dt,
        pose=own.pose,
        control_point=own.pose[:2] if config.partition.kind == "voronoi" else own.cod,
        cell=cell,
        centroid=(update.moment_x / update.mass, update.moment_y / update.mass) if update.mass > 0.0 else middle_of(cell),  # (17)
        particles=context.tracker.weighted_points(update.own),
        sensor=context.sensor,
        limits=config.limits,
        heading=config.control.heading,
        arena=(config.arena.width, config.arena.height),
        nearby_sensors=_nearby_sensors(context, cell, table) if context.law.uses_nearby_sensors else (),
        generators=generator_table.generators[:, :2],
        own_generator=generator_table.names.index(context.name) if context.name in generator_table.names else -1,
        ticks=ticks,
    )


def _nearby_sensors(context: AgentContext, cell: np.ndarray, table: GossipTable) -> tuple[tuple[SensorModel, Pose], ...]:
    """Sensor and pose of each agent that scanned in this tick and reaches the surroundings of the cell."""
    apart = distances(cell, np.array([pose for _, pose in table.views]).reshape(-1, 3)).tolist()
    return tuple(field for field, distance in zip(table.views, apart) if distance <= context.config.filter.halo + field[0].reach)
