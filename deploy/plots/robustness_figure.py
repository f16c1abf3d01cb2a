"""The figure and the tables of the robustness study.

curves.csv holds a line for each bout and tick, bouts.csv one for each bout, robustness.csv the medians over the seeds. The figure has a
panel that says how much of the swarm can die, and one for each kind of fault with OSPA around it.
Lines are medians over the seeds, bands lie between the quartiles.
"""

from collections.abc import Sequence
from pathlib import Path
from string import ascii_lowercase

import numpy as np
from matplotlib.axes import Axes

from deploy.plots.study_figures import STYLE, _write, plt, write_table
from deploy.studies.robustness import NONE, Row, curve, summary, table

SHOWN: dict[str, tuple[float, ...]] = {  # as curves
    "kill": (0.1, 0.3, 0.5),
    "loss": (0.1, 0.3, 0.5),
    "bursts": (0.1, 0.3, 0.5),
    "delay": (0.1, 0.5, 2.0),
    "throttle": (128.0, 64.0, 32.0),
    "partition": (3.0, 6.0, 12.0),
}
COLOURS = ("#f4a736", "#cf3d2e", "#5e0b3f")  # from the least to the worst level
GREY = "#8a8a8a"
LABELS = {
    "kill": "{:.0%} killed",
    "loss": "{:.0%} lost",
    "bursts": "{:.0%} lost",
    "delay": "{:g} s late",
    "throttle": "{:g} kbit/s",
    "partition": "for {:g} s",
}
TITLES = {
    "kill": "deaths",
    "loss": "messages lost",
    "bursts": "messages lost in bursts",
    "delay": "messages delayed",
    "throttle": "little bandwidth",
    "partition": "cut in two halves",
}
BEFORE, AFTER = 20.0, 60.0  # s that are shown
SMOOTH = 3.0  # s of the running mean, for the eye


def write(rows: Sequence[Row], into: Path) -> list[Path]:
    """Write tables and figure; the paths."""
    lines = table(rows)
    points = [[*(row[name] for name in ("kind", "level", "seed")), *pair] for row in rows for pair in zip(row["times"], row["ospa"])]
    paths = [
        write_table(into / "curves.csv", ["kind", "level", "seed", "time", "ospa"], points),
        write_table(into / "bouts.csv", list(lines[0]), [list(one.values()) for one in lines]),
        write_table(into / "robustness.csv", list(summary(lines)[0]), [list(one.values()) for one in summary(lines)]),
    ]
    return [*paths, *draw(rows, into / "robustness")]


def draw(rows: Sequence[Row], stem: Path) -> list[Path]:
    """PDF and PNG of the figure; the paths."""
    with plt.rc_context(STYLE):
        kinds = [kind for kind in SHOWN if any(row["kind"] == kind for row in rows)]
        places = mosaic(kinds)
        figure, panels = plt.subplot_mosaic(places, figsize=(7.2, 2.35 * len(places)))  # type: ignore[arg-type]
        if "kill" in kinds:
            _deaths(panels["deaths"], summary(table(rows)))
        for kind in kinds:
            _around(panels[kind], rows, kind)
        top = max(panels[kind].get_ylim()[1] for kind in kinds)
        for kind in kinds:
            panels[kind].set_ylim(0.0, top)
        for letter, panel in zip(ascii_lowercase, panels.values()):
            panel.set_title(f"({letter}) {panel.get_title()}", loc="left")
            panel.set_title("")
            panel.grid(axis="y", linewidth=0.3, color="#cccccc")
            panel.set_axisbelow(True)
        figure.tight_layout()
        return _write(figure, stem)


def mosaic(kinds: Sequence[str]) -> list[list[str]]:
    """Which panel stands where, in rows of six places: deaths above, with two panels; the other kinds of faults below, three in a row."""
    others = [kind for kind in kinds if kind != "kill"]
    above = [["deaths"] * 4 + ["kill"] * 2] if "kill" in kinds else []
    rows = [others[start : start + 3] for start in range(0, len(others), 3)]
    return above + [[kind for kind in row for _ in range(6 // len(row))] for row in rows]


def _deaths(panel: Axes, cells: Sequence[Row]) -> None:
    """Settled OSPA against the share that died, beside that of a team that never had the dead."""
    found = [cell for cell in cells if cell["kind"] in (NONE, "kill")]
    shares = [100.0 * cell["level"] for cell in found]
    for name, colour, style, label in (
        ("reference", GREY, "--s", "fresh team of the survivors"),
        ("settled", COLOURS[1], "-o", "survivors, from 30 s after the deaths on"),
    ):
        low, high = ([cell[f"{name}_{end}"] for cell in found] for end in ("low", "high"))
        panel.fill_between(shares, low, high, color=colour, alpha=0.2, linewidth=0.0)
        panel.plot(shares, [cell[name] for cell in found], style, color=colour, linewidth=1.1, markersize=3.5, label=label)
    panel.set_title("how much of the swarm can die")
    panel.set_xlabel("share of the agents killed (%)")
    panel.set_ylabel("OSPA (m)")
    panel.set_xlim(-2.0, 92.0)
    panel.set_ylim(bottom=0.0)
    panel.set_xticks(range(0, 100, 10))
    panel.legend(loc="upper left")


def _around(panel: Axes, rows: Sequence[Row], kind: str) -> None:
    """OSPA around the fault, a curve for each level; the undisturbed run in grey."""
    _band(panel, [row for row in rows if row["kind"] == NONE], GREY, "no fault")
    for level, colour in zip(SHOWN[kind], COLOURS):
        _band(panel, [row for row in rows if (row["kind"], row["level"]) == (kind, level)], colour, LABELS[kind].format(level))
    panel.axvline(0.0, color="black", linewidth=0.6, linestyle=":")
    panel.set_title(TITLES[kind])
    panel.set_xlim(-BEFORE, AFTER)
    panel.set_xlabel("time after the fault (s)")
    panel.set_ylabel("OSPA (m)")
    panel.legend(fontsize=7.0, loc="upper right", handlelength=1.4, labelspacing=0.3)


def _band(panel: Axes, rows: Sequence[Row], colour: str, label: str) -> None:
    """The median over the seeds, and the band between the quartiles."""
    if not rows:
        return
    found = [curve(row) for row in rows]
    times = found[0].times
    width = max(1, round(SMOOTH / (times[1] - times[0])))
    low, middle, high = np.quantile([_smooth(one.ospa, width) for one in found], [0.25, 0.5, 0.75], axis=0)
    panel.fill_between(times, low, high, color=colour, alpha=0.18, linewidth=0.0)
    panel.plot(times, middle, color=colour, linewidth=1.0, label=label)


def _smooth(values: np.ndarray, width: int) -> np.ndarray:
    """The running mean over the last `width` values: nothing after a fault shows before it."""
    sums = np.concatenate([np.zeros(width), np.cumsum(values)])
    counts = np.minimum(np.arange(1, len(values) + 1), width)
    return (sums[width:] - sums[:-width]) / counts
