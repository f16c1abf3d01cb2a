"""The rounds of an agent that are still to be played, and when each is due: at its own tick, or later when gossips come late.

Data type: `OpenRounds`, made of the `Lag` that says how late, and of the `GossipHistory` from which rounds are played late.
"""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from operator import attrgetter

from agents.gossip_history import GossipHistory, OpenRound
from agents.lag import Lag
from agents.look_ahead import replayed_density
from agents.membership.peer import Peer
from agents.round import AgentContext, Replay
from agents.tracking.tracker import Belief
from protocol.messages import Gossip


class OpenRounds:
    """The open rounds of one agent, the oldest first. Times are `now` of its node, s."""

    def __init__(self, context: AgentContext) -> None:
        config = context.config
        period, timeout, measured = config.run.dt / config.run.rate, config.gossip_timeout(missed=False), config.run.clock == "realtime"
        self.lag = Lag(period, timeout, config.timing.look_ahead, measured=measured)
        self.recent = GossipHistory(context, self.lag.most)
        self.due: int | None = None  # tick of the oldest round, if it is due
        self._context = context
        self._rounds: deque[OpenRound] = deque()

    def __bool__(self) -> bool:
        return bool(self._rounds)

    def behind(self, tick: int, last: int) -> int:
        """The number of ticks before `tick` whose rounds are still to be played, if that of `last` was played before them.

        0 where that of `last` is not the one before the oldest open round, and where it is too old for a replay.
        """
        follows = bool(self._rounds) and last == self._rounds[0].gossip.tick - 1
        return tick - 1 - last if follows and tick - 1 - last <= self.lag.most else 0

    def open(self, gossip: Gossip, belief: Belief, now: float) -> None:
        """Open the round of the own `gossip`."""
        self._rounds.append(OpenRound(gossip, belief))
        if self.lag.most:
            self.lag.observe(gossip.tick, now)
            self.recent.put(gossip, self._context.announced)

    def find_due(self, tick: int) -> int | None:
        """The oldest round, if it is due in the newest `tick`; else None."""
        is_due = bool(self._rounds) and self._rounds[0].gossip.tick <= tick - self.lag.current
        self.due = self._rounds[0].gossip.tick if is_due else None
        return self.due

    def pop(self) -> OpenRound:
        """The oldest round, to be played."""
        return self._rounds.popleft()

    def hear(self, gossips: Sequence[Gossip], peers: Mapping[str, Peer], now: float) -> None:
        """Keep accepted gossips, and note how late they are."""
        for gossip in gossips if self.lag.most else ():
            announced = peers[gossip.sender].announced
            if announced is not None and self.recent.put(gossip, announced):
                self.lag.hear(gossip.tick, now)

    def postpones(self, due: int, tick: int, awaited: Collection[str], come: int) -> bool:
        """Whether the round `due` waits for the tick after `tick`: hardly any gossip has come (`Lag.postpones`).

        `awaited`: the peers whose gossips are missing; `come`: the number of gossips that have come. A peer that has said something later
        is not waited for.
        """
        still_possible = [name for name in awaited if not self.recent.has_later(name, due)]
        return self.lag.postpones(len(awaited) + come, len(still_possible), tick - due)

    def replay(self, opened: OpenRound, fresh: Mapping[str, Gossip]) -> Replay | None:
        """The function that computes the density before a round, if a gossip states an older claim; None: all are of the tick before."""
        if not opened.gossip.behind and not any(map(attrgetter("behind"), fresh.values())):
            return None
        return partial(replayed_density, self.recent, self._context, opened, self.lag.most)

    def end_tick(self, tick: int, pace: int, now: float) -> None:
        """A tick ends. An agent of a slower `pace` keeps no lag."""
        if pace > 1:
            self.lag.reset()
        elif self.lag.most:
            self.lag.close(self.recent.stated_lags(tick), now)
