"""What all have said of a tick in one instant, looked at once for everybody in the process who hears it.

In virtual time a message is one object for all its listeners, and those of one instant come as one batch. A listener takes it whole when
it holds what is expected of a calm round; anything else is judged message by message.
"""

import math
from collections.abc import KeysView
from itertools import pairwise

from agents.peers import Mark
from agents.words import Words, side_by_side
from protocol.keys import order
from protocol.messages import Gossip
from protocol.node import Batch
from protocol.once import once


class Unison:
    """Gossips that came together, in the order of names."""

    def __init__(self, said: list[Gossip]) -> None:
        self.said = said
        self.places = {gossip.sender: place for place, gossip in enumerate(said)}
        ticks = {gossip.tick for gossip in said}
        self.tick = ticks.pop() if len(ticks) == 1 else -1  # of all of them
        self._marks: list[Mark | None] = [None]
        self._times: tuple[float, dict[str, float]] = -math.inf, {}

    def unmarked(self) -> list[Gossip]:
        """Those that nobody has looked at yet."""
        return [gossip for gossip in self.said if "mark" not in gossip.memo] if None in self._marks else []

    def is_from(self, marks: list[Mark], place: int) -> bool:
        """Whether these are the gossips with these marks, in this order, with one more at `place` and nothing else."""
        if None in self._marks:
            self._marks = [gossip.memo.get("mark") for gossip in self.said]
        return self._marks[:place] == marks[:place] and self._marks[place + 1 :] == marks[place:]

    @once
    def words(self) -> Words:
        """All of them side by side."""
        return side_by_side(self.said)

    def times(self, now: float) -> dict[str, float]:
        """That all of them spoke now, s."""
        if self._times[0] != now:
            self._times = now, dict.fromkeys(self.places, now)
        return self._times[1]


class Part:
    """What one of those who spoke has heard of it: a round that is heard whole, as a `CalmRound` is."""

    __slots__ = ("_place", "_unison")

    def __init__(self, unison: Unison, place: int) -> None:
        """`place`: of its own gossip."""
        self._unison, self._place = unison, place

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
        if arrived is mine or (arrived.memo.get("row") == mine.memo["row"] and arrived == mine):
            return self._unison.words
        return side_by_side([*said[:place], mine, *said[place + 1 :]])


def unison_of(batch: Batch) -> Unison | None:
    """What a batch says, if it is gossips in the order of names, one of each; looked at once."""
    if "unison" not in batch.memo:
        said = [event.message for event in batch.events if isinstance(event.message, Gossip)]
        ranks = [order(gossip.sender) for gossip in said]
        ordered = len(said) == len(batch.events) and all(before < after for before, after in pairwise(ranks))
        batch.memo["unison"] = Unison(said) if ordered else None
    known: Unison | None = batch.memo["unison"]
    return known
