"""Figures of one run like Figure 3 of the paper: start, end and trajectories; and the run as an animation.

Drawn from a recording with matplotlib, in a style for a column of a paper (PDF with real fonts, and PNG).
"""

import logging
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib import animation
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from PIL import Image, ImageColor  # comes with matplotlib

from deploy.page.frames import density_grid
from deploy.page.picture import Picture
from deploy.recording.moments import moments
from deploy.recording.recording import Recording
from protocol.observer_messages import Truth
from protocol.settings import BadSetting
from protocol.whole_file import whole_file

STYLE: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.linewidth": 0.6,
    "axes.titlesize": 8.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 7.0,
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "figure.dpi": 150.0,
}
MUTED = ("#332288", "#44aa99", "#cc6677", "#117733", "#88ccee", "#882255", "#999933", "#aa4499", "#ddaa33")  # Paul Tol
TARGET, ESTIMATE, GONE = "#111111", "#c1121f", "#8a949e"
PANEL = 2.35  # in, of a panel's side
FRAMES_PER_SECOND = 10
MOST_FRAMES = 600
FILM_DPI = 100.0
COLOURS = 84  # of a GIF, beside those of cells, targets and estimates


@dataclass
class Trajectories:
    """Where bodies and targets have been: lists of (x, y) by name and by id; a target that leaves and comes back is two ways."""

    bodies: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    targets: dict[int, list[tuple[float, float]]] = field(default_factory=dict)

    def add(self, truth: Truth) -> None:
        """Note a tick."""
        for name, (x, y, _) in zip(truth.bodies, truth.poses.tolist()):
            self.bodies.setdefault(name, []).append((x, y))
        for number, (x, y) in zip(truth.ids.tolist(), truth.targets.tolist()):
            self.targets.setdefault(number, []).append((x, y))


def figure_of(recording: Recording) -> Figure:
    """Three panels: the start, the end, and the trajectories; raises BadSetting when nothing was recorded."""
    ways, last = Trajectories(), None
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(3.0 * PANEL + 0.5, PANEL + 0.75), layout="constrained")
        start, end, paths = figure.subplots(1, 3, sharex=True, sharey=True)
        for moment in moments(recording):
            ways.add(moment.truth)
            if last is None:
                draw_moment(start, moment.picture)
                start.set_title(f"(a) start, t = {moment.truth.time:g} s")
            last = moment
        if last is None:
            raise BadSetting(f"{recording.path}: nothing was recorded that could be drawn")
        draw_moment(end, last.picture)
        end.set_title(f"(b) end, t = {last.truth.time:g} s")
        draw_trajectories(paths, last.picture, ways)
        paths.set_title("(c) trajectories")
        start.set_ylabel("y (m)")
        figure.legend(handles=_legend(), loc="outside lower center", ncols=5, frameon=False, handletextpad=0.4, columnspacing=1.4)
        for axes in (start, end, paths):
            axes.set_xlabel("x (m)")
    return figure


def draw_moment(axes: Axes, picture: Picture) -> None:
    """Cells, footprints, density, bodies, targets and estimates of the tick that the picture shows."""
    _arena(axes, picture)
    grid, (columns, rows), square = density_grid(picture)
    shades = np.zeros((rows, columns, 4))
    shades[..., :3] = (0.08, 0.2, 0.43)
    shades[..., 3] = 0.75 * grid / 255.0
    axes.imshow(shades, origin="lower", extent=(0.0, columns * square, 0.0, rows * square), interpolation="bilinear", zorder=2)
    for index, known in enumerate(picture.agents.values()):
        _, estimate = picture.said(known)
        pose, alive = picture.pose(known.name), picture.is_alive(known)
        colour = MUTED[index % len(MUTED)]
        if alive and estimate is not None and len(estimate.cell):
            axes.fill(*estimate.cell.T, facecolor=colour, alpha=0.14, edgecolor="none", zorder=1)
            axes.fill(*estimate.cell.T, facecolor="none", edgecolor=colour, linewidth=0.6, zorder=3)
        if alive and pose is not None and known.sensor is not None:
            axes.fill(*known.sensor.footprint(pose).T, facecolor=colour, alpha=0.1, edgecolor=colour, linewidth=0.4, zorder=2)
        if pose is not None:
            _body(axes, pose, colour, alive)
        if alive and estimate is not None:
            axes.plot(*estimate.targets.T, "o", color=ESTIMATE, markersize=3.0, zorder=6)
    if picture.shown is not None:
        axes.plot(*picture.shown.targets.T, "o", color=TARGET, markersize=5.0, markerfacecolor="none", markeredgewidth=0.7, zorder=5)


def draw_trajectories(axes: Axes, picture: Picture, ways: Trajectories) -> None:
    """The ways of bodies in the colours of their cells and of targets in grey; where each began a dot, where it ended the body."""
    _arena(axes, picture)
    for way in ways.targets.values():
        axes.plot(*np.array(way).T, color="#555555", linewidth=0.5, alpha=0.7, zorder=2)
    for index, (name, known) in enumerate(picture.agents.items()):
        body, pose = ways.bodies.get(name), picture.pose(name)
        colour = MUTED[index % len(MUTED)]
        if body and pose:
            axes.plot(*np.array(body).T, color=colour, linewidth=0.8, zorder=3)
            axes.plot(*body[0], ".", color=colour, markersize=3.0, zorder=3)
            _body(axes, pose, colour, picture.is_alive(known))


