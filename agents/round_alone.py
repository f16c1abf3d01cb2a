"""The ticks that an agent plays alone: the gossip-free ones of a slower pace, and a shared one while its gossips are still out.

At a slower pace a gossip states particles and scan of every n-th tick. The world goes on meanwhile, and so does the body: its sensor scans
in every tick. The owner of a cell is the authority for the particles in it, so it corrects them with these scans by itself. Its cell, its
claim and the generators of all agents stay those of the last shared round. What the scans of gossip-free ticks have taught it goes into
its next gossip. What it computes early for a shared tick only gives its estimate and its command in time: the round begins without it.
"""

import dataclasses

from agents.config import AgentConfig
from agents.coverage.capacity import to_world
from agents.gossip.message_builders import without_scan
from agents.gossip.table import gossip_table
from agents.round import AgentContext, RoundCell, RoundResult, result_of
from agents.tracking.step import Step
from agents.tracking.tracker import Belief
from protocol.message import Vector
from protocol.messages import Gossip, Observation


def unsent_gossip(context: AgentContext, last: RoundResult, observation: Observation, pose_noise: Vector | None) -> Gossip:
    """A gossip with the pose and the scan of an observation alone, which nobody is sent."""
    return Gossip(
        sender=context.name,
        incarnation=context.incarnation,
        tick=observation.tick,
        pose=observation.pose,
        cod=to_world(context.announced.facts.cod_offset, observation.pose),
        power_radius=last.power_radius,
        unused=last.unused,
        detections_bytes=observation.detections_bytes,
        scanned=observation.scanned,
        pose_noise=pose_noise,
    )


def is_claim_valid(config: AgentConfig, belief: Belief, tick: int, pace: int) -> bool:
    """Whether the claim of a belief still counts at a later tick: for as long as peers of this pace keep a silent agent's generator."""
    most = max(config.ticks_of_silence, config.timing.silent_rounds * pace)
    return 0 <= belief.claim_tick <= belief.tick < tick <= belief.claim_tick + most


def predict_missed_ticks(context: AgentContext, last: RoundResult, own: Gossip, pace: int) -> RoundResult:
    """The result of the ticks since `last` and before that of `own`, of which the agent saw nothing; it has no command.

    At a slower pace its peers left these ticks out as well, so nobody else has moved the particles that come into the cell meanwhile: the
    agent does. At pace 1 its peers have played them, and the agent keeps what it owned, as it does before its first round.
    """
    if pace == 1 or last.round_cell is None:
        return dataclasses.replace(last, belief=context.tracker.keep_claim(last.belief, Step(context.config, own.tick)))
    return update_without_gossips(context, last, without_scan(own, own.tick - 1), ticks=0)


def update_without_gossips(context: AgentContext, last: RoundResult, own: Gossip, ticks: int) -> RoundResult:
    """The result of the tick of `own`, a later one than that of `last`, in the cell of `last`.

    `ticks`: how long the command is to last; 0: there is none.
    """
    tracker, round_cell = context.tracker, last.round_cell
    assert round_cell is not None
    density, region = last.density, round_cell.region._replace(row=0, pose=own.pose)
    for tick in range(last.belief.tick + 1, own.tick + 1):
        said = own if tick == own.tick else without_scan(own, tick)
        table, step = gossip_table([said], [context.announced], context.config), Step(context.config, tick)
        before, update = density, tracker.update(density, table, [region], step)[0]
        density = update.updated
    belief = tracker.keep_claim(last.belief, Step(context.config, own.tick + 1), update)
    return result_of(context, own, RoundCell(region, round_cell.generator_table), update, table, before, belief, ticks)
