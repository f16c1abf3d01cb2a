"""Checks of a user's own sensor model that need its module: what it sees, at rest and at another pose."""

import math

import numpy as np

from agents.coverage.capacity import sensor_facts
from protocol.sensing import Pose, SensorModel
from protocol.settings import BadSetting

AT_REST: Pose = (0.0, 0.0, 0.0)
ELSEWHERE: Pose = (13.7, -8.2, 2.3)  # far from AT_REST in place and heading, and on no grid
GRID = 80  # points on a side of the square in which both poses are compared
MOST_CHANGED = 0.05  # share of the points in view that may be seen otherwise: those on a border, by rounding
RIGHT = "should depend on places relative to the pose alone (x m, y m, heading rad)"
LEAST_SHARED = 0.8  # of the places in view that lie within the outline, or of those within the outline that are in view
MOST_BEYOND = 1.1  # times the reach at which a corner may lie: a coarse polygon around an arc


def check_sensor(sensor: SensorModel, name: str) -> None:
    """Raise BadSetting for a sensor that sees nothing, or whose answers depend on more than the places relative to its pose."""
    sensor_facts(sensor)
    _check_probability(sensor, name)
    _check_outline(sensor, name)


def _grid(sensor: SensorModel) -> np.ndarray:
    """Places (N, 2), m, all over the square around its reach."""
    side = (np.arange(GRID) + 0.5) * (2.0 * sensor.reach / GRID) - sensor.reach
    return np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)


def _check_probability(sensor: SensorModel, name: str) -> None:
    points = _grid(sensor)
    given = _moved(points)
    before, after = sensor.probability(points.copy(), AT_REST).astype(float), sensor.probability(given, ELSEWHERE).astype(float)
    if not np.array_equal(given, _moved(points)):
        raise BadSetting(f"{name}.probability changed the points that it was given: should leave them as they are")
    seen = (before > 0.0) | (after > 0.0)
    changed = int((seen & (np.abs(after - before) > 1e-6)).sum())
    if changed > MOST_CHANGED * seen.sum():
        share = f"{100.0 * changed / int(seen.sum()):.0f} % of the places in view"
        raise BadSetting(f"{name}.probability at the pose {ELSEWHERE} differs in {share} from that at {AT_REST}: {RIGHT}")


def _check_outline(sensor: SensorModel, name: str) -> None:
    import shapely  # imported only for a user's own class: it takes long

    corners = sensor.footprint(AT_REST)
    farthest = float(np.hypot(corners[:, 0], corners[:, 1]).max())
    if farthest > MOST_BEYOND * sensor.reach:
        raise BadSetting(f"{name}.footprint returned a corner at {farthest:.3g} m: should lie within reach = {sensor.reach:g}")
    points = _grid(sensor)
    seen, inside = sensor.probability(points, AT_REST) > 0.0, shapely.contains_xy(shapely.Polygon(corners), points[:, 0], points[:, 1])
    if (seen & inside).sum() < LEAST_SHARED * min(seen.sum(), inside.sum()):  # the outline has no holes, and may be that of a part
        share = f"{100.0 * (seen & inside).sum() / seen.sum():.0f} % of the places in view lie within it"
        raise BadSetting(f"{name}.footprint is not where its probability is above 0: {share}")
    right, found = shapely.Polygon(_moved(corners)), shapely.Polygon(sensor.footprint(ELSEWHERE))
    if not found.is_valid or right.symmetric_difference(found).area > MOST_CHANGED * right.area:
        raise BadSetting(f"{name}.footprint at the pose {ELSEWHERE} is not that at {AT_REST}, moved and turned: {RIGHT}")


def _moved(points: np.ndarray) -> np.ndarray:
    """Places (N, 2) as seen from AT_REST, where they lie as seen from ELSEWHERE."""
    cos, sin = math.cos(ELSEWHERE[2]), math.sin(ELSEWHERE[2])
    return points @ np.array([[cos, sin], [-sin, cos]]) + ELSEWHERE[:2]
