"""Power and Voronoi cells by intersecting half-planes with shapely (15), and who owns a place by comparing power distances."""

import numpy as np
from shapely import Polygon, box


def generators(poses: np.ndarray, cods: np.ndarray, radii: np.ndarray, kind: str) -> np.ndarray:
    """(N, 3): x, y and radius of each agent's generator, m; both Voronoi diagrams are baselines without weights."""
    places = poses[:, :2] if kind == "voronoi" else cods
    return np.column_stack([places, radii if kind == "power" else np.zeros(len(radii))])


def power_cells(diagram: np.ndarray, width: float, height: float) -> list[Polygon]:
    """The cell of each generator (N, 3) in the arena; of equal generators the first has the cell."""
    return [_cell(number, diagram, width, height) for number in range(len(diagram))]


def _cell(number: int, diagram: np.ndarray, width: float, height: float) -> Polygon:
    cell = box(0.0, 0.0, width, height)
    here, radius = diagram[number, :2], diagram[number, 2]
    for other, (x, y, other_radius) in enumerate(diagram):
        apart = np.hypot(x - here[0], y - here[1])
        if other == number:
            continue
        if apart == 0.0:
            if (other_radius, -other) > (radius, -number):
                return Polygon()
            continue
        ahead = (apart**2 + radius**2 - other_radius**2) / (2.0 * apart)
        cell = cell.intersection(_half_plane(here, (np.array([x, y]) - here) / apart, ahead, 4.0 * (width + height) + abs(ahead)))
    return cell


def _half_plane(origin: np.ndarray, normal: np.ndarray, ahead: float, size: float) -> Polygon:
    """What lies less than `ahead` m from the origin along the normal, as a large rectangle."""
    along, middle = np.array([-normal[1], normal[0]]), origin + ahead * normal
    back = size * normal
    return Polygon([middle + size * along, middle + size * along - back, middle - size * along - back, middle - size * along])


def owners(points: np.ndarray, diagram: np.ndarray) -> np.ndarray:
    """Index of the generator that owns each point (N, 2): the least power distance (15), the first of equal ones; (N,)."""
    apart = points[:, None, :2] - diagram[None, :, :2]
    return np.argmin((apart**2).sum(axis=2) - diagram[:, 2] ** 2, axis=1)
