"""What an agent of a slower pace sees in the ticks between its rounds: the targets in its own cell, by its own scans.

Data type: `BetweenRounds`. A copy of the belief is moved on from tick to tick and corrected with the own scans alone. Estimates are read
off it. The next round knows nothing of it: rounds begin with what gossips state, and all agents read the same gossips.
"""

import msgspec

from agents.gossip.table import announced_sensor, gossip_table
from agents.look_ahead import RecentTicks
from agents.round import AgentContext, RoundResult
from agents.tracking.extraction import Tracks
from agents.tracking.step import Step
from agents.tracking.tracker import Diagram, TrackerState
from protocol.messages import Gossip, Observation


class BetweenRounds:
    """The copy of the belief of one agent since its last round."""

    def __init__(self, context: AgentContext, recent: RecentTicks) -> None:
        self._context, self._recent = context, recent
        self._alone = Diagram(0, frozenset(), None, context.config.filter.halo)  # no peer is heard, and nothing far away matters
        self._belief: TrackerState | None = None  # None: that of the last round

    def begin(self) -> None:
        """A round has been played: what follows begins with its belief."""
        self._belief = None

    def see(self, observation: Observation, last: RoundResult, said: Gossip) -> tuple[Tracks, Gossip]:
        """The targets in the cell of the `last` round at the tick of an observation, and what the agent would say of that tick.

        `said`: the own gossip of the last round.
        """
        context, tracker, config, tick = self._context, self._context.tracker, self._context.config, observation.tick
        own = msgspec.structs.replace(said, tick=tick, pose=observation.pose, detections_bytes=observation.detections_bytes)
        if last.frame is None:  # no round has been played yet
            return last.tracks, own
        belief = self._belief if self._belief is not None and self._belief.stamp < tick else last.belief
        table = gossip_table([own], [announced_sensor(context.name, context.sensor, config.detection.clutter)], config)
        step = Step(self._recent.blurred(tick - last.belief.stamp), tick)
        density = tracker.merge(tracker.catch_up(belief, step), table, step)
        region = last.frame.region._replace(row=0, pose=own.pose)
        near = tracker.update(density, table, [region], step)[0]
        self._belief = tracker.share(density, region, near, self._alone, step)
        return near.tracks, own
