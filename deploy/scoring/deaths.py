"""The deaths of a run: which agents died, which are only paused, and how long others took to cover their cells.

Agents that leave at the end of a run have not died: after the last tick the world ends, or the bodies where there is no world, and then
the agents are dismissed.
"""

from dataclasses import dataclass

import numpy as np

from deploy.scoring.chronicle import ScoredTick, is_taken
from deploy.scoring.result import Kill
from protocol.node import Event, Gone
from protocol.observer_messages import Truth

MOST_DEATHS = 4096  # kept of a run: one that comes and goes all the time fills no memory


@dataclass(slots=True)
class _Death:
    name: str
    tick: int
    time: float
    now: float
    cell: np.ndarray  # (K, 2), its last one, m
    closed: tuple[float, int] | None = None  # s, ticks
    is_over: bool = False  # others have its cell, or the agent owned one again before


class Deaths:
    """Takes deaths and what was scored at every tick. An agent in `paused`, on request, has not died when its token is lost.

    A hole is measured by the driver's clock, or with `in_world_time` by the world's, as in a simulation: its driver waits in no time.
    """

    def __init__(self) -> None:
        self.paused: set[str] = set()
        self.in_world_time = False
        self._deaths: list[_Death] = []

    def lose(self, name: str, tick: int, time: float, now: float, cell: np.ndarray) -> None:
        """Note that an agent died at a tick and world time, s; `cell` (K, 2) m is its last one. Of too many deaths the first are kept."""
        if len(self._deaths) < MOST_DEATHS:
            self._deaths.append(_Death(name, tick, time, now, cell))

    def regain(self, name: str, time: float) -> None:
        """An agent whose token was lost at a world time, s, is back in the same process: if that was noted as a death, it was none."""
        self._deaths = [loss for loss in self._deaths if (loss.name, loss.time) != (name, time)]

    def see(self, view: ScoredTick, now: float) -> None:
        """Note whose former cells others cover at a tick; once an agent owns a cell again there is nothing left for them to close."""
        for loss in self._deaths:
            if loss.is_over or view.tick <= loss.tick:
                continue
            if is_taken(loss.name, loss.cell, view):
                seconds = view.time - loss.time if self.in_world_time else now - loss.now
                loss.closed = seconds, view.tick - loss.tick
            loss.is_over = loss.closed is not None or view.owns_a_cell(loss.name)

    def kills(self) -> tuple[Kill, ...]:
        """All deaths in order."""
        return tuple(map(_kill, self._deaths))


def _kill(loss: _Death) -> Kill:
    seconds, ticks = loss.closed if loss.closed else (None, None)
    return Kill(name=loss.name, tick=loss.tick, time=loss.time, closed_seconds=seconds, closed_ticks=ticks)


def ends_run(event: Event, truth: Truth | None, ticks: int) -> bool:
    """Whether an event ends a run of so many ticks, of which `truth` is the newest that has been heard."""
    return isinstance(event, Gone) and event.role in ("world", "body") and truth is not None and truth.tick >= ticks - 1
