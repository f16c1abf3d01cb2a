"""The pace of an agent: it plays every tick, or every second, fourth, eighth one, as its time allows.

Data type: a `Pace`. An agent that cannot play every tick would skip rounds at random, and agents that skip at random meet in no round.
So all skip in step: a pace is a power of two, and an agent of pace n plays the ticks that n divides. Slow agents play only in ticks in
which the faster ones play as well.

Every gossip states the pace that its sender *needs*, from what it measures: how long after its tick a round begins, how long the driver is
busy with it, and which ticks were missed. Waiting for peers does not count. An agent *keeps* the slowest pace that it or
one of its peers needs. Nothing that is kept is stated, so a pace falls as soon as the need has gone. In lockstep the world waits, and
the pace is 1.
"""

import statistics
from collections import deque
from collections.abc import Iterable

LONGEST = 1.0  # s between two rounds, at most
FULL, FREE = 0.9, 0.6  # share of the time between two rounds that a round may take; that it may take at a faster pace
IDLE = 0.25  # the same share, when one round is enough to judge by
JUDGED, CALM = 3, 2  # rounds by whose median the need rises, and by whose longest it falls
REMEMBERED = 2.0  # s for which the earliest observation shows when ticks begin


class Pace:
    """The pace of one agent. Times are `now` of its node, s."""

    def __init__(self, period: float, *, measured: bool) -> None:
        """`period`: s between two ticks; `measured` false: the pace stays 1."""
        self.need = 1  # stated in the gossip
        self.current = 1  # the agent plays the ticks that this number divides
        self._period, self._measured = period, measured
        self._most = 1
        while measured and 2 * self._most * period <= LONGEST:
            self._most *= 2
        self._begins: deque[tuple[float, float]] = deque()  # time of an observation, and when tick 0 would have been observed by it
        self._began = 0.0  # when the newest tick began
        self._played = -1  # tick of the newest round
        self._began_late = self._spent = 0.0  # s from the beginning of the tick to its round, and s for which the driver was busy since
        self._durations: deque[float] = deque(maxlen=JUDGED)  # of the last rounds, the sum of both, in ticks
        self._gaps: deque[int] = deque(maxlen=JUDGED)  # ticks between the last rounds that were more than the pace; else 1

    def plays(self, tick: int) -> bool:
        """Whether the agent plays a tick."""
        return tick % self.current == 0

    def observe(self, tick: int, now: float) -> None:
        """Note that the observation of a tick has come."""
        if not self._measured:
            return
        while self._begins and not 0.0 <= now - self._begins[0][0] <= REMEMBERED:
            self._begins.popleft()
        self._begins.append((now, now - tick * self._period))
        self._began = min([begin for _, begin in self._begins]) + tick * self._period

    def forget(self) -> None:
        """Forget what was measured: the agent was stalled, or its clock has jumped, which says nothing about its rounds."""
        for measured in (self._begins, self._durations, self._gaps):
            measured.clear()
        self._played, self._began_late, self._spent = -1, 0.0, 0.0

    def open(self, tick: int, now: float) -> None:
        """A round of a tick opens."""
        gap = tick - self._played if self._played >= 0 else 1
        self._gaps.append(gap if gap > self.current else 1)
        self._played, self._began_late = tick, now - self._began

    def spend(self, seconds: float) -> None:
        """The driver was busy for some seconds with what the agent told it to do."""
        self._spent += max(0.0, seconds)

    def close(self, needs: Iterable[int]) -> None:
        """A round ends. `needs`: those that fresh gossips of peers state."""
        if not self._measured:
            return
        self._durations.append((self._began_late + self._spent) / self._period)
        self._spent = 0.0
        duration, gap = statistics.median_low(self._durations), statistics.median_low(self._gaps or [1])
        slower = self._power(max(duration / FULL, gap))
        calm = min(max(list(self._durations)[-CALM:]) / FREE, self._durations[-1] / IDLE)
        faster = self._power(max(calm, gap))
        self.need = slower if slower > self.need else min(self.need, faster)
        self.current = min(self._most, max([self.need, *needs]))

    def _power(self, number: float) -> int:
        """The smallest power of two that is not below a number, at most the slowest pace."""
        power = 1
        while power < number and power < self._most:
            power *= 2
        return power
