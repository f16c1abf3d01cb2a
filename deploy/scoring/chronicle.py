"""The chronicle: one sentence for the effect of each death, pause, return, cut and healing, derived from the cells before and after.

A death is reported `SETTLE` s of world time after others have taken its cell. Until then the swarm may still lose or find targets of the
dead agent. A cell is taken when living cells cover all of it but the share `OPEN`. A true target is tracked while an estimate lies within
the share `NEAR` of the cut-off of OSPA.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import shapely

from deploy.scoring.result import EventReport
from deploy.scoring.scores import ground

CLOSED = 1e-6  # of the arena: cells leave no hole, and do not overlap
NEAR = 0.3  # of the cut-off
SETTLE = 2.0  # s of the world
GIVE_UP = 15.0  # s of the world after which a cell that is still open is reported
OPEN = 0.01  # of a cell: so little of it is uncovered that others have taken it
LEAST = 0.05  # of a cell: smaller gains are not reported
MOST_HEIRS = 4


class ScoredTick(NamedTuple):
    """What was scored at one tick."""

    tick: int
    time: float  # s
    cells: Mapping[str, np.ndarray]  # of those that count, polygons in m
    ids: np.ndarray  # of the true targets
    targets: np.ndarray  # (N, 2) m
    estimates: np.ndarray  # (M, 2) m
    hole: float  # shares of the arena
    overlap: float
    cutoff: float  # of OSPA, m

    def owns_a_cell(self, name: str) -> bool:
        """Whether an agent counts at this tick and has ground of its own."""
        return len(self.cells.get(name, ())) >= 3

    def tracked(self) -> set[int]:
        """Ids of the true targets with an estimate nearby."""
        if not len(self.targets) or not len(self.estimates):
            return set()
        apart = np.linalg.norm(self.targets[:, None, :] - self.estimates[None, :, :], axis=2)
        return set(self.ids[apart.min(axis=1) <= NEAR * self.cutoff].tolist())

    def inside(self, cell: np.ndarray) -> set[int]:
        """Ids of the true targets in a cell."""
        if not len(self.targets):
            return set()
        return set(self.ids[shapely.contains_xy(ground(cell), self.targets)].tolist())


@dataclass
class Loss:
    """An agent that died or was paused, until its effect is reported."""

    name: str
    verb: str  # died, is paused, was silent
    tick: int
    time: float
    cell: np.ndarray
    tracked: set[int]  # targets in its cell that were tracked
    closed: int | None = None  # ticks until others had taken its cell
    settled: float = 0.0  # earliest time of the report, s
    heirs: list[tuple[str, float]] = field(default_factory=list)  # the share of the cell that each taker has
    seen: set[int] = field(default_factory=set)  # targets that were tracked shortly before the report

    def see(self, view: ScoredTick) -> str | None:
        """Look at the next tick; the sentence once it is due."""
        if view.tick <= self.tick:
            return None
        if self.closed is None and is_taken(self.name, self.cell, view):
            self.closed, self.settled = view.tick - self.tick, view.time + SETTLE
            self.heirs = shares(self.cell, view.cells)
        if self.closed is None and self.verb == "died" and view.owns_a_cell(self.name):
            return f"{self.what()}: it was back before others took its cell"
        if self.closed is None:
            return f"{self.what()}: its cell is still open" if view.time >= self.time + GIVE_UP else None
        if view.time >= self.settled - 0.5 * SETTLE:
            self.seen |= view.tracked()
        return self.tell(set(view.ids.tolist())) if view.time >= self.settled else None

    def tell(self, present: set[int]) -> str:
        """The sentence, when `present` are the targets that still exist."""
        if len(self.cell) < 3:
            return f"{self.what()}; it owned no cell"
        ticks = f"{self.closed} tick{'s' * (self.closed != 1)}"
        heirs = names_of(self.heirs)
        gone = (self.tracked & present) - self.seen
        lost = f"{len(gone)} of {len(self.tracked)} targets in it lost" if gone else "no target lost"
        return f"{self.what()}: {heirs or 'the others'} took its cell within {ticks}; {lost}"

    def what(self) -> str:
        """The agent, what befell it, and when."""
        return f"{self.name} {self.verb} at {self.time:.1f} s"


@dataclass
class Return:
    """An agent that is back, until it owns a cell."""

    name: str
    tick: int

    def see(self, view: ScoredTick) -> str | None:
        """Look at the next tick; the sentence once it owns a cell."""
        if view.tick <= self.tick or not view.owns_a_cell(self.name):
            return None
        ticks = view.tick - self.tick
        return f"{self.name} is back: it owns a cell again after {ticks} tick{'s' * (ticks != 1)}"


@dataclass
class Cut:
    """A cut or a healing, until each side covers the arena by itself; one side alone is the whole team."""

    tick: int
    sides: int

    def see(self, view: ScoredTick) -> str | None:
        """Look at the next tick; the sentence once the cells have settled."""
        if view.tick <= self.tick or view.hole > CLOSED or abs(view.overlap - (self.sides - 1)) > CLOSED:
            return None
        ticks = f"{view.tick - self.tick} tick{'s' * (view.tick - self.tick != 1)}"
        if self.sides == 1:
            return f"the healing: the cells tile the arena again after {ticks}"
        return f"the cut: each side covers the whole arena by itself after {ticks}"


class Chronicle:
    """Takes events and scored ticks, and reports the effect of each event."""

    def __init__(self) -> None:
        self._open: list[Loss | Return | Cut] = []
        self._last: ScoredTick | None = None
        self._cells: dict[str, np.ndarray] = {}  # the newest of each agent

    def lose(self, name: str, verb: str, tick: int, time: float) -> None:
        """An agent has gone."""
        self._drop(name)
        cell = self._cells.pop(name, np.empty((0, 2)))
        tracked = self._last.tracked() & self._last.inside(cell) if self._last else set()
        self._open.append(Loss(name, verb, tick, time, cell, tracked))

    def regain(self, name: str, tick: int, *, same: bool = False) -> None:
        """An agent is back; `same`: in the same process, which was only silent."""
        if same:
            self.resume(name)
        for one in self._open:
            if isinstance(one, Loss) and one.name == name and one.verb == "died" and same:
                one.verb = "was silent"
        self._open = [one for one in self._open if not (isinstance(one, Return) and one.name == name)]
        self._open.append(Return(name, tick))

    def resume(self, name: str) -> None:
        """A paused or silent agent goes on: its loss is not reported if nobody has taken its cell."""
        self._open = [one for one in self._open if not (isinstance(one, Loss) and one.name == name and one.closed is None)]

    def cut(self, verb: str, tick: int, sides: int) -> None:
        """Links were cut (partition) or cleared (heal), and `sides` are left. Nothing is told of a cut that leaves one side."""
        self._open = [one for one in self._open if not isinstance(one, Cut)]
        if verb == "heal" or sides > 1:
            self._open.append(Cut(tick, sides))

    def see(self, view: ScoredTick) -> list[EventReport]:
        """Show a scored tick; the sentences that are due."""
        told = []
        for one in list(self._open):
            text = one.see(view)
            if text is not None:
                self._open.remove(one)
                told.append(EventReport(view.time, "" if isinstance(one, Cut) else one.name, text))
        self._last = view
        self._cells.update(view.cells)
        return told

    def finish(self) -> list[EventReport]:
        """The run is over: the reports on losses that were not reported yet."""
        view, losses = self._last, [one for one in self._open if isinstance(one, Loss)]
        self._open = []
        if view is None:
            return []
        present, told = set(view.ids.tolist()), []
        for loss in losses:
            loss.seen |= view.tracked()
            text = loss.tell(present) if loss.closed is not None else f"{loss.what()}: its cell was open when the run ended"
            told.append(EventReport(view.time, loss.name, text))
        return told

    def _drop(self, name: str) -> None:
        """Drop the open events of an agent."""
        self._open = [one for one in self._open if isinstance(one, Cut) or one.name != name]


def is_taken(name: str, cell: np.ndarray, view: ScoredTick) -> bool:
    """Whether others cover the former cell (K, 2) m of an agent but for the share `OPEN`; not while the agent itself owns a cell.

    They do where there is no hole at all.
    """
    former = ground(cell)
    if not former.area:
        return True
    if view.owns_a_cell(name):
        return False
    if view.hole <= CLOSED:
        return True
    others = shapely.union_all([ground(other) for other in view.cells.values()])
    return bool(former.difference(others).area <= OPEN * former.area)


def shares(cell: np.ndarray, cells: Mapping[str, np.ndarray]) -> list[tuple[str, float]]:
    """Owners of a former cell and their shares, the largest first; shares below `LEAST` are left out."""
    former = ground(cell)
    if not former.area:
        return []
    found = [(name, ground(other).intersection(former).area / former.area) for name, other in cells.items()]
    return sorted([pair for pair in found if pair[1] >= LEAST], key=lambda pair: -pair[1])


def names_of(heirs: list[tuple[str, float]]) -> str:
    """`s2 (61 %) and s9 (37 %)`."""
    words = [f"{name} ({100.0 * share:.0f} %)" for name, share in heirs[:MOST_HEIRS]]
    if len(heirs) > MOST_HEIRS:
        words.append(f"{len(heirs) - MOST_HEIRS} more")
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
