"""The method in pictures, of a recorded run: footprints, centroid of detection, cells, capacity, goal, claim, copies, a death; and a round.

The pictures are of one tick: the last one before the first death, or the middle of a run without deaths. The goal is of the tick in which
its agent believed in a target and had the longest way. The agent that is drawn large is the one that dies, or the first one.
"""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from agents.config import CapacitySettings
from agents.coverage.capacity import detecting_capability, unused_capacity
from agents.coverage.cells import power_cell
from deploy.plots.round_figure import round_figure
from deploy.plots.run_figures import ESTIMATE, GONE, MUTED, STYLE
from deploy.recording.moments import moments
from deploy.recording.recording import Recording
from deploy.scenario import Scenario
from protocol.geometry import rectangle
from protocol.messages import Gossip
from protocol.observer_messages import Estimate
from protocol.sensing import SENSOR_CLASSES, SensorModel, WedgeSensor
from protocol.settings import BadSetting, sensor_of
from protocol.whole_file import whole_file

LATER = 8  # ticks after the death, in its last panel
COLUMNS = 4  # of footprints
MODES = ("literal", "expected", "saturating", "static")


class SeenAgent(NamedTuple):
    """What has been heard of one agent at a tick."""

    name: str
    alive: bool
    pose: tuple[float, float, float]
    sensor: SensorModel
    gossip: Gossip
    estimate: Estimate
    colour: str


SeenAgents = dict[str, SeenAgent]  # by name


def seen_agents_by_tick(recording: Recording) -> list[SeenAgents]:
    """All agents at every tick from which all of them were heard; raises BadSetting without such a tick."""
    found: list[SeenAgents] = []
    for picture, _ in moments(recording):
        moment: SeenAgents = {}
        for index, known in enumerate(picture.agents.values()):
            gossip, estimate = picture.said(known)
            pose = picture.pose(known.name)
            if gossip is not None and estimate is not None and pose is not None and known.sensor is not None:
                colour = MUTED[index % len(MUTED)]
                moment[known.name] = SeenAgent(known.name, picture.is_alive(known), pose, known.sensor, gossip, estimate, colour)
        if moment and len(moment) == len(picture.agents):
            found.append(moment)
    if not found:
        raise BadSetting(f"{recording.path}: nothing was recorded that could be drawn")
    return found


def write_figures(recording: Recording, folder: Path) -> list[Path]:
    """Write the pictures as PNG into a folder; the files. The picture of a death needs a run in which an agent dies."""
    folder.mkdir(parents=True, exist_ok=True)
    scenario, all_moments = recording.scenario, seen_agents_by_tick(recording)
    deaths = [(index, name) for index, moment in enumerate(all_moments) for name, seen in moment.items() if not seen.alive]
    at, name = (max(0, deaths[0][0] - 1), deaths[0][1]) if deaths else (len(all_moments) // 2, next(iter(all_moments[0])))
    moment = all_moments[at]
    with matplotlib.rc_context(STYLE):
        figures = {
            "footprints": footprints_figure(scenario),
            "cod": cod_figure(moment[name]),
            "power-cells": diagram_figure(moment, scenario),
            "unused-capacity": capacity_figure(moment[name].sensor),
            "goal": goal_figure(max(all_moments, key=lambda moment: _way(moment[name])), name),
            "claim": claim_figure(moment, name, scenario),
            "copies": copies_figure(moment, name, scenario),
            "round": round_figure(),
        }
        if deaths:
            after = [all_moments[min(deaths[0][0] + later, len(all_moments) - 1)] for later in (0, 1, LATER)]
            figures["death"] = death_figure([moment, *after], name, scenario)
        files = [folder / f"{title}.png" for title in figures]
        for file, figure in zip(files, figures.values()):
            with whole_file(file) as new:
                figure.savefig(new, dpi=150)
    return files


def footprints_figure(scenario: Scenario) -> Figure:
    """The footprints of Table I on one scale (Figure 2); for a scenario with classes of its own those and its team's instead."""
    own = [*scenario.members.values(), *scenario.sensors] if scenario.sensors else SENSOR_CLASSES
    sensors = {name: sensor_of(scenario, name) for name in sorted(set(own))}
    rows = math.ceil(len(sensors) / COLUMNS)
    figure = Figure(figsize=(7.6, 2.3 * rows), layout="constrained")
    reach = max(sensor.reach for sensor in sensors.values())
    panels = figure.subplots(rows, COLUMNS, sharex=True, sharey=True).flat
    for (name, sensor), colour, axes in zip(sensors.items(), itertools.cycle(MUTED), panels):
        axes.fill(*sensor.footprint((0.0, 0.0, 0.5 * math.pi)).T, facecolor=colour, alpha=0.4, edgecolor=colour)
        axes.plot(0.0, 0.0, "s", color="#111111", markersize=4.0)
        axes.set_title(f"{name}: {_facts(sensor)}")
        _square(axes, np.full(2, -reach), np.full(2, reach))
    for axes in panels:
        axes.set_axis_off()
    return figure


def _facts(sensor: SensorModel) -> str:
    """What tells a sensor from others."""
    if isinstance(sensor, WedgeSensor):
        return f"{math.degrees(sensor.angle):.0f}°, {sensor.radius:g} m, p_d {sensor.prob_detection:g}"
    return f"reach {sensor.reach:g} m, {sensor.area:.0f} m²"


def cod_figure(seen: SeenAgent) -> Figure:
    """One sensor: its body, its footprint, its centroid of detection, and the circle of its power radius."""
    figure = Figure(figsize=(4.0, 3.6), layout="constrained")
    axes = figure.subplots()
    footprint, cod = seen.sensor.footprint(seen.pose), seen.estimate.cod
    axes.fill(*footprint.T, facecolor=seen.colour, alpha=0.4, edgecolor=seen.colour, label="footprint")
    axes.plot(*seen.pose[:2], "o", color=seen.colour, markersize=7.0, label="body")
    axes.plot(*cod, "D", color="#111111", markersize=6.0, label="centroid of detection, the generator")
    circle = _circle(cod, seen.estimate.power_radius)
    axes.plot(*circle.T, "--", color="#111111", linewidth=0.9, label=f"power radius, {seen.estimate.power_radius:.1f} m")
    points = np.vstack([footprint, circle])
    _square(axes, points.min(axis=0) - 1.0, points.max(axis=0) + 1.0)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.1), frameon=False)
    return figure


