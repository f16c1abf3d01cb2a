"""The tick rate of a run: ticks a second requested and done, rounds skipped or late, and advice when the machine is too small."""

import math
import os
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from deploy.scenario import Scenario, user_classes
from deploy.scoring.status import TickRate
from protocol.observer_messages import Estimate

WINDOW = 5.0  # s of the clock over which the present rate is measured
LEAST = 3.0  # s of data that a judgement needs
AGENT_TICKS_PER_CORE = 96.0  # rounds a second that a core plays in real time, all agents together
BAD_SHARE = 0.05  # of the rounds: more skipped ones are worth a line
SLOW = 0.9  # of the ticks that were asked for


def asked_per_s(scenario: Scenario) -> float | None:
    """Ticks a second of the wall clock that the scenario asks for; None: as fast as it goes."""
    run = scenario.run
    rate = run.rate if run.clock == "realtime" else run.max_rate
    return rate / run.dt if rate else None


def usable_cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def too_small(scenario: Scenario) -> str:
    """One line of advice when this machine is too small for the scenario in real time; else empty."""
    agents, cores, ticks = len(scenario.members), usable_cores(), asked_per_s(scenario)
    if scenario.run.clock != "realtime" or ticks is None or agents * ticks <= AGENT_TICKS_PER_CORE * cores:
        return ""
    fits, room = AGENT_TICKS_PER_CORE * cores / agents * scenario.run.dt, "1 core" if cores == 1 else f"{cores} cores"
    return f"{agents} agents at {ticks:g} ticks/s will be late on {room}: take --rate {fits:.2g} or less, fewer agents, or --lockstep"


class _Counts(NamedTuple):
    """Rounds that an agent has played, skipped, closed late, and played alone because it had no time for a shared one."""

    rounds: int
    skipped: int
    late: int
    spared: int


_NOTHING = _Counts(0, 0, 0, 0)


def _sum(counts: Sequence[_Counts]) -> _Counts:
    return _Counts(*map(sum, zip(_NOTHING, *counts)))


