"""The clock of a body: which tick it is, from synchronised time and from what the neighbours say.

Tick k begins at anchor + k period. Every gossip states a tick and is sent when that tick begins, so it tells the anchor of its sender up
to the way of the message. The clock is corrected to the majority, never to one of several: a neighbour whose clock is wrong moves nobody.

* Behind the majority by more than half a period: it jumps forward, and the ticks in between are left out.
* Ahead of the majority by more than a period and by more than `AHEAD`: it stands until the others come.
* Between these limits nothing is corrected: clocks may differ by that much.

A tie is decided forward, so of two bodies the one behind follows. A majority needs the word of more than half of the neighbours.
"""

import math
from collections.abc import Iterable

AHEAD = 0.5  # s
RECENT = 2.0  # s, for which the word of a neighbour counts; at least four periods
HEARD = 5  # neighbours to whom a clock listens: two of them may lie


def neighbours(name: str, agents: Iterable[str]) -> tuple[str, ...]:
    """The agents to whom the clock of this name listens: the next ones in the ring of sorted names."""
    ring = sorted({*agents} - {name})
    start = sum(other < name for other in ring)
    return tuple([*ring[start:], *ring[:start]][:HEARD])


class TickClock:
    """The tick as a function of `now`, s. Without an anchor the run has not begun."""

    def __init__(self, period: float, anchor: float | None = None) -> None:
        self.anchor = anchor  # when tick 0 began or will begin
        self.corrections = 0
        self._period = period
        self._heard: dict[str, tuple[float, float]] = {}  # name -> its anchor by its newest gossip, and when that came

    def due(self, tick: int) -> float:
        """When a tick begins."""
        assert self.anchor is not None
        return self.anchor + tick * self._period

    def tick(self, now: float) -> int:
        """The tick that has begun last; negative before the first."""
        assert self.anchor is not None
        tick = math.floor((now - self.anchor) / self._period)
        return tick + 1 if self.due(tick + 1) <= now else tick if self.due(tick) <= now else tick - 1

    def hear(self, name: str, tick: int, now: float) -> None:
        """Note a gossip of a neighbour."""
        self._heard[name] = now - tick * self._period, now

    def listen(self, names: Iterable[str], now: float) -> bool:
        """Correct the anchor by what these neighbours say, or take theirs before the run has begun; whether it has changed.

        What others have said is forgotten.
        """
        since = now - max(RECENT, 4.0 * self._period)
        names = tuple(names)
        self._heard = {name: self._heard[name] for name in names if name in self._heard}
        anchors = [anchor for anchor, when in self._heard.values() if when >= since]
        if 2 * len(anchors) <= len(names):
            return False
        if self.anchor is None:
            self.anchor = _middle(anchors)
            return True
        theirs = _middle([*anchors, self.anchor])
        behind = self.anchor - theirs
        if -max(self._period, AHEAD) <= behind <= 0.5 * self._period:
            return False
        self.anchor = theirs
        self.corrections += 1
        return True


class TickCount:
    """The clock of lockstep: a tick ends with the agent's command, so only a body that was left behind must be told the tick."""

    def __init__(self) -> None:
        self._heard: dict[str, int] = {}

    def hear(self, name: str, tick: int) -> None:
        """Note a gossip of a neighbour."""
        self._heard[name] = tick

    def majority(self, names: Iterable[str]) -> int:
        """The tick that most of these neighbours have reached; -1: it is not known. What others have said is forgotten."""
        names = tuple(names)
        self._heard = {name: self._heard[name] for name in names if name in self._heard}
        ticks = [*self._heard.values()]
        return -int(_middle([-tick for tick in ticks])) if 2 * len(ticks) > len(names) else -1


def _middle(values: list[float]) -> float:
    """The lower median: of an even number the smaller of the two in the middle, which is the later clock."""
    return sorted(values)[(len(values) - 1) // 2]