def _arena(axes: Axes, picture: Picture) -> None:
    arena = picture.scenario.arena
    axes.set_xlim(0.0, arena.width)
    axes.set_ylim(0.0, arena.height)
    axes.set_aspect("equal")
    axes.tick_params(direction="in", top=True, right=True, length=2.0)


def _body(axes: Axes, pose: tuple[float, float, float], colour: str, alive: bool) -> None:
    """An arrow for a living body, a grey cross for a dead one."""
    marker = MarkerStyle(_ARROW).rotated(rad=pose[2]) if alive else MarkerStyle("X")
    shade = colour if alive else GONE
    axes.plot(pose[0], pose[1], marker=marker, color=shade, markersize=8.0, markeredgecolor="white", markeredgewidth=0.4, zorder=7)


_ARROW = np.array([[1.2, 0.0], [-0.9, 0.75], [-0.5, 0.0], [-0.9, -0.75], [1.2, 0.0]])


def _legend() -> list[Line2D]:
    arrow = MarkerStyle(_ARROW)
    return [
        Line2D([], [], color=MUTED[0], marker=arrow, markersize=6.0, linestyle="none", label="sensor, its cell and footprint"),
        Line2D([], [], color=GONE, marker="X", markersize=6.0, linestyle="none", label="dead"),
        Line2D([], [], color=TARGET, marker="o", markerfacecolor="none", markersize=5.0, linestyle="none", label="target"),
        Line2D([], [], color=ESTIMATE, marker="o", markersize=3.0, linestyle="none", label="estimate"),
        Line2D([], [], color="#15336e", marker="s", alpha=0.6, markersize=5.0, linestyle="none", label="density of the PHD"),
    ]


def write_figure(recording: Recording, folder: Path) -> list[Path]:
    """Write `trajectories.pdf` and `.png` into a folder; the files."""
    figure = figure_of(recording)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / "trajectories.pdf", folder / "trajectories.png"]
    with matplotlib.rc_context(STYLE):
        for file in files:
            with whole_file(file) as new:
                figure.savefig(new, dpi=300, metadata={"CreationDate": None} if file.suffix == ".pdf" else None)
    return files


def write_animation(recording: Recording, folder: Path, progress: Callable[[int, int], None] = lambda done, ticks: None) -> Path:
    """Write the run as `run.mp4` where ffmpeg is installed, as `run.gif` elsewhere; ten pictures a second, 600 at most.

    `progress` is called with (ticks done, ticks in all).
    """
    folder.mkdir(parents=True, exist_ok=True)
    with_film = shutil.which("ffmpeg") is not None
    dt = recording.scenario.run.dt
    ticks = min(recording.scenario.run.ticks, round(recording.seconds / dt) + 1)  # it may have been ended early
    file = folder / ("run.mp4" if with_film else "run.gif")
    every = max(1, -(-ticks // MOST_FRAMES), round(0.5 / dt))
    with matplotlib.rc_context({**STYLE, "figure.dpi": FILM_DPI}):
        figure = Figure(figsize=(4.0, 4.2), layout="constrained")
        axes = figure.subplots()
        writer = animation.FFMpegWriter(FRAMES_PER_SECOND) if with_film else SmallGif(FRAMES_PER_SECOND)
        with _ffmpeg_in_one_line(file), whole_file(file) as new, writer.saving(figure, str(new), dpi=FILM_DPI):
            for number, (picture, truth) in enumerate(moments(recording)):  # a recording may begin late
                if number % every == 0:
                    axes.clear()
                    draw_moment(axes, picture)
                    axes.set_title(f"t = {truth.time:.1f} s")
                    writer.grab_frame()
                    progress(truth.tick + 1, ticks)
    return file


@contextmanager
def _ffmpeg_in_one_line(file: Path) -> Iterator[None]:
    """Raise BadSetting with the last line of an ffmpeg that fails, as one without an encoder for H.264 or on a full disk."""
    logging.getLogger("matplotlib.animation").setLevel(logging.ERROR)  # it would log all lines
    try:
        yield
    except subprocess.CalledProcessError as error:
        why = str(error.stderr).strip().splitlines() or [f"exit code {error.returncode}"]
        raise BadSetting(f"{file}: ffmpeg cannot write it: {why[-1]}; without an ffmpeg in PATH it is a GIF") from None


class SmallGif(animation.PillowWriter):
    """A GIF whose frames share one palette: what does not change from frame to frame takes no room, a third of the bytes in all."""

    _frames: list[Image.Image]

    def finish(self) -> None:
        """Write the file."""
        frames = [frame.convert("RGB") for frame in self._frames]
        width, height = frames[0].size
        sample = Image.new("RGB", (width, 4 * height))
        for place in range(4):
            sample.paste(frames[place * len(frames) // 4], (0, place * height))
        common = sample.quantize(COLOURS, method=Image.Quantize.MEDIANCUT).getpalette() or []
        drawn = [ImageColor.getrgb(colour) for colour in (*MUTED, TARGET, ESTIMATE, GONE)]  # thin lines are too few pixels to be counted
        palette = Image.new("P", (1, 1))
        palette.putpalette([*common[: 3 * COLOURS], *(part for colour in drawn for part in colour[:3])])
        flat = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
        flat[0].save(self.outfile, save_all=True, append_images=flat[1:], duration=round(1000 / self.fps), loop=0)