def diagram_figure(moment: SeenAgents, scenario: Scenario) -> Figure:
    """The same generators twice: without weights, and with their power radii."""
    figure = Figure(figsize=(7.6, 4.0), layout="constrained")
    living = [seen for seen in moment.values() if seen.alive]
    points = np.array([seen.estimate.cod for seen in living])
    radii = np.array([seen.estimate.power_radius for seen in living])
    arena = rectangle(scenario.arena.width, scenario.arena.height)
    for axes, used, title in zip(figure.subplots(1, 2), (np.zeros(len(radii)), radii), ("Voronoi: all weights are 0", "power diagram")):
        for index, seen in enumerate(living):
            _cell(axes, power_cell(index, points, used, arena), seen.colour)
            axes.plot(*points[index], "D", color=seen.colour, markersize=4.0)
            if used[index]:
                axes.plot(*_circle(points[index], used[index]).T, "--", color=seen.colour, linewidth=0.7)
        _whole(axes, scenario)
        axes.set_title(title)
    return figure


def capacity_figure(sensor: SensorModel) -> Figure:
    """U against the load, for each way of reading (11)."""
    figure = Figure(figsize=(4.4, 3.0), layout="constrained")
    axes = figure.subplots()
    capability = detecting_capability(sensor)
    loads = np.linspace(0.01, 10.0, 200)
    share = capability / sensor.area  # the mean p_d
    for mode, style in zip(MODES, ("-", "--", "-.", ":")):
        settings = CapacitySettings(mode=mode)  # type: ignore[arg-type]
        axes.plot(loads, [unused_capacity(capability, share * load, load, settings) for load in loads], style, label=mode, color="#111111")
    axes.set_xlabel("load: expected targets in the footprint")
    axes.set_ylabel("unused capacity U (m²)")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False)
    return figure


def goal_figure(moment: SeenAgents, name: str) -> Figure:
    """A cell with its density, the centroid of that, and the way of the centroid of detection to it."""
    figure = Figure(figsize=(4.4, 4.6), layout="constrained")
    axes = figure.subplots()
    own = moment[name]
    footprint, cod, states = own.sensor.footprint(own.pose), own.estimate.cod, own.gossip.states
    for seen in moment.values():
        _cell(axes, seen.estimate.cell, own.colour if seen.name == name else GONE, 0.25 if seen.name == name else 0.0)
    axes.fill(*footprint.T, facecolor="none", edgecolor=own.colour, linestyle=":", label="footprint")
    axes.plot(*states[:, :2].T, ".", color=own.colour, markersize=2.5, label="particles")
    axes.plot(*own.pose[:2], "o", color=own.colour, markersize=7.0, label="body")
    axes.plot(*cod, "D", color="#111111", markersize=5.0, label="centroid of detection")
    if len(states):
        axes.plot(*_centroid(states), "*", color="#111111", markersize=11.0, label="centroid of the density in the cell")
        axes.annotate("", tuple(_centroid(states)), cod, arrowprops={"arrowstyle": "->", "color": "#111111"})
    points = np.vstack([footprint, own.estimate.cell])
    _square(axes, points.min(axis=0) - 2.0, points.max(axis=0) + 2.0)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.06), frameon=False)
    return figure


