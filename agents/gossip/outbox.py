"""The messages that an agent sends, made of its context and the result of its last round."""

from collections.abc import Mapping

from agents.coverage.capacity import place
from agents.round import AgentContext, RoundResult
from agents.tracking.particles import NONE
from protocol.fields import pack
from protocol.messages import Agreed, Command, Estimate, Gossip, Hello, Observation
from protocol.sensing import WedgeSensor

VERSION = "0.1.0"


def hello(context: AgentContext, incarnation: int, heard: tuple[str, ...], settings: Agreed) -> Hello:
    """The Hello of an agent: its sensor, its settings, and `heard`, the names of the peers that it hears."""
    return Hello(
        sender=context.name,
        incarnation=incarnation,
        software=f"covey {VERSION}",
        sensor_class=context.sensor_class,
        sensor=context.sensor if isinstance(context.sensor, WedgeSensor) else None,
        max_speed=context.config.limits.speed,
        max_turn_rate=context.config.limits.turn_rate,
        heard=heard,
        local=context.config.timing.interest == "neighbours",
        settings=settings,
    )


def gossip(context: AgentContext, incarnation: int, outcome: RoundResult, observation: Observation, *, listening: bool) -> Gossip:
    """The gossip of a tick: pose, scan and generator; and the owned particles, if the last round is that of the tick before."""
    owned = outcome.belief.mine
    current = outcome.belief.stamp == observation.tick - 1
    particles = owned.particles if current else NONE
    return Gossip(
        sender=context.name,
        incarnation=incarnation,
        tick=observation.tick,
        pose=observation.pose,
        cod=place(context.facts.cod_offset, observation.pose),
        power_radius=outcome.power_radius,
        unused=outcome.unused,
        detections_bytes=observation.detections_bytes,
        listening=listening,
        claim_tick=max(0, observation.tick - 1),
        claim_names=owned.claim.names if current else (),
        claim_bytes=pack(owned.claim.generators, "<f8") if current else b"",
        view=owned.view if current else 0,
        weight=float(particles.weights[0]) if len(particles.weights) else 0.0,
        states_bytes=pack(particles.states, "<f4"),
        ids_bytes=pack(particles.ids, "<u8"),
    )


def command(context: AgentContext, incarnation: int, outcome: RoundResult, tick: int) -> Command:
    """The command to the own body after the round `tick`."""
    velocity, turn_rate = outcome.command
    return Command(sender=context.name, incarnation=incarnation, tick=tick, velocity=velocity, turn_rate=turn_rate)


def estimate(
    context: AgentContext, incarnation: int, outcome: RoundResult, sent: Gossip, counters: Mapping[str, int], seconds: float
) -> Estimate:
    """The estimate for observers: the result of the round in which the agent `sent` a gossip, and its duration in `seconds`."""
    return Estimate(
        sender=context.name,
        incarnation=incarnation,
        tick=sent.tick,
        pose=sent.pose,
        cod=sent.cod,
        power_radius=sent.power_radius,
        unused=outcome.unused,
        load=outcome.load,
        mass=outcome.mass,
        cell_bytes=pack(outcome.cell, "<f8"),
        targets_bytes=pack(outcome.targets, "<f8"),
        view=outcome.belief.mine.view,
        neighbours=outcome.belief.mine.claim.names[1:],
        counters=dict(counters),
        round_seconds=seconds,
    )
