"""Figures of a study, as a paper would print them: boxplots of the steady error, and paired differences with their tests.

Figure 4 of the paper has a panel for each number of targets and a group of boxes for each team; figure 5 a group for each level of
heterogeneity. Every figure is written as PDF and PNG.
"""

import csv
import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # no display is needed
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from agents.coverage.capacity import detecting_capability, power_radius
from deploy.scenario import TeamSettings, team_counts
from deploy.studies.paired import Comparison, Group, compare, groups_of, values
from deploy.studies.trials import Row, methods_of
from protocol.sensing import SENSOR_CLASSES
from protocol.whole_file import whole_file
from world.score import heterogeneity_level

STYLE: dict[Any, Any] = {
    "font.family": "serif",
    "font.serif": ["STIXGeneral", "DejaVu Serif"],
    "mathtext.fontset": "stix",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "legend.frameon": False,
    "pdf.fonttype": 42,  # text stays text
    "savefig.dpi": 200,
}
COLOURS = {"voronoi": "#2166ac", "power": "#b2182b", "voronoi-cod": "#7f7f7f", "static": "#d9a441", "random": "#b8860b"}
OTHER_COLOURS = ("#444444", "#1b7837", "#762a83", "#e08214", "#35978f")  # of all other methods, in their order
NAMES = {"voronoi": "Voronoi", "power": "power diagram", "voronoi-cod": "Voronoi of the CODs", "static": "static", "random": "random"}
ORDER = ("voronoi", "voronoi-cod", "power")  # from left to right, as in the paper; others follow
FILES = {"efficacy": "figure4", "heterogeneity": "figure5"}
ERROR = "average OSPA error (m)"


def draw(rows: Sequence[Row], into: Path) -> list[Path]:
    """Write every figure that the study has data for; the paths of the files."""
    scenario = rows[0]["scenario"]
    methods = sorted(methods_of(rows), key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER))
    into.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(STYLE):
        figures = {FILES.get(scenario, "errors"): boxes(rows, methods)}
        if len(methods) > 1:
            base = "power" if "power" in methods else methods_of(rows)[0]
            figures["paired"] = differences(rows, [name for name in methods if name != base], base)
        return [path for name, figure in figures.items() for path in _write(figure, into / name)]


def _write(figure: Figure, stem: Path) -> list[Path]:
    """PDF and PNG without a date, so that the same data give the same files."""
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in ("pdf", "png")]
    for path, date in zip(paths, ("CreationDate", "Software")):
        with whole_file(path) as new:
            figure.savefig(new, metadata={date: None})
    plt.close(figure)
    return paths


def write_table(path: Path, head: Sequence[str], lines: Iterable[Sequence[Any]]) -> Path:
    """Write a table of a study as CSV, whole or not at all; the path."""
    with whole_file(path) as new, new.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(lines)
    return path


def boxes(rows: Sequence[Row], methods: Sequence[str]) -> Figure:
    """A panel for each number of targets, a group of boxes for each team, a box for each method."""
    groups = groups_of(rows)
    counts = list(dict.fromkeys(group.targets for group in groups))
    figure, panels = plt.subplots(1, len(counts), figsize=(0.6 + 2.4 * max(len(counts), 1.4), 2.6), sharey=True, squeeze=False)
    for panel, targets in zip(panels[0], counts):
        here = [group for group in groups if group.targets == targets]
        _boxes(panel, rows, here, methods)
        panel.set_title(f"{targets} targets")
        panel.set_xlabel(_axis(rows))
    panels[0][0].set_ylabel(ERROR)
    panels[0][0].set_ylim(bottom=0.0)
    patches = [Patch(facecolor="white", edgecolor=colour, label=NAMES.get(name, name)) for name, colour in _colours(methods).items()]
    figure.legend(handles=patches, loc="upper center", ncols=len(methods), bbox_to_anchor=(0.5, 1.0), handlelength=1.2)
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 0.92))
    return figure


def _boxes(panel: Axes, rows: Sequence[Row], groups: Sequence[Group], methods: Sequence[str]) -> None:
    width = 0.8 / len(methods)
    for shift, (method, shade) in enumerate(_colours(methods).items()):
        places = [place + (shift - (len(methods) - 1) / 2.0) * width for place in range(len(groups))]
        data = [list(values(rows, group, method).values()) for group in groups]
        colour = {"color": shade, "linewidth": 0.9}
        panel.boxplot(
            data,
            positions=places,
            widths=0.8 * width,
            boxprops=colour,
            whiskerprops=colour,
            capprops=colour,
            medianprops={**colour, "linewidth": 1.4},
            flierprops={"marker": "+", "markersize": 4.0, "markeredgecolor": shade},
            manage_ticks=False,
        )
    panel.set_xticks(range(len(groups)), [_label(rows, group) for group in groups])
    panel.set_xlim(-0.6, len(groups) - 0.4)
    panel.grid(axis="y", linewidth=0.3, color="#cccccc")
    panel.set_axisbelow(True)


