"""What peers have said: the gossips of open rounds, and the newest of each in closed ones; one by one, or read together in calm rounds."""

from collections.abc import Iterable, KeysView, Sequence

from agents.calm import CalmRound, Roll
from agents.unison import Part
from protocol.messages import Gossip

Whole = CalmRound | Part  # of which nothing is made one by one unless somebody asks
MOST_TICKS = 16  # for which gossips wait; the newest count


class Said:
    """The gossips that one agent has taken."""

    def __init__(self) -> None:
        self.rounds: dict[int, dict[str, Gossip]] = {}  # by tick and name, of rounds that are not closed yet
        self.next = 0  # tick of the round after the last that was closed
        self._together: Whole | None = None  # instead of `rounds`: all that has been said is of `next`, and came together
        self._last: dict[str, Gossip] = {}
        self._closed: Whole | None = None  # instead of `_last`

    @property
    def last(self) -> dict[str, Gossip]:
        """The newest of each peer in closed rounds, by name."""
        if self._closed is not None:
            self._last, self._closed = self._closed.gossips(), None
        return self._last

    def read(self, roll: Roll, keys: Sequence[str], payloads: Sequence[bytes]) -> KeysView[str] | None:
        """Read what has come together with what was read before; whose it was, or None, as `CalmRound.read`."""
        reading = self._together or CalmRound(roll, self.next)
        if self.rounds or not isinstance(reading, CalmRound) or reading.roll is not roll:
            return None
        names = reading.read(keys, payloads)
        if names is not None:
            self._together = reading
        return names

    def take(self, heard: Part, tick: int) -> bool:
        """All that there is to be said of a tick has come together; whether that can be, because nothing else has come."""
        if self.rounds or self._together is not None or tick != self.next:
            return False
        self._together = heard
        return True

    def together(self, tick: int) -> Whole | None:
        """What was said of a tick if it came together."""
        return self._together if self._together is not None and tick == self.next else None

    def spell_out(self) -> dict[int, dict[str, Gossip]]:
        """The `rounds`, in which from now on stands one by one what was read together."""
        if self._together is not None:
            self.rounds[self.next] = self._together.gossips()
            self._together = None
        return self.rounds

    def held(self) -> dict[str, tuple[object, ...]]:
        """What is held of each peer's gossips, as values to compare. How they are stored stays as it is."""
        found: dict[str, list[object]] = {}
        for tick, said in self.rounds.items():
            for name, gossip in said.items():
                found.setdefault(name, []).append((tick, id(gossip)))
        for name, gossip in self._last.items():
            found.setdefault(name, []).append((gossip.incarnation, gossip.tick))
        for whole in (self._closed, self._together):
            for name in whole.names() if whole is not None else ():
                found.setdefault(name, []).append(id(whole))
        return {name: tuple(values) for name, values in found.items()}

    def note(self, gossip: Gossip) -> None:
        """A gossip has been taken."""
        said = self.spell_out().setdefault(gossip.tick, {})
        said[gossip.sender] = gossip
        if len(self.rounds) > MOST_TICKS:
            del self.rounds[min(self.rounds)]

    def knows(self, name: str) -> bool:
        """Whether somebody has said anything."""
        return name in self.last or any(name in said for said in self.spell_out().values())

    def newest(self, name: str, tick: int) -> Gossip | None:
        """The newest gossip of a peer that is not younger than `tick`."""
        stamps = [stamp for stamp, said in self.spell_out().items() if stamp <= tick and name in said]
        return self.rounds[max(stamps)][name] if stamps else self.last.get(name)

    def forget(self, name: str) -> None:
        """Nothing counts any more that somebody has said."""
        for said in (self.last, *self.spell_out().values()):
            said.pop(name, None)

    def drop(self, names: Iterable[str]) -> None:
        """What these have said in closed rounds counts no more."""
        for name in names:
            if isinstance(self._closed, CalmRound):
                self._closed.drop(name)
            else:
                self.last.pop(name, None)

    def close_together(self) -> None:
        """The round that was read together is over."""
        self._closed, self._together, self.next = self._together, None, self.next + 1

    def close(self, tick: int, everybody: int) -> list[dict[str, Gossip]]:
        """The round `tick` is over; what was said of it and before, of each tick, when there are so many peers."""
        rounds, self.next = self.spell_out(), tick + 1
        closed = [rounds.pop(stamp) for stamp in sorted([stamp for stamp in rounds if stamp <= tick])]
        for said in closed:
            self._last, self._closed = said if len(said) == everybody else {**self.last, **said}, None
        return closed
