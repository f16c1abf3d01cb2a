"""`covey bench peers`: our kernels beside what others use, where that is installed: power cells by shapely, the filter of Stone Soup."""

import importlib.util

import numpy as np
import shapely

from agents.backend import PLAIN
from deploy.bench.timing import BenchRow, median_seconds
from deploy.simulation import compiled
from protocol.geometry import rectangle


def generators(count: int, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 2) m and radii (N,) m of a made-up team."""
    rng = np.random.default_rng(1)
    return rng.random((count, 2)) * side, rng.random(count) * 5.0


def by_shapely(points: np.ndarray, radii: np.ndarray, arena: np.ndarray) -> list[shapely.Geometry]:
    """The same cells as intersections of half-planes, each a large rectangle."""
    cells = []
    for index in range(len(points)):
        cell = shapely.Polygon(arena)
        offsets = points - points[index]
        squared = (offsets**2).sum(axis=1)
        for other in np.argsort(squared)[1:]:
            normal = offsets[other] / np.sqrt(squared[other])
            ahead = (squared[other] + radii[index] ** 2 - radii[other] ** 2) / (2.0 * np.sqrt(squared[other]))
            far, across = 1.0e4 * normal, 1.0e4 * np.array([-normal[1], normal[0]])
            edge = points[index] + ahead * normal
            cell = cell.intersection(shapely.Polygon([edge - across, edge + across, edge + across - far, edge - across - far]))
        cells.append(cell)
    return cells


def measure() -> list[BenchRow]:
    """Milliseconds of CPU, and how many times faster ours are."""
    rows: list[BenchRow] = []
    for count, side in ((48, 100.0), (1000, 456.0)):
        points, radii = generators(count, side)
        arena, diagram = rectangle(side, side), np.column_stack([points, radii])
        ours = median_seconds(lambda g=diagram, a=arena: compiled().cut_cells(range(len(g)), g, a))  # type: ignore[misc]
        plain = median_seconds(lambda g=diagram, a=arena: PLAIN.cut_cells(range(len(g)), g, a), batches=1)  # type: ignore[misc]
        row = {"what": f"all {count} power cells", "ours, ms": 1000.0 * ours, "plain numpy, ms": 1000.0 * plain}
        if count <= 48:
            theirs = median_seconds(lambda p=points, r=radii, a=arena: by_shapely(p, r, a), batches=1)  # type: ignore[misc]
            row |= {"theirs, ms": 1000.0 * theirs, "times faster": theirs / ours, "theirs": "shapely"}
        rows.append(row)
    if importlib.util.find_spec("stonesoup") is None:
        return [*rows, {"what": "particle PHD scan, OSPA", "theirs": "Stone Soup is not installed here (pip install stonesoup)"}]
    from deploy.bench import stone_soup

    return [*rows, *stone_soup.measure(compiled())]
