"""The lag of an agent: how many ticks after its own tick a round is played, because gossips come late.

Data type: a `Lag`. A gossip of tick k is late when it comes after the end of tick k, which is the time that a round waits for gossips. It
is late by L ticks when it comes before the end of tick k + L. The agent measures that by its own observations alone: no two processes
compare clocks.

Every gossip states the lag that its sender *needs*: with it most gossips of the last ticks came in time. An agent *uses* the largest lag
that it needs or that a newest gossip states, its own included. It states its need alone: agents that stated the lag in use would keep each
other's lag up for ever. When gossips come in time again, all who read the same ones find the same lag in the same tick. In lockstep the
world waits, and the lag is 0.

When hardly any gossip has come at the end of a tick, the agent *postpones* the round until the next tick, at most by the longest lag.
So when a whole network gets slow no round is played with a small part of the gossips before the lag has risen: that happens once the late
ones have come and been measured. A round from which fewer gossips are missing is played without them.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import chain

LONGEST_LAG = 12  # ticks that a round is played late at most; gossips are kept for a little more (`inbox.WINDOW_TICKS`)
MEMORY_SECONDS = 2.0  # s for which a late gossip is remembered
IN_TIME_SHARE = 0.95  # share of the gossips that a lag lets come in time
POSTPONED_SHARE = 0.9  # share of the gossips that are still to come for which a round is postponed
# gossips that must be missing: one or two silent peers show nothing about the network. So swarms of up to 3 agents postpone no round
LEAST_MISSING = 3


class Lag:
    """The lag of one agent, in ticks. Times are `now` of its node, s."""

    def __init__(self, period: float, timeout: float, longest: float, *, measured: bool) -> None:
        """`period`: s between two ticks; `timeout`: s for which a round waits; `longest`: s after the own observation
        that a gossip may come.

        `measured` false: the lag stays 0.
        """
        self.need = 0  # stated in the gossip
        self.current = 0  # rounds are played so many ticks late
        self.most = min(LONGEST_LAG, math.ceil(max(0.0, longest - timeout) / period)) if measured else 0
        self._period, self._timeout = period, timeout
        self._newest = -1  # tick of the newest observation
        self._opened: dict[int, float] = {}  # when the own observation of a tick came
        self._late: dict[int, list[int]] = {}  # ticks by which the gossips of a tick were late

    def observe(self, tick: int, now: float) -> None:
        """Note that the observation of a tick has come."""
        self._opened[tick], self._newest = now, tick
        oldest = tick - self.most - math.ceil(MEMORY_SECONDS / self._period)
        self._opened = {old: begin for old, begin in self._opened.items() if old >= oldest}
        self._late = {old: late for old, late in self._late.items() if old >= oldest}

    def hear(self, tick: int, now: float) -> None:
        """Note that a gossip of a tick has come for the first time.

        One that came before the own observation is in time. One that is later than the longest lag counts as lost, and is not noted; nor is
        one of a tick so far ahead that it is wrong.
        """
        opened = self._opened.get(tick, now if self._newest < tick <= self._newest + LONGEST_LAG else None)
        if opened is None:
            return
        late = max(0, math.ceil((now - opened - self._timeout) / self._period - 1e-9))
        if late <= self.most:
            self._late.setdefault(tick, []).append(late)

    def forget(self) -> None:
        """Forget what was measured: the agent was stalled, or its clock has jumped, which says nothing about the network."""
        self._opened.clear()
        self._late.clear()

    def postpones(self, expected: int, still_possible: int, late: int) -> bool:
        """Whether a round that is `late` ticks late waits for another tick.

        `expected`: gossips that it needs; `still_possible`: those that have not come, of peers that have not said anything later.
        """
        return late < self.most and still_possible >= max(LEAST_MISSING, POSTPONED_SHARE * expected)

    def close(self, needs: Iterable[int], now: float) -> None:
        """A tick ends. `needs`: those that the newest gossips state, the own one included."""
        opened = [(self._opened.get(old, now), late) for old, late in self._late.items()]
        recent = [late for begin, late in opened if now - begin <= MEMORY_SECONDS + max(late) * self._period]
        self.need = _covering(sorted(chain.from_iterable(recent)))
        self.current = min(self.most, max([self.need, *needs]))

    def reset(self) -> None:
        """Keep no lag: the agent plays at a slower pace, which leaves the time for late gossips."""
        self.need = self.current = 0


def _covering(late: Sequence[int]) -> int:
    """The smallest number of ticks within which the share `IN_TIME_SHARE` of the gossips came; `late`: those of each, in order."""
    return late[math.ceil(IN_TIME_SHARE * len(late)) - 1] if late else 0
