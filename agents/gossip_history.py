"""The gossips and the beliefs of the last ticks of one agent, from which rounds are played late (`agents/look_ahead.py`).

Data types: `GossipHistory`; an `OpenRound` is a round that is still to be played.
"""

from collections import deque
from typing import NamedTuple

import msgspec

from agents.config import AgentConfig
from agents.gossip.message_builders import without_scan
from agents.gossip.round_inbox import WINDOW_TICKS
from agents.gossip.table import AnnouncedSensor, GossipTable, gossip_table
from agents.round import AgentContext
from agents.tracking.tracker import Belief
from protocol.keys import order
from protocol.messages import Gossip

BLUR = 0.6  # per s: what the peak of a target that is out of view loses to its surroundings
BESIDE = 0.6  # expected targets: least mass of a peak near another one, for a low threshold would count the rest of a target as another


class OpenRound(NamedTuple):
    """A round that is still to be played."""

    gossip: Gossip  # the own one
    belief: Belief  # when that was published


class GossipHistory:
    """The gossips that an agent has accepted, its own ones and its beliefs, of the last ticks."""

    def __init__(self, context: AgentContext, most: int) -> None:
        """`most`: ticks that a round is played late at most."""
        self._context, self._most = context, most
        self.ticks_ahead = most + WINDOW_TICKS  # after the newest belief, of which gossips are kept
        self._most_ticks = 2 * (2 * most + WINDOW_TICKS)  # twice what `keep` leaves
        self._said: dict[int, dict[str, tuple[Gossip, AnnouncedSensor]]] = {}
        self._blurred: dict[int, AgentConfig] = {}  # by ticks
        self._beliefs: deque[Belief] = deque(maxlen=most + 2 if most else 0)  # none where no round is played late

    def put(self, gossip: Gossip, announced: AnnouncedSensor) -> bool:
        """Keep a gossip; whether it is the first one of its sender and tick.

        An agent without observations plays no round, and so drops no gossip: of too many ticks the one goes in which the fewest have
        spoken, of several the one that came first. A peer can make up ticks, so those of own gossips go last.
        """
        heard = self._said.setdefault(gossip.tick, {})
        if len(self._said) > self._most_ticks:
            others = [tick for tick in self._said if tick != gossip.tick]
            del self._said[min(others, key=lambda tick: (self._context.name in self._said[tick], len(self._said[tick])))]
        is_new = gossip.sender not in heard
        heard[gossip.sender] = gossip, announced
        return is_new

    def keep(self, belief: Belief) -> None:
        """Keep the belief after a round. Drop the gossips that no round will need, and those of a tick so far ahead that it is wrong."""
        self._beliefs.append(belief)
        oldest = belief.tick - self._most  # the next replay begins with the belief of this tick
        newest = belief.tick + self.ticks_ahead
        self._said = {tick: heard for tick, heard in self._said.items() if oldest <= tick <= newest}

    def has_later(self, name: str, tick: int) -> bool:
        """Whether a gossip of a peer has come that is later than `tick`."""
        return any(name in heard for other, heard in self._said.items() if other > tick)

    def stated_lags(self, tick: int) -> list[int]:
        """The lags in ticks that the newest gossips state, the own one included. Gossips older than the longest lag do not count."""
        newest: dict[str, int] = {}
        for old in sorted(self._said):
            if old >= tick - self._most:
                newest |= {name: gossip.lag for name, (gossip, _) in self._said[old].items()}
        return list(newest.values())

    def table(self, own: Gossip) -> GossipTable:
        """The gossips of a tick that have come so far, the own one included."""
        heard = {**self._said.get(own.tick, {}), own.sender: (own, self._context.announced)}
        said = [heard[name] for name in sorted(heard, key=order)]
        return gossip_table([gossip for gossip, _ in said], [sensor for _, sensor in said], self._context.config)

    def own_gossip(self, tick: int, nearest: Gossip) -> Gossip:
        """The own gossip of a tick; without one the `nearest` without its scan, for the agent was skipped by that tick."""
        found = self._said.get(tick, {}).get(self._context.name)
        return found[0] if found else without_scan(nearest, tick)

    def at_or_before(self, tick: int, newest: Belief) -> Belief:
        """The newest belief that is not later than a tick, `newest` included; the oldest that is kept if all are later."""
        if newest.tick <= tick:
            return newest
        earlier = [belief for belief in self._beliefs if belief.tick <= tick]
        return earlier[-1] if earlier else self._beliefs[0] if self._beliefs else newest

    def blurred_config(self, ticks: int) -> AgentConfig:
        """The settings to read targets off a density that was moved on by some ticks: a target is spread wider, and its peak is lower.

        When one expected target has been taken from a peak, the rest counts as another one only above `beside`, at least `BESIDE` here.
        """
        ticks = min(ticks, self.ticks_ahead + 1)  # a jump over more ticks blurs no more
        if ticks not in self._blurred:
            config, now = self._context.config, self._context.config.extraction
            share = 1.0 / (1.0 + BLUR * ticks * config.run.dt)
            extraction = msgspec.structs.replace(now, threshold=share * now.threshold, beside=max(now.beside, BESIDE))
            self._blurred[ticks] = msgspec.structs.replace(config, extraction=extraction)
        return self._blurred[ticks]
