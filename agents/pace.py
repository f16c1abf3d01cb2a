"""The pace of an agent: it shares every tick, or every second, fourth, eighth one, as its time allows.

Data type: a `Pace`. An agent that cannot play every tick would skip rounds at random, and agents that skip at random meet in no round.
So all leave out the same ticks: a pace is a power of two, and an agent of pace n shares the ticks that n divides. Slow agents share only
ticks that the faster ones share as well. A tick is *shared* when its round is played with the gossips of the peers. It is *gossip-free*
when the pace leaves it out and the agent plays it alone (the counter `spared`), and *skipped* when its observation came too late to be
played at all.

Every gossip states the pace that its sender *needs*, from what it measures: how long after its tick a round begins, how long the driver is
busy with it, and which ticks were missed. Waiting for peers does not count. An agent *keeps* the slowest pace that it needs itself or that
one of its peers has stated, so all keep the same one. A need of its own beyond a second counts when it has been stated: nobody is silent
for long without having said so. Nothing that is kept is stated, so a pace falls as soon as the need has gone. In lockstep the world waits,
and the pace is 1.
"""

import statistics
from collections import deque
from collections.abc import Iterable

LONGEST_SECONDS, LONGEST_TICKS = 1.0, 8  # between two rounds are at most so many s, or so many ticks where these are longer
BUSY_SHARE, FREE_SHARE = 0.9, 0.6  # share of the time between two rounds that a round may take; that it may take at a faster pace
IDLE_SHARE = 0.25  # the same share, when one round is enough to judge by
JUDGED_ROUNDS, CALM_ROUNDS = 3, 2  # rounds by whose median the need rises, and by whose longest it falls
MEMORY_SECONDS = 2.0  # s for which the earliest observation shows when ticks begin


class Pace:
    """The pace of one agent. Times are `now` of its node, s."""

    def __init__(self, period: float, *, measured: bool) -> None:
        """`period`: s between two ticks; `measured` false: the pace stays 1."""
        self.need = 1  # stated in the gossip
        self._stated = 1  # of the open round
        self.current = 1  # the agent shares the ticks that this number divides
        self.has_time = True  # since the last round, nothing in the ticks between has taken longer than a tick
        self._is_open, self._ends = False, False  # a round is open; one has just ended, and the time of its end is still to come
        self._period, self._measured = period, measured
        self._unannounced = 1  # the slowest pace that the agent may keep before it has stated it
        while measured and 2 * self._unannounced * period <= LONGEST_SECONDS:
            self._unannounced *= 2
        self._most = max(self._unannounced, LONGEST_TICKS) if measured else 1
        self._begins: deque[tuple[float, float]] = deque()  # time of an observation, and when tick 0 would have been observed by it
        self._began = 0.0  # when the newest tick began
        self._played = -1  # tick of the newest round
        self._uneven_until = -1  # the tick until which peers may keep a slower pace
        self._began_late = self._spent = 0.0  # s from the beginning of the tick to its round, and s for which the driver was busy since
        self._durations = deque([0.0] * JUDGED_ROUNDS, maxlen=JUDGED_ROUNDS)  # of the last rounds, the sum of both, in ticks
        self._gaps = deque([1] * JUDGED_ROUNDS, maxlen=JUDGED_ROUNDS)  # ticks between the last rounds that were more than the pace; else 1

    def is_shared(self, tick: int) -> bool:
        """Whether the agent plays a tick with its peers."""
        return tick % self.current == 0

    def has_just_fallen(self, tick: int) -> bool:
        """Whether a peer may still keep the slower pace of before, because it has not heard that nobody needs it any more."""
        return tick <= self._uneven_until

    def observe(self, tick: int, now: float) -> None:
        """Note that the observation of a tick has come."""
        if not self._measured:
            return
        while self._begins and not 0.0 <= now - self._begins[0][0] <= MEMORY_SECONDS:
            self._begins.popleft()
        self._begins.append((now, now - tick * self._period))
        self._began = min([begin for _, begin in self._begins]) + tick * self._period

    def forget(self) -> None:
        """Forget when ticks began, and which was played last: the agent was stalled, or its clock has jumped.

        How long its rounds took still counts. An agent whose rounds are long is stalled by each of them, and one long stall is no median.
        """
        self._begins.clear()
        self._played = -1

    def open(self, tick: int, now: float) -> None:
        """A round of a tick opens, and the need is stated."""
        self._stated, self._is_open, self._ends = self.need, True, False
        gap = tick - self._played if self._played >= 0 else 1
        self._gaps.append(gap if gap > self.current else 1)
        self._played, self._began_late = tick, now - self._began

    def note_busy(self, seconds: float) -> None:
        """The driver was busy for some seconds with what the agent told it to do."""
        self._spent += max(0.0, seconds)
        if self._ends:
            self._ends, self.has_time = False, True
        elif not self._is_open:
            self.has_time &= seconds <= self._period

    def close(self, tick: int, needs: Iterable[int]) -> None:
        """The round of a tick ends. `needs`: the paces above 1 that peers have stated last."""
        if not self._measured:
            return
        self._is_open, self._ends = False, True
        took, self._spent = (self._began_late + self._spent) / self._period, 0.0
        if took <= self._most:  # else the agent was stopped: no pace could have been kept
            self._durations.append(took)
        duration, gap = statistics.median(self._durations), statistics.median(self._gaps)
        slower = self._power(max(duration / BUSY_SHARE, gap))
        calm = min(max(list(self._durations)[-CALM_ROUNDS:]) / FREE_SHARE, self._durations[-1] / IDLE_SHARE)
        faster = self._power(max(calm, gap))
        self.need = slower if slower > self.need else min(self.need, faster)
        own = max(self._stated, min(self.need, self._unannounced))
        before, self.current = self.current, self._power(max([own, *needs]))  # also where a peer states no power of two
        if self.current < before:
            self._uneven_until = tick + 2 * before

    def _power(self, number: float) -> int:
        """The smallest power of two that is not below a number, at most the slowest pace."""
        power = 1
        while power < number and power < self._most:
            power *= 2
        return power
