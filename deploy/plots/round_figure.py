"""One tick as a time line: in lockstep, in real time, and in real time with a lag. A drawing and no measurement."""

from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

LANES = {"s1": 1.0, "s2": 0.0}  # height of the line of each agent
EARLY, LATE, DEADLINE, WORK = 0.22, 0.75, 0.5, 0.13  # ticks: how long gossips take; when a round closes at the latest; a round's own time
ROUND, ALONE, INK = "#4c78a8", "#e45756", "#333333"


class RoundBar(NamedTuple):
    """A round on the line of an agent: its number, when it begins, and whether every gossip of its tick was there."""

    who: str
    number: int
    begin: float
    complete: bool = True


def round_figure() -> Figure:
    """Two agents in three ways to keep time. The gossip of s2 in tick 1 is late in all three."""
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    lockstep, realtime, lagging = figure.subplots(3, 1)
    slow = LATE + WORK + 0.1  # the length of tick 1 where the world waits
    _panel(lockstep, "lockstep: the world waits for all commands", [0.0, 1.0, 1.0 + slow, 2.0 + slow], 1)
    for begin, number in ((0.0, 0), (1.0 + slow, 2)):
        _rounds(lockstep, [RoundBar(who, number, begin + EARLY) for who in LANES])
    _rounds(lockstep, [RoundBar("s1", 1, 1.0 + LATE), RoundBar("s2", 1, 1.0 + EARLY)])
    _panel(realtime, "real time: a round closes at its deadline, here half a tick", [0.0, 1.0, 2.0, 3.0], 1)
    _rounds(realtime, [RoundBar("s1", 0, EARLY), RoundBar("s2", 0, EARLY), RoundBar("s1", 1, 1.0 + DEADLINE, complete=False)])
    _rounds(realtime, [RoundBar("s2", 1, 1.0 + EARLY), RoundBar("s1", 2, 2.0 + EARLY), RoundBar("s2", 2, 2.0 + EARLY)])
    _panel(lagging, "real time with a lag of 1 tick: tick 2 plays round 1", [0.0, 1.0, 2.0, 3.0], 1)
    _rounds(lagging, [RoundBar(who, number - 1, number + EARLY) for number in (1, 2) for who in LANES])
    lagging.set_xlabel("time in ticks.  ▼ observation    ↗ gossip    blue: a round with all gossips    red: a round without that of s2")
    return figure


def _panel(axes: Axes, title: str, ticks: list[float], late: int) -> None:
    """The lines of both agents, the beginnings of ticks, observations, and the gossips that follow them."""
    axes.set_title(title, loc="left")
    axes.set_xlim(-0.15, 3.25)
    axes.set_ylim(-0.45, 1.6)
    axes.set_xticks(ticks, [f"tick {number}" for number in range(len(ticks))])
    axes.set_yticks(list(LANES.values()), list(LANES))
    for height in LANES.values():
        axes.axhline(height, color=INK, linewidth=0.6)
    for number, begin in enumerate(ticks[:-1]):
        axes.axvline(begin, color=INK, linewidth=0.4, linestyle=":")
        for who, height in LANES.items():
            axes.plot(begin, height, "v", color=INK, markersize=6.0)
            took = LATE if who == "s2" and number == late else EARLY - 0.02
            arrow = {"arrowstyle": "->", "color": INK, "linewidth": 0.8}
            axes.annotate("", (begin + took, 1.0 - height), (begin, height), arrowprops=arrow)


def _rounds(axes: Axes, played: list[RoundBar]) -> None:
    """Boxes of rounds on the lines of their agents."""
    for who, number, begin, complete in played:
        colour = ROUND if complete else ALONE
        axes.broken_barh([(begin, WORK)], (LANES[who] - 0.13, 0.26), facecolor=colour, edgecolor=INK, linewidth=0.6, zorder=3)
        axes.annotate(f"round {number}", (begin + 0.5 * WORK, LANES[who] + 0.2), color=colour, ha="center")