def claim_figure(moment: SeenAgents, name: str, scenario: Scenario) -> Figure:
    """A cell, and the generators that bound it: both together are the claim."""
    figure = Figure(figsize=(4.4, 4.4), layout="constrained")
    axes = figure.subplots()
    own = moment[name].estimate
    for seen in moment.values():
        bounds = seen.name in own.neighbours
        _cell(axes, seen.estimate.cell, seen.colour if seen.name == name else GONE, 0.4 if seen.name == name else 0.0)
        axes.plot(*seen.estimate.cod, "D", color="#111111" if bounds or seen.name == name else GONE, markersize=5.0 if bounds else 3.5)
        if bounds:
            axes.plot(*np.array([own.cod, seen.estimate.cod]).T, color="#111111", linewidth=0.7)
            axes.annotate(seen.name, seen.estimate.cod, textcoords="offset points", xytext=(5.0, 3.0))
    axes.annotate(name, own.cod, textcoords="offset points", xytext=(5.0, 3.0), weight="bold")
    _whole(axes, scenario)
    return figure


def copies_figure(moment: SeenAgents, name: str, scenario: Scenario) -> Figure:
    """The particles that an agent owns, and those of others, in the colours of their owners, within the halo of its cell."""
    figure = Figure(figsize=(4.4, 4.4), layout="constrained")
    axes = figure.subplots()
    for seen in moment.values():
        _cell(axes, seen.estimate.cell, seen.colour, 0.15 if seen.name == name else 0.05)
        states = seen.gossip.states
        axes.plot(*states[:, :2].T, ".", color=seen.colour, markersize=2.5 if seen.name == name else 1.5)
    cell = moment[name].estimate.cell
    if len(cell):
        halo = shapely.Polygon(cell).buffer(scenario.filter.halo).exterior
        axes.plot(*np.array(halo.coords).T, "--", color="#111111", linewidth=0.8)
    _whole(axes, scenario)
    return figure


def death_figure(stages: Sequence[SeenAgents], name: str, scenario: Scenario) -> Figure:
    """The cells before a death, in the tick of the death, in the next, and a while later."""
    figure = Figure(figsize=(10.0, 3.3), layout="constrained")
    titles = ("the tick before", f"{name} dies", "one tick later", f"{LATER * scenario.run.dt:g} s later")
    for axes, moment, title in zip(figure.subplots(1, 4), stages, titles):
        for seen in moment.values():
            if seen.alive:
                _cell(axes, seen.estimate.cell, seen.colour, 0.35 if seen.name == name else 0.12)
                axes.plot(*seen.gossip.states[:, :2].T, ".", color=seen.colour, markersize=1.2)
                axes.plot(*seen.estimate.targets.T, "o", color=ESTIMATE, markersize=3.0)
            axes.plot(*seen.pose[:2], "s" if seen.alive else "X", color=seen.colour if seen.alive else GONE, markersize=4.0)
        former = stages[0][name].estimate.cell
        if len(former):
            axes.plot(*np.vstack([former, former[:1]]).T, "--", color="#111111", linewidth=1.0)
        _whole(axes, scenario)
        axes.set_title(title)
    signs = [
        Line2D([], [], color=GONE, marker="s", linestyle="", markersize=4.0, label="body"),
        Line2D([], [], color=GONE, marker="X", linestyle="", markersize=4.0, label="body of the dead"),
        Line2D([], [], color=GONE, marker=".", linestyle="", markersize=2.0, label="particles, in the colour of their owner"),
        Line2D([], [], color=ESTIMATE, marker="o", linestyle="", markersize=3.0, label="estimate"),
        Line2D([], [], color="#111111", linestyle="--", linewidth=1.0, label=f"the last cell of {name}"),
    ]
    figure.legend(handles=signs, loc="outside lower center", ncols=len(signs), frameon=False)
    return figure


def _centroid(states: np.ndarray) -> np.ndarray:
    """The centroid (2,) of the particles of one agent, which all weigh the same, m."""
    return np.asarray(states[:, :2].mean(axis=0))


def _way(seen: SeenAgent) -> float:
    """How far a centroid of detection is from the centroid of the density in its cell, m, where it believes half a target; else 0."""
    if len(seen.gossip.states) * seen.gossip.weight < 0.5 or not len(seen.estimate.cell):
        return 0.0
    return float(np.linalg.norm(_centroid(seen.gossip.states) - seen.estimate.cod))


def _cell(axes: Axes, cell: np.ndarray, colour: str, fill: float = 0.12) -> None:
    """A cell with its border; nothing where it is empty."""
    if len(cell):
        axes.fill(*cell.T, facecolor=colour, alpha=fill, edgecolor="none")
        axes.fill(*cell.T, facecolor="none", edgecolor=colour, linewidth=0.8)


def _circle(centre: Sequence[float] | np.ndarray, radius: float) -> np.ndarray:
    """Points of a circle (N, 2), m."""
    turns = np.linspace(0.0, 2.0 * np.pi, 90)
    return np.array(centre) + radius * np.column_stack([np.cos(turns), np.sin(turns)])


def _whole(axes: Axes, scenario: Scenario) -> None:
    _square(axes, np.zeros(2), np.array([scenario.arena.width, scenario.arena.height]))


def _square(axes: Axes, least: np.ndarray, most: np.ndarray) -> None:
    """Axes in metres of one scale."""
    axes.set_xlim(least[0], most[0])
    axes.set_ylim(least[1], most[1])
    axes.set_aspect("equal")
    axes.tick_params(direction="in", top=True, right=True, length=2.0)