class TickRateMeter:
    """Measures the tick rate from the ticks of the world and the counters of the agents."""

    def __init__(self, scenario: Scenario) -> None:
        self.unread = 0  # messages for which the monitor has found no time
        self._scenario = scenario
        self._asked = asked_per_s(scenario)
        self._ticks: deque[tuple[float, int]] = deque()  # times and ticks of the last `WINDOW` s
        self._first: tuple[float, int] | None = None
        self._counts: dict[str, dict[int, _Counts]] = {}  # by name and incarnation: of the newest two, of which the older one may live on
        self._ended: dict[str, _Counts] = {}  # by name: what all earlier incarnations had counted
        self._paces: dict[str, int] = {}
        self._excused: set[str] = set()  # agents that were paused on request
        self._stood_still = False  # the world, since the last tick
        self._stalls: dict[str, tuple[int, float]] = {}  # ms of all stalls of an agent so far, and when the last one showed

    def tick(self, now: float, tick: int) -> None:
        """A tick of the world has come."""
        self._first = self._first or (now, tick)
        if self._stood_still:
            self._ticks.clear()
            self._stood_still = False
        self._ticks.append((now, tick))
        while self._ticks[0][0] < now - WINDOW and len(self._ticks) > 2:
            self._ticks.popleft()

    def count(self, estimate: Estimate) -> None:
        """Take the counters and the pace of an agent."""
        name, counters = estimate.sender, estimate.counters
        counted = self._counts.setdefault(name, {})
        counted[estimate.incarnation] = _Counts(*[counters.get(field, 0) for field in _Counts._fields])
        if len(counted) > 2:
            self._ended[name] = _sum([self._ended.get(name, _NOTHING), counted.pop(min(counted))])
        self._paces[name] = estimate.pace
        stalled = counters.get("stalled_ms", 0)
        if stalled and stalled != self._stalls.get(name, (0, 0.0))[0]:
            self._stalls[name] = stalled, self._ticks[-1][0] if self._ticks else 0.0

    def forget(self, name: str) -> None:
        """An agent has gone: its pace holds nobody up any more."""
        self._paces.pop(name, None)

    def excuse(self, name: str) -> None:
        """An agent is paused on request, or has lost its body: the rounds that it skips say nothing about the machine.

        Nor do ticks that fail to come while the world is paused or dead: its rate is measured from the next one on.
        """
        self._excused.add(name)
        self._stood_still = self._stood_still or name == "world"

    @property
    def rounds(self) -> int:
        """Rounds that all agents have played."""
        return self._sum_of(self._counts).rounds

    def _sum_of(self, names: Iterable[str]) -> _Counts:
        """What all incarnations of these agents have counted."""
        return _sum([one for name in names for one in (*self._counts[name].values(), self._ended.get(name, _NOTHING))])

    def at(self, now: float) -> TickRate:
        """The rate of the last seconds at a time of the clock, s: where ticks fail to come, at most what one more tick would make it."""
        found = self._status(self._ticks[0] if self._ticks else None, WINDOW)
        if found.ticks_per_s is not None:
            since, first = max((one for one in self._ticks if one[0] <= now - WINDOW), default=self._ticks[0])
            found.ticks_per_s = min(found.ticks_per_s, (self._ticks[-1][1] + 1 - first) / (now - since))
        return found

    def whole(self) -> TickRate:
        """The rate of the whole run."""
        return self._status(self._first, math.inf)

    def _status(self, start: tuple[float, int] | None, window: float) -> TickRate:
        """The rate since a tick; `window`: s for which a stall is remembered."""
        speed = None
        if start is not None and self._ticks[-1][0] > start[0]:
            speed = (self._ticks[-1][1] - start[1]) / (self._ticks[-1][0] - start[0])
        rounds, skipped, late, spared = self._sum_of(self._counts)
        found = TickRate(ticks_per_s=speed, asked_per_s=self._asked, rounds=rounds, skipped=skipped, late=late, spared=spared)
        found.pace = max(self._paces.values(), default=1)
        found.slowest = [name for name, pace in self._paces.items() if pace == found.pace > 1]
        newest = self._ticks[-1][0] if self._ticks else 0.0
        found.stalled = [name for name, (_, when) in self._stalls.items() if newest - when <= window]
        if self._first is not None and newest - self._first[0] >= LEAST:
            found.advice = self._advice(found) or self._own_advice()
        return found

    def _own_advice(self) -> str:
        """A line when the monitor falls behind, in lockstep, too; else empty."""
        if not self.unread:
            return ""
        return f"the monitor found no time for {self.unread} messages: holes and errors are overstated; the agents need a lower priority"

    def _advice(self, found: TickRate) -> str:
        """A line when rounds are skipped or ticks fall behind; empty in lockstep, where a slow machine takes longer and loses nothing."""
        rounds, skipped, _, _ = self._sum_of(self._counts.keys() - self._excused)
        run, share = self._scenario.run, skipped / max(1, rounds + skipped)
        if run.clock != "realtime":
            return ""
        speed = 1.0 if found.ticks_per_s is None or self._asked is None else min(1.0, found.ticks_per_s / self._asked)
        if share <= BAD_SHARE and speed >= SLOW:
            return ""
        fits = run.rate * speed * (1.0 - share)
        behind = f"{100.0 * share:.0f} % of the rounds are skipped" if share > BAD_SHARE else f"{100.0 * speed:.0f} % of the ticks come"
        what = f"{len(self._scenario.members)} agents at rate {run.rate:g}"
        own = " and ".join(user_classes(self._scenario))
        blamed = f"{own} takes too long, or " if own else ""  # what takes the time is not measured
        return f"{blamed}this machine is too small for {what} ({behind}): take --rate {fits:.2g} or less, or --lockstep"
