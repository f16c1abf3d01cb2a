"""The gossips that one agent has accepted: those of open rounds, and the newest of each peer in closed rounds."""

from collections.abc import Iterable, Set
from itertools import groupby
from operator import attrgetter

from protocol.messages import Gossip

TICK = attrgetter("tick")
FAR_TICKS = 128  # after the last closed round: at the slowest pace the next tick of all is 64 ahead, and the one after it 128
WINDOW_TICKS = 16  # of so many ticks after the last closed round all gossips are kept, and of later ticks this many of each peer


class RoundInbox:
    """Accepted gossips by tick and name."""

    def __init__(self) -> None:
        self.rounds: dict[int, dict[str, Gossip]] = {}  # of rounds that are not closed yet
        self.newest_closed: dict[str, Gossip] = {}  # the newest of each peer in closed rounds
        self._far: dict[str, dict[int, None]] = {}  # by peer: ticks that were not near when its gossip came, in that order
        self._closed = -1  # tick of the last closed round

    def is_far_ahead(self, tick: int) -> bool:
        """Whether a tick comes long after the last closed round: it is wrong, or this agent was stalled."""
        return tick > self._closed + FAR_TICKS

    def _is_near(self, tick: int) -> bool:
        """Whether a tick is one of the next ones to be closed."""
        return self._closed < tick <= self._closed + WINDOW_TICKS

    def is_closed(self, name: str, tick: int) -> bool:
        """Whether a round with a gossip of a peer, of this tick or a later one, is closed."""
        return tick <= self._closed and name in self.newest_closed and tick <= self.newest_closed[name].tick

    def put(self, gossips: Iterable[Gossip]) -> None:
        """Keep accepted gossips: wrong ticks push out no right ones, neither of their sender nor of anybody else."""
        for tick, together in groupby(gossips, TICK):
            said = {gossip.sender: gossip for gossip in together}
            self.rounds.setdefault(tick, {}).update(said)
            if not self._is_near(tick):
                for name in said:
                    self._note_far(name, tick)

    def _note_far(self, name: str, tick: int) -> None:
        """Of the gossips of a peer that are not near keep `WINDOW_TICKS`, those that came last: an agent that was stalled needs these."""
        far = self._far.setdefault(name, {})
        far.pop(tick, None)
        far[tick] = None
        if len(far) > WINDOW_TICKS:
            old = next(iter(far))
            del far[old]
            if not self._is_near(old):
                self._drop(name, old)

    def _drop(self, name: str, tick: int) -> None:
        """Drop the gossip of a peer and a tick, if there is one."""
        gossips = self.rounds.get(tick, {})
        if gossips.pop(name, None) is not None and not gossips:
            del self.rounds[tick]

    def of(self, tick: int) -> dict[str, Gossip]:
        """The gossips of a tick, by name; not to be changed."""
        return self.rounds.get(tick, {})

    def knows(self, name: str) -> bool:
        """Whether the inbox holds any gossip of a peer."""
        return name in self.newest_closed or any(name in gossips for gossips in self.rounds.values())

    def newest(self, name: str, tick: int) -> Gossip | None:
        """The newest gossip of a peer that is not later than `tick`; None: there is none."""
        ticks = [old for old, gossips in self.rounds.items() if old <= tick and name in gossips]
        return self.rounds[max(ticks)][name] if ticks else self.newest_closed.get(name)

    def forget(self, name: str) -> None:
        """Drop all gossips of a peer."""
        self.newest_closed.pop(name, None)
        for tick in [*self.rounds]:
            self._drop(name, tick)
        self._far.pop(name, None)

    def drop_newest_closed(self, names: Iterable[str]) -> None:
        """Drop the gossips of some peers in closed rounds."""
        for name in names:
            self.newest_closed.pop(name, None)

    def close(self, tick: int, peers: Set[str]) -> list[dict[str, Gossip]]:
        """Close the rounds up to `tick`, and return the gossips of each by name. `peers`: the names of the peers."""
        self._closed = tick
        closed = [self.rounds.pop(old) for old in sorted([old for old in self.rounds if old <= tick])]
        for gossips in closed:
            self.newest_closed = gossips if gossips.keys() == peers else {**self.newest_closed, **gossips}
        return closed
