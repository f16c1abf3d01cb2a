"""What the paper makes of one tick: from what all agents say at its beginning to cells, mass, load, U and commands at its end."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from shapely import Polygon

from tests.oracle import cells, law, wedges
from tests.oracle.paper_filter import Phd, background, correct, predict, within
from tests.oracle.said import Tick
from tests.oracle.wedges import Wedge


@dataclass
class Verdict:
    """On one agent."""

    cod: np.ndarray  # (2,), m
    cell: Polygon
    mass: float  # expected targets in the cell (17)
    load: float  # and in the footprint (10); an agent without a cell corrects nothing, and reads the predicted PHD
    unused: float  # U, m^2 (11), from the load
    command: tuple[float, float, float]  # vx, vy, turn rate (18)
    own: Phd  # the PHD in the cell


def verdicts(tick: Tick, settings: dict[str, Any], sensors: dict[str, Wedge], dice: np.random.Generator) -> dict[str, Verdict]:
    """By agent, in the order of names; the dice matter only where the run's settings leave something to them."""
    said, kind = list(tick.gossips.values()), settings["partition"]["kind"]
    cods = np.array([wedges.cod(sensors[gossip.sender], gossip.pose) for gossip in said])
    poses, radii = np.array([gossip.pose for gossip in said]), np.array([wedges.power_radius(gossip.unused) for gossip in said])
    diagram = cells.generators(poses, cods, radii, kind)
    polygons = cells.power_cells(diagram, settings["arena"]["width"], settings["arena"]["height"])
    before = predict(tick.particles(), settings, dice)
    after = within(correct(before + background(settings, dice), tick.scans(settings, sensors), settings, dice), settings)
    owner = cells.owners(after.states[:, :2], diagram)
    found = {}
    for number, gossip in enumerate(said):
        wedge, mine = sensors[gossip.sender], owner == number
        own = Phd(after.states[mine], after.weights[mine])
        read = before if polygons[number].is_empty else after
        load = read.mass(wedges.sees(wedge, gossip.pose, read.states[:, :2]))
        command, goal = (0.0, 0.0, 0.0), centroid(own, polygons[number])
        if goal is not None:
            driven = poses[number, :2] if kind == "voronoi" else cods[number]
            command = law.command(goal, driven, poses[number], settings)
        unused = wedges.unused(wedge, load, settings)
        found[gossip.sender] = Verdict(cods[number], polygons[number], own.mass(), load, unused, command, own)
    return found


def centroid(own: Phd, cell: Polygon) -> np.ndarray | None:
    """Of the PHD in a cell (17), m; of the cell's area where there is none; None without a cell."""
    if own.mass() > 0.0:
        return own.weights @ own.states[:, :2] / own.mass()
    return None if cell.is_empty else np.array(cell.centroid.coords[0])