def _colours(methods: Sequence[str]) -> dict[str, str]:
    """The colour of each method."""
    others = itertools.cycle(OTHER_COLOURS)
    return {method: COLOURS[method] if method in COLOURS else next(others) for method in methods}


def _axis(rows: Sequence[Row]) -> str:
    return {"efficacy": "number of sensors", "heterogeneity": "team and its heterogeneity level"}.get(rows[0]["scenario"], "team")


def _label(rows: Sequence[Row], group: Group) -> str:
    """What stands under a group: the number of sensors where teams differ in size alone, else the team and its level L (19)."""
    row = next(row for row in rows if str(row["team"]) == group.team)
    if row["scenario"] == "efficacy" and group.team in ("2", "3", "4", "5"):
        return str(row["agents"])
    level = level_of(group.team, row["triple"])
    return group.team if level is None else f"{group.team}\n{level:.2f} m"


def level_of(team: str, triple: str) -> float | None:
    """Heterogeneity level of a team of the paper's sensors with nothing in view, m (19); None where it has others."""
    counts = team_counts(TeamSettings(composition=team, triple=triple))
    if not set(counts) <= set(SENSOR_CLASSES):
        return None
    radii = [power_radius(detecting_capability(SENSOR_CLASSES[kind])) for kind, number in counts.items() for _ in range(number)]
    return heterogeneity_level(radii)


def differences(rows: Sequence[Row], others: Sequence[str], base: str = "power") -> Figure:
    """How much larger the error of each other method is than that of the base, seed by seed, with the tests beside it."""
    groups = groups_of(rows)
    size = (0.8 + 3.2 * len(others), 0.9 + 0.32 * len(groups))
    figure, panels = plt.subplots(1, len(others), figsize=size, sharey=True, squeeze=False)
    for panel, other in zip(panels[0], others):
        found = [compare(rows, group, base, other) for group in groups]
        _differences(panel, [pair for pair in found if pair is not None], groups)
        panel.set_title(f"{NAMES.get(other, other)} minus {NAMES.get(base, base)}")
        panel.set_xlabel("difference of the average OSPA error (m)")
    several = len({group.targets for group in groups}) > 1
    names = [_label(rows, group) for group in groups]
    names = [f"{name} sensors" if name.isdecimal() else name.replace("\n", ", ") for name in names]
    labels = [name + (f", {group.targets} targets" if several else "") for name, group in zip(names, groups)]
    panels[0][0].set_yticks(range(len(groups)), labels)
    panels[0][0].set_ylim(len(groups) - 0.4, -0.6)
    figure.tight_layout()
    return figure


def _differences(panel: Axes, pairs: Sequence[Comparison], groups: Sequence[Group]) -> None:
    panel.axvline(0.0, color="black", linewidth=0.6)
    for pair in pairs:
        place = groups.index(pair.group)
        better = [difference for difference in pair.differences if difference > 0.0]
        worse = [difference for difference in pair.differences if difference <= 0.0]
        panel.plot(better, [place] * len(better), "o", markersize=3.5, markerfacecolor="none", markeredgecolor=COLOURS["power"])
        panel.plot(worse, [place] * len(worse), "x", markersize=4.0, markeredgecolor="#444444")
        centre = sum(pair.differences) / len(pair.differences)
        panel.plot([centre, centre], [place - 0.28, place + 0.28], color="black", linewidth=1.2)
        panel.annotate(_tests(pair), (1.01, place), xycoords=("axes fraction", "data"), va="center", fontsize=7.0)
    panel.grid(axis="x", linewidth=0.3, color="#cccccc")
    panel.set_axisbelow(True)


def _tests(pair: Comparison) -> str:
    """Seeds won, and p of the signed-rank test."""
    won = f"{pair.wins}/{len(pair.differences)}"
    if pair.wilcoxon is None:
        return won
    return f"{won}, p < 0.001" if pair.wilcoxon < 0.001 else f"{won}, p = {pair.wilcoxon:.3f}"
