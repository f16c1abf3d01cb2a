"""The gossips that one agent has accepted: those of rounds that are not closed yet, and the newest of each peer in closed ones."""

from collections.abc import Iterable

from protocol.messages import Gossip

MOST_TICKS = 16  # for which gossips wait; the newest count


class RoundInbox:
    """Accepted gossips by tick and name."""

    def __init__(self) -> None:
        self.rounds: dict[int, dict[str, Gossip]] = {}  # of rounds that are not closed yet
        self.last: dict[str, Gossip] = {}  # the newest of each peer in closed rounds

    def put(self, gossip: Gossip) -> None:
        """Keep a gossip that was accepted."""
        self.rounds.setdefault(gossip.tick, {})[gossip.sender] = gossip
        if len(self.rounds) > MOST_TICKS:
            del self.rounds[min(self.rounds)]

    def of(self, tick: int) -> dict[str, Gossip]:
        """The gossips of a tick, by name; not to be changed."""
        return self.rounds.get(tick, {})

    def knows(self, name: str) -> bool:
        """Whether there is any gossip of a peer."""
        return name in self.last or any(name in gossips for gossips in self.rounds.values())

    def newest(self, name: str, tick: int) -> Gossip | None:
        """The newest gossip of a peer that is not younger than `tick`."""
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

    def close(self, tick: int, everybody: int) -> list[dict[str, Gossip]]:
        """Close the round `tick`; what was kept of it and of earlier ticks, each by name. `everybody`: the number of peers."""
        closed = [self.rounds.pop(stamp) for stamp in sorted([stamp for stamp in self.rounds if stamp <= tick])]
        for gossips in closed:
            self.last = gossips if len(gossips) == everybody else {**self.last, **gossips}
        return closed
