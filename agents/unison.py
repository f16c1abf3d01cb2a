"""What all have said in one instant, gossips or greetings, looked at once for everybody in the process who hears it.

In virtual time a message is one object for all its listeners, and those of one instant come as one batch. A listener takes it whole when
it holds what is expected of a calm round; anything else is judged message by message.
"""

import math
from collections.abc import KeysView, Sequence
from itertools import pairwise

from agents.peers import Mark, mark_of
from agents.shared_round import ASKED as SOMEBODY
from agents.words import Words, side_by_side
from protocol.keys import order
from protocol.messages import Gossip, Hello, Message
from protocol.node import Batch
from protocol.once import once


class Together:
    """Messages of several that came in one instant, in the order of names, one of each."""

    def __init__(self, messages: Sequence[Message], marks: list[Mark | None]) -> None:
        """`marks`: of those who are known to mean what they say."""
        self.places = {message.sender: place for place, message in enumerate(messages)}
        self._incarnations = [message.incarnation for message in messages]
        self._marks = marks
        self._times: tuple[float, dict[str, float]] = -math.inf, {}

    def __len__(self) -> int:
        return len(self.places)

    def place_of(self, name: str, incarnation: int) -> int:
        """Where among them stands what an agent says; -1 if it says nothing, or somebody else has spoken under its name."""
        place = self.places.get(name, -1)
        return place if place >= 0 and self._incarnations[place] == incarnation else -1

    def is_from(self, marks: list[Mark], place: int) -> bool:
        """Whether they come from those with these marks, in this order, from one more at `place`, and from nobody else."""
        return self._marks[:place] == marks[:place] and self._marks[place + 1 :] == marks[place:]

    def times(self, now: float) -> dict[str, float]:
        """That all of them spoke now, s."""
        if self._times[0] != now:
            self._times = now, dict.fromkeys(self.places, now)
        return self._times[1]


class Unison(Together):
    """Gossips."""

    def __init__(self, said: list[Gossip]) -> None:
        super().__init__(said, [None])
        self.said = said
        ticks = {gossip.tick for gossip in said}
        self.tick = ticks.pop() if len(ticks) == 1 else -1  # of all of them

    def unmarked(self) -> list[Gossip]:
        """Those that nobody has looked at yet."""
        return [gossip for gossip in self.said if "mark" not in gossip.memo] if None in self._marks else []

    def is_from(self, marks: list[Mark], place: int) -> bool:
        """See `Together`."""
        if None in self._marks:
            self._marks = [gossip.memo.get("mark") for gossip in self.said]
        return super().is_from(marks, place)

    @once
    def words(self) -> Words:
        """All of them side by side. Who asks has heard all of it, and so as a rule have the others, who will ask next."""
        words = side_by_side(self.said)
        words.chorus = words.chorus or SOMEBODY
        return words


class Part:
    """What one of those who spoke has heard of it: a round that is heard whole, as a `CalmRound` is."""

    __slots__ = ("_place", "_unison")

    def __init__(self, unison: Unison, name: str) -> None:
        self._unison, self._place = unison, unison.places[name]

    def __len__(self) -> int:
        return len(self._unison.said) - 1

    def names(self) -> KeysView[str]:
        """Who has spoken."""
        return self.gossips().keys()

    def gossips(self) -> dict[str, Gossip]:
        """What was said, by name and in the order of names."""
        said, place = self._unison.said, self._place
        return {gossip.sender: gossip for gossip in [*said[:place], *said[place + 1 :]]}

    def words(self, mine: Gossip) -> Words:
        """All that was said, and mine in its place."""
        said, place = self._unison.said, self._place
        arrived = said[place]
        if "row" not in arrived.memo and arrived == mine:  # nobody else has looked at it yet
            arrived.memo.update(row=mine.memo["row"], sensor=mine.memo["sensor"])
        if arrived is mine or (arrived.memo.get("row") == mine.memo["row"] and arrived == mine):
            return self._unison.words
        return side_by_side([*said[:place], mine, *said[place + 1 :]])


def together_of(batch: Batch) -> Unison | Together | None:
    """What a batch says, if it is gossips, or greetings of agents that say what their sensors are, in the order of names, one of each;
    looked at once."""
    if "together" not in batch.memo:
        batch.memo["together"] = _together([event.message for event in batch.events])
    known: Unison | Together | None = batch.memo["together"]
    return known


def _together(messages: list[Message]) -> Unison | Together | None:
    names = [message.sender for message in messages]
    if not all(order(before) < order(after) for before, after in pairwise(names)):
        return None
    gossips = [message for message in messages if isinstance(message, Gossip)]
    if len(gossips) == len(messages):
        return Unison(gossips)
    hellos = [message for message in messages if isinstance(message, Hello) and message.role == "agent"]
    marks = [mark_of(hello.sender, hello.incarnation, hello.sensor) for hello in hellos if hello.sensor is not None]
    return Together(hellos, [*marks]) if len(marks) == len(messages) else None
