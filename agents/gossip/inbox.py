"""The gossips that one agent has accepted: those of open rounds, and the newest of each peer in closed rounds."""

from collections.abc import Iterable, Set

from protocol.messages import Gossip

MOST_TICKS = 16  # most ticks of which the gossips of a peer are kept; older ones are dropped


class RoundInbox:
    """Accepted gossips by tick and name."""

    def __init__(self) -> None:
        self.rounds: dict[int, dict[str, Gossip]] = {}  # of rounds that are not closed yet
        self.last: dict[str, Gossip] = {}  # the newest of each peer in closed rounds

    def put(self, gossips: Iterable[Gossip]) -> None:
        """Keep accepted gossips, of each peer `MOST_TICKS` ticks at most: ticks far ahead of one peer push out nobody else's."""
        rounds = self.rounds
        for gossip in gossips:
            kept = rounds.get(gossip.tick)
            if kept is None:
                kept = rounds[gossip.tick] = {}
            kept[gossip.sender] = gossip
            if len(rounds) > MOST_TICKS:
                self._drop_oldest(gossip.sender)

    def _drop_oldest(self, name: str) -> None:
        """Keep the newest `MOST_TICKS` ticks of a peer."""
        for tick in sorted(tick for tick, gossips in self.rounds.items() if name in gossips)[:-MOST_TICKS]:
            del self.rounds[tick][name]
            if not self.rounds[tick]:
                del self.rounds[tick]

    def of(self, tick: int) -> dict[str, Gossip]:
        """The gossips of a tick, by name; not to be changed."""
        return self.rounds.get(tick, {})

    def knows(self, name: str) -> bool:
        """Whether the inbox holds any gossip of a peer."""
        return name in self.last or any(name in gossips for gossips in self.rounds.values())

    def newest(self, name: str, tick: int) -> Gossip | None:
        """The newest gossip of a peer that is not later than `tick`; None: there is none."""
        stamps = [stamp for stamp, gossips in self.rounds.items() if stamp <= tick and name in gossips]
        return self.rounds[max(stamps)][name] if stamps else self.last.get(name)

    def forget(self, name: str) -> None:
        """Drop all gossips of a peer."""
        for gossips in (self.last, *self.rounds.values()):
            gossips.pop(name, None)

    def drop_closed(self, names: Iterable[str]) -> None:
        """Drop the gossips of some peers in closed rounds."""
        for name in names:
            self.last.pop(name, None)

    def close(self, tick: int, peers: Set[str]) -> list[dict[str, Gossip]]:
        """Close the rounds up to `tick`, and return the gossips of each by name. `peers`: the names of the peers."""
        closed = [self.rounds.pop(stamp) for stamp in sorted([stamp for stamp in self.rounds if stamp <= tick])]
        for gossips in closed:
            self.last = gossips if gossips.keys() == peers else {**self.last, **gossips}
        return closed
