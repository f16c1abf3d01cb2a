"""Scores of one tick and their means over a run: error, its parts, and coverage."""

import csv
import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import shapely

from deploy.scenario import Scenario, has_targets
from protocol.geometry import total_area
from protocol.observer_messages import Truth
from protocol.sensing import SensorModel
from protocol.settings import sensor_of
from protocol.whole_file import whole_file

SNAP = 1e-9  # m
LATTICE = 50  # points per axis on which coverage is read
COVERAGE_EVERY = 10  # ticks between two readings of the coverage
END = 5.0  # s: the last moments of a run


@dataclass(frozen=True, slots=True)
class Score:
    """One tick. Lengths in m, areas as shares of the arena."""

    tick: int
    time: float
    ospa: float
    gospa: float
    targets: int
    in_view: int
    estimated: int  # targets that the agents report
    mass: float  # sum over the agents, expected targets
    hole: float
    overlap: float
    localisation: float = 0.0  # the parts of GOSPA
    missed: float = 0.0
    false: float = 0.0
    coverage: float = 0.0  # share of the arena inside some footprint, read every `COVERAGE_EVERY` ticks


COLUMNS = Score.__dataclass_fields__.keys()


def write_scores(path: Path, scores: Sequence[Score]) -> None:
    """The scores as CSV, one tick a line, every digit."""
    with whole_file(path) as new, new.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows([getattr(score, column) for column in COLUMNS] for score in scores)


def read_scores(path: Path) -> list[Score]:
    """The scores of such a file."""
    with path.open(newline="", encoding="utf-8") as file:
        return msgspec.convert(list(csv.DictReader(file)), list[Score], strict=False)


NO_SCORE = Score(-1, 0.0, 0.0, 0.0, 0, 0, 0, 0.0, 1.0, 0.0)


class Coverage:
    """Share of the arena inside the footprint of some living member's body, on a lattice."""

    def __init__(self, scenario: Scenario) -> None:
        ticks = (np.arange(LATTICE) + 0.5) / LATTICE
        east, north = ticks * scenario.arena.width, ticks * scenario.arena.height
        self._points = np.stack(np.meshgrid(east, north), axis=-1)
        self._east, self._north = east.tolist(), north.tolist()
        self._scenario = scenario
        self._sensors: dict[str, SensorModel] = {}
        self._last = (-1, 0.0)  # period, share

    def share(self, truth: Truth) -> float:
        """The newest reading at the tick of a truth."""
        period = truth.tick // COVERAGE_EVERY
        if period != self._last[0]:
            self._last = period, self._read(truth)
        return self._last[1]

    def _read(self, truth: Truth) -> float:
        alive = set(truth.alive)
        present = [(name, pose) for name, pose in zip(truth.bodies, truth.poses.tolist()) if name in alive]
        present = [(name, pose) for name, pose in present if name in self._scenario.members]
        covered = np.zeros((LATTICE, LATTICE), dtype=bool)
        for name, (x, y, heading) in present:
            sensor = self._sensor(name)
            rows, columns = _between(self._north, y, sensor.reach), _between(self._east, x, sensor.reach)
            points = self._points[rows, columns]
            inside = sensor.probability(points.reshape(-1, 2), (x, y, heading)) > 0.0
            covered[rows, columns] |= inside.reshape(points.shape[:2])
        return float(covered.mean())

    def _sensor(self, name: str) -> SensorModel:
        if name not in self._sensors:
            self._sensors[name] = sensor_of(self._scenario, self._scenario.members[name])
        return self._sensors[name]


def _between(axis: list[float], middle: float, width: float) -> slice:
    """Where ascending numbers are no farther than `width` from one, and none is left out by rounding."""
    wide = 1.001 * width
    return slice(bisect_left(axis, middle - wide), bisect_right(axis, middle + wide))


def steady_part(scores: Sequence[Score], scenario: Scenario) -> Sequence[Score]:
    """The scores of the last `study.steady_share` of the run, its last tick at least; all of them where it ended before."""
    start = round((1.0 - scenario.study.steady_share) * scenario.run.ticks, 9)  # 1 - 0.7 is a little more than 0.3
    return [score for score in scores if score.tick >= min(start, scenario.run.ticks - 1)] or scores


def mean(values: Sequence[float]) -> float:
    """The mean, 0 of nothing."""
    return math.fsum(values) / len(values) if values else 0.0


def share_in_view(scores: Sequence[Score]) -> float:
    """Share of target-time inside some field of view."""
    return sum(score.in_view for score in scores) / max(1, sum(score.targets for score in scores))


def figures(scores: Sequence[Score], scenario: Scenario) -> dict[str, Any]:
    """The fields of a `Result` that follow from the scores of a run: means over all of it and its steady part, and its last tick."""
    steady, last = steady_part(scores, scenario), scores[-1] if scores else NO_SCORE
    newest = [score for score in scores if score.time > last.time - END]
    return {
        "ticks": len(scores),
        "mean_ospa": mean([score.ospa for score in scores]),
        "steady_ospa": mean([score.ospa for score in steady]),
        "final_ospa": last.ospa,
        "mean_gospa": mean([score.gospa for score in scores]),
        "steady_gospa": mean([score.gospa for score in steady]),
        "final_gospa": last.gospa,
        "cardinality_error": mean([abs(score.mass - score.targets) for score in steady]),
        "share_in_view": share_in_view(scores),
        "targets": last.targets,
        "targets_in_view": last.in_view,
        "hole_area": max((score.hole for score in scores), default=0.0),
        "overlap_area": max((score.overlap for score in scores), default=0.0),
        "steady_localisation": mean([score.localisation for score in steady]),
        "steady_missed": mean([score.missed for score in steady]),
        "steady_false": mean([score.false for score in steady]),
        "steady_targets": mean([score.targets for score in steady]),
        "steady_estimated": mean([score.estimated for score in steady]),
        "steady_mass": mean([score.mass for score in steady]),
        "steady_coverage": mean([score.coverage for score in steady]),
        "end_in_view": share_in_view(newest),
        "has_targets": has_targets(scenario),
    }


def ground(cell: np.ndarray) -> shapely.Geometry:
    """The ground that a published cell (V, 2) m covers.

    Anybody may state one that crosses itself or has no area, which counts as its convex hull: cells are convex. Thousands of corners may
    cross each other millions of times, so the crossings are not computed.
    """
    polygon = shapely.Polygon(cell if len(cell) >= 3 else None)
    return polygon if polygon.is_valid else polygon.convex_hull


def hole_and_overlap(cells: list[np.ndarray], area: float, *, one_view: bool = False) -> tuple[float, float]:
    """(hole, overlap) as shares of the arena: area - |union|, and the sum of the cells - |union|.

    Cells of one diagram (`one_view`) cannot overlap, so if their areas add up to the arena they tile it.

    The union is cut out: cells may add up to the arena and still leave a hole as large as an overlap. It is cut on a grid of SNAP,
    because without one a border that two cells give with rounding errors can make the geometry engine swallow a whole cell.
    """
    total = total_area(cells)
    if one_view and abs(total - area) <= 1e-9 * area:
        return 0.0, 0.0
    union = shapely.union_all([ground(cell) for cell in cells], grid_size=SNAP).area
    return max(0.0, 1.0 - union / area), max(0.0, (total - union) / area)
