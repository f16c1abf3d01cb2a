"""Sensor models of other shapes than the paper's wedges: one given by a formula, one sampled from data.

A model is any class with `reach`, `area`, `probability` and `footprint` (protocol.sensing.SensorModel). D, the centroid of detection
and U need nothing else: they come by quadrature. Scenario `anisotropic` uses both.
"""

import csv
import math
from pathlib import Path

import numpy as np
import shapely

from covey import Pose, elementwise

DATA = Path(__file__).parent


def _check(name: str, value: object, most: float, right: str) -> None:
    """Raise ValueError naming a parameter that is no number above 0, or above `most`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= most:
        raise ValueError(f"{name} = {value!r}: should be a number above 0{'' if right == 'm' else ' and'} {right}")


class RangeFalling:
    """A wedge of `angle` degrees whose detection probability falls with the range as peak exp(-(range / scale)^2), up to `radius` m."""

    def __init__(self, angle: float, radius: float, scale: float, peak: float = 1.0) -> None:
        _check("angle", angle, 360.0, "at most 360 degrees")
        _check("radius", radius, math.inf, "m")
        _check("scale", scale, math.inf, "m")
        _check("peak", peak, 1.0, "at most 1")
        self._angle, self._scale, self._peak = math.radians(angle), scale, peak
        self.reach = radius
        self.area = self._angle * radius**2 / 2.0

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        """p_d of points (N, 2): (N,)."""
        dx, dy = points[:, 0] - pose[0], points[:, 1] - pose[1]
        range2 = dx * dx + dy * dy
        ahead = dx * math.cos(pose[2]) + dy * math.sin(pose[2])
        cosine = math.cos(self._angle / 2.0) if self._angle < 2.0 * math.pi else -2.0
        inside = (range2 <= self.reach**2) & (ahead >= cosine * np.sqrt(range2))
        return np.where(inside, self._peak * elementwise(math.exp, -range2 / self._scale**2), 0.0)

    def footprint(self, pose: Pose) -> np.ndarray:
        """The outline (V, 2), an arc point about every 5 degrees."""
        bearings = pose[2] + np.linspace(-0.5, 0.5, max(3, math.ceil(math.degrees(self._angle) / 5.0) + 1)) * self._angle
        arc = np.column_stack(
            [pose[0] + self.reach * elementwise(math.cos, bearings), pose[1] + self.reach * elementwise(math.sin, bearings)]
        )
        return arc[:-1] if self._angle >= 2.0 * math.pi else np.vstack([[pose[:2]], arc])


class SampledGrid:
    """Detection probabilities measured on a grid around the sensor: a CSV file of rows from left to right as the sensor looks.

    The first row lies farthest ahead, a cell is `spacing` m wide, the sensor stands in the middle of the grid. A relative `file` is
    sought in the current directory and then beside this module.
    """

    def __init__(self, file: str, spacing: float) -> None:
        _check("spacing", spacing, math.inf, "m")
        if not isinstance(file, str):
            raise ValueError(f"file = {file!r}: should be the name of a CSV file")
        path = Path(file) if Path(file).exists() else DATA / file
        try:
            with path.open(newline="", encoding="utf-8-sig") as lines:
                rows = [[float(cell) for cell in row] for row in csv.reader(lines) if row]
        except OSError as error:
            raise ValueError(f"file = {file!r}: {error.strerror}; it should lie in {Path.cwd()} or {DATA}") from None
        except ValueError as error:
            raise ValueError(f"file = {file!r}: {error}; should hold numbers with commas between them") from None
        if not rows or len({len(row) for row in rows}) != 1:
            raise ValueError(f"file = {file!r}: should hold rows of equal length")
        self._spacing = spacing
        self._grid = np.array(rows)[::-1, ::-1]  # now rows go ahead and columns to the left, along the sensor's own axes
        wrong = self._grid[~((self._grid >= 0.0) & (self._grid <= 1.0))]
        if len(wrong) or not self._grid.any():
            found = f"holds {wrong[0]:g}" if len(wrong) else "holds 0 alone"
            raise ValueError(f"file = {file!r}: {found}; probabilities should lie from 0 to 1 and not all be 0")
        self._cells = [(int(row), int(column)) for row, column in zip(*np.nonzero(self._grid))]
        self.area = len(self._cells) * spacing**2
        self.reach = max(math.hypot(x, y) for cell in self._cells for x, y in self._corners(*cell)) * (1.0 + 1e-9)

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        """p_d of points (N, 2), that of the cell in which each lies: (N,)."""
        dx, dy = points[:, 0] - pose[0], points[:, 1] - pose[1]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        rows = np.floor((dx * cos + dy * sin) / self._spacing + self._grid.shape[0] / 2.0)
        columns = np.floor((dy * cos - dx * sin) / self._spacing + self._grid.shape[1] / 2.0)
        inside = (rows >= 0) & (rows < self._grid.shape[0]) & (columns >= 0) & (columns < self._grid.shape[1])
        found: np.ndarray = np.where(
            inside, self._grid[np.where(inside, rows, 0).astype(int), np.where(inside, columns, 0).astype(int)], 0.0
        )
        return found

    def footprint(self, pose: Pose) -> np.ndarray:
        """The outline (V, 2) of the largest connected part of the cells that see anything."""
        union = shapely.union_all([shapely.Polygon(self._corners(*cell)) for cell in self._cells])
        largest = max(getattr(union, "geoms", [union]), key=lambda part: part.area)
        x, y = np.array(shapely.get_coordinates(largest.exterior)).T[:, :-1]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        outline = np.column_stack([pose[0] + x * cos - y * sin, pose[1] + x * sin + y * cos])
        return outline if largest.exterior.is_ccw else outline[::-1]

    def _corners(self, row: int, column: int) -> list[tuple[float, float]]:
        """The corners of a cell in the sensor's own frame, m."""
        ahead = (row - self._grid.shape[0] / 2.0) * self._spacing
        left = (column - self._grid.shape[1] / 2.0) * self._spacing
        far, wide = ahead + self._spacing, left + self._spacing
        return [(ahead, left), (far, left), (far, wide), (ahead, wide)]
