"""The table and the figure of the ablation: the parts of the OSPA of each method, a panel for each team."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from deploy.plots.study_figures import STYLE, _write, plt, write_table
from deploy.studies.ablation import PARTS, MethodSummary
from deploy.studies.design import OPEN_TEAMS

COLOURS = ("#33415c", "#cf3d2e", "#f4a736", "#9aa5b1")  # of the parts
LABELS = ("never seen", "seen and lost", "in view", "false")
COLUMNS = 4  # panels side by side


def write(lines: Sequence[MethodSummary], into: Path) -> list[Path]:
    """Write ablation.csv and the figure; the paths."""
    heads = [f"{score}_{part}" for score in ("ospa", "gospa") for part in PARTS]
    head = ["team", "targets", "method", "seeds", "ospa", "gospa", *heads, "gain", "low", "high"]
    rows = ([*line.group, *line[1:5], *line.parts, *line.gospa_parts, *line[7:]] for line in lines)
    return [write_table(into / "ablation.csv", head, rows), *draw(lines, into / "ablation")]


def draw(lines: Sequence[MethodSummary], stem: Path) -> list[Path]:
    """PDF and PNG of the figure; the paths."""
    groups = list(dict.fromkeys(line.group for line in lines))
    columns = min(COLUMNS, len(groups))
    height = -(-len(groups) // columns)
    methods = len(dict.fromkeys(line.method for line in lines))
    with plt.rc_context(STYLE):
        size = (1.2 + 1.9 * columns, 0.3 + height * (0.9 + 0.17 * methods))
        figure, panels = plt.subplots(height, columns, figsize=size, squeeze=False, sharey=True)
        for panel in panels.ravel()[len(groups) :]:
            panel.set_axis_off()
        for panel, group in zip(panels.ravel(), groups):
            _panel(panel, [line for line in lines if line.group == group])
            panel.set_title(f"{OPEN_TEAMS.get(group.team, f'team {group.team}')}, {group.targets} targets")
        panels[0][0].invert_yaxis()
        for panel in panels[-1]:
            panel.set_xlabel("OSPA (m)")
        figure.legend(*panels[0][0].get_legend_handles_labels(), loc="lower center", ncols=len(PARTS))
        figure.tight_layout(rect=(0.0, 0.25 / size[1], 1.0, 1.0))
        return _write(figure, stem)


def _panel(panel: Axes, lines: Sequence[MethodSummary]) -> None:
    """A bar for each method, made of the parts of its OSPA."""
    names = [line.method for line in lines]
    start = [0.0] * len(lines)
    for index, (colour, label) in enumerate(zip(COLOURS, LABELS)):
        widths = [line.parts[index] for line in lines]
        panel.barh(names, widths, left=start, color=colour, label=label, height=0.7)
        start = [left + width for left, width in zip(start, widths)]
    for line in lines:
        if line.method == "search-and-track":
            panel.axvline(line.ospa, color="black", linewidth=0.6, linestyle=":")
    panel.tick_params(axis="y", length=0.0)
