"""The messages that an agent sends, made of its context and the result of its last round."""

from collections.abc import Mapping
from typing import Any

import msgspec

from agents.coverage.capacity import to_world
from agents.coverage.control import ControlInput
from agents.round import AgentContext, RoundResult
from protocol.fields import LARGEST_NUMBER, pack
from protocol.message import SharedSettings, Vector
from protocol.messages import UNKNOWN_AGE, Command, Gossip, Hello, Observation
from protocol.observer_messages import Estimate
from protocol.sensing import WedgeSensor

VERSION = "0.1.0"


def hello(context: AgentContext, heard: tuple[str, ...], settings: SharedSettings) -> Hello:
    """The Hello of an agent: its sensor, its settings, and `heard`, the names of the peers that it hears."""
    return Hello(
        sender=context.name,
        incarnation=context.incarnation,
        software=f"covey {VERSION}",
        sensor_class=context.sensor_class,
        sensor=context.sensor if isinstance(context.sensor, WedgeSensor) else None,
        heard=heard,
        neighbours_only=context.config.timing.interest == "neighbours",
        settings=settings,
    )


def gossip(
    context: AgentContext,
    outcome: RoundResult,
    observation: Observation,
    *,
    listening: bool,
    pace: int,
    behind: int,
    lag: int,
    pose_noise: Vector | None,
) -> Gossip:
    """The gossip of a tick: pose, scan and generator; and the owned state, if the last round is that of the tick before.

    `behind`: the number of rounds before this tick that are still to be played. `pose_noise`: standard deviations of the pose, m and rad.
    """
    owned = outcome.belief.mine
    current = outcome.belief.tick == observation.tick - 1 - behind
    said = context.tracker.gossip_fields(owned, context.config.filter) if current else {}
    plan: dict[str, Any] = {}
    if outcome.intent is not None:  # of a sensor that can hold hardly anything, the utilisation has no limit
        plan = {"goal": outcome.intent.goal, "goal_utilisation": min(outcome.intent.utilisation, LARGEST_NUMBER)}
    return Gossip(
        sender=context.name,
        incarnation=context.incarnation,
        tick=observation.tick,
        pose=observation.pose,
        cod=to_world(context.announced.facts.cod_offset, observation.pose),
        power_radius=outcome.power_radius,
        unused=outcome.unused,
        detections_bytes=observation.detections_bytes,
        scanned=observation.scanned,
        listening=listening,
        claim_tick=max(0, outcome.belief.claim_tick if current else observation.tick - 1),
        claim_names=owned.claim.names if current else (),
        claim_bytes=pack(owned.claim.generators, "<f8") if current else b"",
        diagram_hash=owned.diagram_hash if current else 0,
        pace=pace,
        behind=behind if current else 0,
        lag=lag,
        pose_noise=pose_noise,
        claim_ages=_claim_ages(outcome) if current else b"",
        **said,
        **plan,
    )


def without_scan(gossip: Gossip, tick: int) -> Gossip:
    """The gossip as it would be at a tick of which the agent saw nothing."""
    return msgspec.structs.replace(gossip, tick=tick, scanned=False, detections_bytes=b"")


def _claim_ages(outcome: RoundResult) -> bytes:
    """By how many ticks each generator of the claim is older than the round in which it was cut; empty: all are of that round."""
    names, round_cell = outcome.belief.mine.claim.names, outcome.round_cell
    if round_cell is None or (not round_cell.generator_table.ages and round_cell.generator_table.name_set.issuperset(names)):
        return b""
    ages, known = round_cell.generator_table.ages, round_cell.generator_table.name_set
    found = bytes([min(UNKNOWN_AGE, ages.get(name, 0)) if name in known else UNKNOWN_AGE for name in names])
    return found if any(found) else b""


def command(context: AgentContext, motion: ControlInput, tick: int) -> Command:
    """The command to the own body after the round `tick`."""
    velocity, turn_rate = motion
    return Command(sender=context.name, incarnation=context.incarnation, tick=tick, velocity=velocity, turn_rate=turn_rate)


def estimate(
    context: AgentContext,
    outcome: RoundResult,
    sent: Gossip,
    counters: Mapping[str, int],
    round_seconds: float,
    pace: int,
) -> Estimate:
    """The estimate for observers: a result for the tick of the own gossip `sent`, and what the last shared round cost."""
    return Estimate(
        sender=context.name,
        incarnation=context.incarnation,
        tick=sent.tick,
        pose=sent.pose,
        cod=sent.cod,
        power_radius=sent.power_radius,
        unused=outcome.unused,
        load=outcome.load,
        mass=outcome.mass,
        cell_bytes=pack(outcome.cell, "<f8"),
        targets_bytes=pack(outcome.estimates.positions, "<f8"),
        details_bytes=pack(outcome.estimates.details, "<f4"),
        labels_bytes=pack(outcome.estimates.labels, "<u8"),
        diagram_hash=outcome.belief.mine.diagram_hash,
        neighbours=outcome.belief.mine.claim.names[1:],
        counters=dict(counters),
        round_seconds=round_seconds,
        pace=pace,
    )
