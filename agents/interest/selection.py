"""The selection of the peers that an agent must hear.

These are the owners of all that lies around its cell and in its footprint, and the sensors that observe the surroundings of its cell. The
selection is computed from the last known positions, so everything is asked for `SELECTION_MARGIN` m wider than the round needs. In doubt a
peer is selected: a gossip that is not needed changes no bit.

A selection is *certified* when no unknown peer could belong to it. Beacons come from all tiles of the needed rectangle, so an unknown
peer is too far away to own anything here, even with the largest power radius that is known.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.interest.position_table import GENERATOR_X, POWER_RADIUS, SENSOR_REACH, SENSOR_X
from agents.interest.tiles import Bounds, Rectangle
from agents.tracking.particles import squared_distances
from protocol.geometry import distances

BEACON_PERIOD = 4.0  # s of world time between two beacons of an agent that hardly moves
SELECTION_PERIOD = 1.0  # s of world time between two selections
BEACON_JUMP = 4.0  # m: an agent whose position, generator or radius differs by more from its last beacon sends another at once
SELECTION_MARGIN = 14.0  # m: so far a COD jumps in one tick when a class D sensor turns round; 10 m failed in 2 of 20 runs of 100 s
APPEARANCE_MARGIN = 8.0  # m more around the place where an empty cell is expected to appear
GRID_SPACING = 6.0  # m between the points at which owners are searched; no cell is so small that it is missed
OWNER_SLACK = math.sqrt(2.0) * GRID_SPACING  # m^2 per m: see `owners`
SEARCH_RADIUS = 40.0  # m: the place where an empty cell will appear is searched this far around its generator


class KnownArena(NamedTuple):
    """What an agent knows of the arena: its corners (4, 2) m, and bounds that no known agent exceeds."""

    arena: np.ndarray
    bounds: Bounds
    drift: float  # m: how far an agent may be from the position in its last beacon


class Selection(NamedTuple):
    """The peers among N that must be heard, (N,) bool, and the rectangle in which all agents must be known to certify that."""

    chosen: np.ndarray
    needed: Rectangle


def owners(points: np.ndarray, generators: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The generators that own anything near the points, and the least power distance at each point.

    Of the generators (N, 3) those are found, (N,) bool, that own anything within `GRID_SPACING` / sqrt(2) m of any of the points (P, 2).
    The power distances are (P,) m^2. The difference of two power distances is linear with slope 2 |p - q|. So the owner of a place this
    close to a point has at the point a power distance at most sqrt(2) `GRID_SPACING` |p - q| above the least one.
    """
    found = np.zeros(len(generators), dtype=bool)
    rows = np.nonzero(_within_reach(points, generators))[0]
    near = generators[rows]
    power = squared_distances(near, points) - (near[:, 2] ** 2)[:, None]
    best = power.argmin(axis=0)
    least = power[best, np.arange(len(points))]
    apart = np.sqrt(squared_distances(near, near[best]))
    found[rows] = (power - least <= OWNER_SLACK * apart).any(axis=1)
    return found, least


def _within_reach(points: np.ndarray, generators: np.ndarray) -> np.ndarray:
    """The generators (N, 3) that could own anything around the points (P, 2), (N,) bool.

    A circle holds the points. Each generator is compared at its best place in the circle with the best generator at its worst place.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = np.sqrt(((points - middle) ** 2).sum(axis=1).max()) + GRID_SPACING
    away = np.sqrt((generators[:, 0] - middle[0]) ** 2 + (generators[:, 1] - middle[1]) ** 2)
    squared = generators[:, 2] ** 2
    found: np.ndarray = np.maximum(away - radius, 0.0) ** 2 - squared <= ((away + radius) ** 2 - squared).min()
    return found


def _axis(low: float, high: float, step: float) -> np.ndarray:
    """Numbers from `low` in steps until `high` is passed, m."""
    return low + step * np.arange(2 + int(max(high - low, 0.0) / step))


def search_grid(cell: np.ndarray, position: tuple[float, float], halo: float, reach: float, ground: KnownArena) -> np.ndarray:
    """Points (P, 2) of a grid over the arena within the halo of a cell or within `reach` m of the sensor, `SELECTION_MARGIN` m wider."""
    around, arena = np.vstack([cell, [position]]), ground.arena
    width = max(halo, reach) + SELECTION_MARGIN + GRID_SPACING
    low = np.maximum(around.min(axis=0) - width, arena.min(axis=0))
    high = np.minimum(around.max(axis=0) + width, arena.max(axis=0))
    points = np.stack(np.meshgrid(*(_axis(low[axis], high[axis], GRID_SPACING) for axis in (0, 1))), axis=-1).reshape(-1, 2)
    dx, dy = points[:, 0] - position[0], points[:, 1] - position[1]
    seen = reach + SELECTION_MARGIN + GRID_SPACING
    near = dx * dx + dy * dy <= seen * seen
    return points[near | (distances(cell, points) <= halo + SELECTION_MARGIN + GRID_SPACING)]


def select_peers(
    cell: np.ndarray, position: tuple[float, float], reach: float, halo: float, table: np.ndarray, ground: KnownArena
) -> Selection:
    """The selection among N peers, for a cell and a sensor at `position`, m.

    `table` (N + 1, 6) holds the positions of the peers (`position_table`) and, last, the own one.
    """
    generators = table[:, GENERATOR_X : POWER_RADIUS + 1]
    if len(cell):
        home = cell
    else:
        home, halo = _likeliest_cell(generators, ground.arena), halo + APPEARANCE_MARGIN
    observing = distances(home, table[:-1, SENSOR_X:SENSOR_REACH]) <= halo + SELECTION_MARGIN + table[:-1, SENSOR_REACH]
    points = search_grid(home, position, halo, reach, ground)
    owning, least = owners(points, generators)
    return Selection(observing | owning[:-1], _needed(home, points, least, halo, ground))


def _needed(home: np.ndarray, points: np.ndarray, least: np.ndarray, halo: float, ground: KnownArena) -> Rectangle:
    """The rectangle outside of which no unknown peer can own a point or observe the surroundings of the cell.

    The points (P, 2) have the power distances `least` (P,) m^2. The power distance of an unknown generator is at least its distance
    squared minus the largest radius squared.
    """
    bounds = ground.bounds
    ranges = np.sqrt(np.maximum(least + bounds.radius * bounds.radius, 0.0))[:, None] + (bounds.offset + ground.drift)
    observed = halo + SELECTION_MARGIN + bounds.reach + ground.drift
    low = np.minimum((points - ranges).min(axis=0), home.min(axis=0) - observed)
    high = np.maximum((points + ranges).max(axis=0), home.max(axis=0) + observed)
    return Rectangle(float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def _likeliest_cell(generators: np.ndarray, arena: np.ndarray) -> np.ndarray:
    """The place (1, 2) near the last generator, whose cell is empty, at which it comes closest to owning a point."""
    if len(generators) == 1:
        return generators[:, :2]
    low = np.maximum(arena.min(axis=0), generators[-1, :2] - SEARCH_RADIUS)
    high = np.minimum(arena.max(axis=0), generators[-1, :2] + SEARCH_RADIUS)
    counts = [2 + int(max(high[axis] - low[axis], 0.0) / (2.0 * GRID_SPACING)) for axis in (0, 1)]
    axes = [low[axis] + (high[axis] - low[axis]) / (counts[axis] - 1) * np.arange(counts[axis]) for axis in (0, 1)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    power = squared_distances(generators, points) - (generators[:, 2] ** 2)[:, None]
    return points[(power[-1] - power[:-1].min(axis=0)).argmin()][None, :]
