"""The figure of the robustness study: OSPA over time around the fault, a panel for each kind, a curve with a band for each level."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from deploy.studies.robustness import LEVELS, NONE, Played
from deploy.studies.study_figures import STYLE, _write, plt

COLOURS = ("#fdae61", "#d7191c", "#5e0b15")  # from the least to the worst level
TITLES = {
    "kill": "{:.0%} of the agents killed",
    "loss": "{:.0%} of the messages lost",
    "delay": "{:g} s late",
    "partition": "cut in two for {:g} s",
}
BEFORE, AFTER = 30.0, 60.0  # s that are shown
SMOOTH = 4.0  # s of the running mean, for the eye


def draw(played: Sequence[Played], stem: Path) -> list[Path]:
    """PDF and PNG of the study; the paths."""
    kinds = [kind for kind in LEVELS if any(found.bout.kind == kind for found in played)]
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, len(kinds), figsize=(2.4 * len(kinds) + 0.6, 2.4), sharey=True, squeeze=False, layout="constrained")
        for panel, kind in zip(axes[0], kinds):
            _curve(panel, [found for found in played if found.bout.kind == NONE], "#777777", "no fault")
            for level, colour in zip(LEVELS[kind], COLOURS):
                cell = [found for found in played if (found.bout.kind, found.bout.level) == (kind, level)]
                _curve(panel, cell, colour, TITLES[kind].format(level))
            panel.axvline(0.0, color="black", linewidth=0.6, linestyle=":")
            panel.set_xlim(-BEFORE, AFTER)
            panel.set_xlabel("time after the fault (s)")
            panel.legend(fontsize=6.5, loc="upper right")
        axes[0][0].set_ylabel("OSPA (m)")
        axes[0][0].set_ylim(bottom=0.0)
        return _write(figure, stem)


def _curve(panel: Axes, cell: Sequence[Played], colour: str, label: str) -> None:
    """The median over the seeds, and the band between the quartiles."""
    if not cell:
        return
    times = np.array(cell[0].times) - cell[0].bout.at
    width = max(1, round(SMOOTH / (times[1] - times[0])))
    values = np.array([np.convolve(found.ospa, np.ones(width) / width, mode="same") for found in cell])
    shown = (times >= -BEFORE) & (times <= AFTER)
    low, middle, high = np.quantile(values[:, shown], [0.25, 0.5, 0.75], axis=0)
    panel.fill_between(times[shown], low, high, color=colour, alpha=0.2, linewidth=0.0)
    panel.plot(times[shown], middle, color=colour, linewidth=1.0, label=label)
