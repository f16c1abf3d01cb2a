"""The rounds that an agent plays alone, in the ticks in which no gossips are sent.

At a slower pace a gossip states particles and scan of every n-th tick. The world goes on meanwhile, and so does the body: its sensor scans
in every tick. The owner of a cell is the authority for the particles in it, so it corrects them with these scans by itself. Its cell, its
claim and the generators of all agents stay those of the last shared round. What the scans have taught it goes into its next gossip, and
estimates and commands are those of now.
"""

import dataclasses

from msgspec.structs import replace

from agents.coverage.capacity import place
from agents.gossip.table import gossip_table
from agents.round import AgentContext, Frame, RoundResult, result_of
from agents.tracking.step import Step
from protocol.message import Vector
from protocol.messages import Gossip, Observation


def own_gossip(context: AgentContext, incarnation: int, last: RoundResult, observation: Observation, pose_noise: Vector | None) -> Gossip:
    """A gossip with the pose and the scan of an observation alone, which nobody is sent."""
    return Gossip(
        sender=context.name,
        incarnation=incarnation,
        tick=observation.tick,
        pose=observation.pose,
        cod=place(context.facts.cod_offset, observation.pose),
        power_radius=last.power_radius,
        unused=last.unused,
        detections_bytes=observation.detections_bytes,
        pose_noise=pose_noise,
    )


def play_unseen(context: AgentContext, last: RoundResult, own: Gossip, pace: int) -> RoundResult:
    """The result of the ticks since `last` and before that of `own`, of which the agent saw nothing; it has no command.

    At a slower pace particles come into the cell meanwhile, and leave it: its peers count on that. At pace 1 peers have met in these
    ticks, and the agent keeps what it owned.
    """
    if pace == 1 or last.frame is None:
        return dataclasses.replace(last, belief=context.tracker.hold(last.belief, Step(context.config, own.tick)))
    return play_alone(context, last, replace(own, tick=own.tick - 1, scanned=False, detections_bytes=b""), pace=0)


def play_alone(context: AgentContext, last: RoundResult, own: Gossip, pace: int) -> RoundResult:
    """The result of the tick of `own`, a later one than that of `last`, in the cell of `last`.

    A command is expected after as many ticks as have passed, at most `pace`. 0: the result has none.
    """
    tracker, frame, stamp = context.tracker, last.frame, last.belief.stamp
    assert frame is not None
    density, region = last.density, frame.region._replace(row=0, pose=own.pose)
    for tick in range(stamp + 1, own.tick + 1):
        said = own if tick == own.tick else replace(own, tick=tick, scanned=False, detections_bytes=b"")
        table, step = gossip_table([said], [context.announced], context.config), Step(context.config, tick)
        received, near = density, tracker.update(density, table, [region], step)[0]
        density = tracker.nearby(near)
    belief = tracker.hold(last.belief, Step(context.config, own.tick + 1), near)
    return result_of(context, own, Frame(region, frame.generators), near, table, received, belief, min(pace, own.tick - stamp))
