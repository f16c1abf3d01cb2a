"""Checks of the user's own classes, which a scenario names as `module:Class`.

Every returned value is checked. A wrong value raises a `BadSetting` that names the class, the value and the right form. An exception
inside the class raises a `BadSetting` with the exception as its cause.
"""

import inspect
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from protocol.sensing import Pose, SensorModel
from protocol.settings import BadSetting, load_named

AT_REST: Pose = (0.0, 0.0, 0.0)
GRID = 200  # points on a side of the square in which a sensor is sampled
AREA_FACTOR = 1.5  # times that an area may differ from the sampled one, whose border is as coarse as the grid
MOST = 1e13  # m or m^2 of a reach or an area
LEAST_SEEN = 100  # points of the grid with a probability above 0 from which on the sampled area says something
ROOMS = Path(__file__).resolve().parents[1]
NOT_THE_USERS = (  # where code lies that is not the user's: its lines explain no error of a class, and no study keeps its files
    *(str(ROOMS / room) + "/" for room in ("protocol", "agents", "world", "deploy")),
    str(Path(traceback.__file__).parent) + "/",  # the standard library, and installed packages
    str(Path(np.__file__).parents[1]) + "/",
    "<frozen",
)


@contextmanager
def as_bad_setting(what: str) -> Iterator[None]:
    """Turn an exception inside the context into a BadSetting that names `what`, and the last line of the user's that led to it."""
    try:
        yield
    except BadSetting:
        raise
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        places = [
            f" ({Path(frame.filename).name}, line {frame.lineno})"
            for frame in frames
            if not frame.filename.startswith(NOT_THE_USERS) and not frame.filename.endswith(".pyx")  # Cython's names have no folder
        ]
        raise BadSetting(f"{what} raised {type(error).__name__}: {' '.join(str(error).split())}{''.join(places[-1:])}") from error


def build(
    name: str, built_as: str, methods: tuple[str, ...], *arguments: object, parameters: Mapping[str, Any] = MappingProxyType({})
) -> Any:
    """An object of the user's class `module:Class`; raises ValueError naming the class and what is wrong. `built_as`: how, in words."""
    kind = class_of(name, built_as, *arguments, parameters=parameters)
    with as_bad_setting(name):
        built = kind(*arguments, **parameters)
    missing = [method for method in methods if not callable(getattr(built, method, None))]
    if missing:
        raise BadSetting(f"{name}: the class has no method {', '.join(missing)}")
    _refuse_async(built, methods, name)
    return built


def class_of(name: str, built_as: str, *arguments: object, parameters: Mapping[str, Any] = MappingProxyType({})) -> Callable[..., Any]:
    """The user's class, not built yet, which takes these arguments; raises ValueError as `build` does."""
    try:
        kind: Callable[..., Any] = load_named(name)
    except ImportError as error:
        raise BadSetting(str(error)) from error
    if not callable(kind):
        raise BadSetting(
            f"{name} is {'a' if inspect.ismodule(kind) else 'an object of the class'} {type(kind).__name__}: should be a class"
        )
    taken = _taken_by(kind)
    try:
        taken.bind(*arguments, **parameters)
    except TypeError as error:
        wrong = f"{name}: {error}; it takes {', '.join(taken.parameters) or 'nothing'}, and is built as {built_as}"
        raise BadSetting(wrong if inspect.isclass(kind) else f"{wrong}: should be a class") from None
    return kind


def _refuse_async(built: object, methods: tuple[str, ...], name: str) -> None:
    for method in methods:
        if inspect.iscoroutinefunction(getattr(built, method, None)):
            raise BadSetting(f"{name}.{method} is async: should be a method without async")


def _taken_by(kind: Callable[..., Any]) -> inspect.Signature:
    """What a class takes; anything where it does not say, as one that is not written in Python."""
    try:
        return inspect.signature(kind)
    except ValueError:
        return inspect.signature(lambda *arguments, **parameters: None)


def is_number(value: Any) -> bool:
    """Whether a value is one real number, of Python or of numpy; truth values and texts are none."""
    found = np.asarray(value)
    return found.ndim == 0 and found.dtype.kind in "fiu"


def real_array(what: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """The value, an array of finite real numbers of this shape (-1: any length); raises BadSetting for anything else."""
    right = f"should be an array of shape {shape} of finite real numbers".replace("-1", "N")
    if not isinstance(value, np.ndarray):
        raise BadSetting(f"{what} returned {shown(value)}: {right}")
    fits = len(value.shape) == len(shape) and all(length in (-1, found) for length, found in zip(shape, value.shape))
    if not fits or value.dtype.kind not in "fiub":
        raise BadSetting(f"{what} returned an array of shape {value.shape} and type {value.dtype}: {right}")
    if not np.isfinite(value).all():
        raise BadSetting(f"{what} returned an array with {value[~np.isfinite(value)][0]} in it: {right}")
    return value


def shown(value: Any) -> str:
    """A value in a few characters."""
    text = " ".join(repr(value).split())
    return f"{text[:40]}... ({type(value).__name__})" if len(text) > 40 else text


class CheckedSensor:
    """A sensor model of the user's own, with checked answers; other attributes are passed through."""

    def __init__(self, sensor: SensorModel, name: str) -> None:
        _refuse_async(sensor, ("probability", "footprint"), name)
        self._sensor, self._name = sensor, name

    def __getattr__(self, part: str) -> Any:
        if part.startswith("_"):
            raise AttributeError(part)
        return getattr(self._sensor, part)

    def __str__(self) -> str:
        return self._name

    @property
    def reach(self) -> float:
        return self._positive("reach")

    @property
    def area(self) -> float:
        return self._positive("area")

    def _positive(self, part: str) -> float:
        with as_bad_setting(f"{self._name}.{part}"):
            value = getattr(self._sensor, part)
        if not is_number(value) or not 0.0 < value <= MOST:
            raise BadSetting(f"{self._name}.{part} = {shown(value)}: should be a number > 0 and at most {MOST:g}")
        return float(value)

    def probability(self, points: np.ndarray, pose: Pose) -> np.ndarray:
        """p_d of points (N, 2): (N,), each from 0 to 1."""
        what = f"{self._name}.probability of {len(points)} points"
        with as_bad_setting(what):
            value = self._sensor.probability(points, pose)
        found = real_array(what, value, (len(points),))
        if len(found) and not (found.min() >= 0.0 and found.max() <= 1.0):
            wrong = found[(found < 0.0) | (found > 1.0)][0]
            raise BadSetting(f"{what} returned an array with {wrong} in it: should be from 0 to 1")
        return found

    def footprint(self, pose: Pose) -> np.ndarray:
        """The outline (V, 2) with at least three corners."""
        what = f"{self._name}.footprint"
        with as_bad_setting(what):
            value = self._sensor.footprint(pose)
        found = real_array(what, value, (-1, 2))
        if len(found) < 3:
            raise BadSetting(f"{what} returned {len(found)} corners: a polygon has at least 3")
        return found


def probe(sensor: CheckedSensor, name: str) -> None:
    """Call every member of a sensor once; raises BadSetting for a wrong answer."""
    import shapely  # imported only for a user's own class: it takes long

    reach = sensor.reach
    for points in (np.array([[0.5 * reach, 0.0], [0.0, 0.25 * reach], [2.0 * reach, 2.0 * reach]]), np.empty((0, 2))):
        sensor.probability(points, AT_REST)
    corners = sensor.footprint(AT_REST)
    outline = shapely.Polygon(corners)
    if not outline.is_valid or not outline.area > 0.0:
        why = shapely.is_valid_reason(outline).partition("[")[0] if not outline.is_valid else "no area"
        raise BadSetting(f"{name}.footprint returned no polygon: {why.strip()}; should be the corners of one in order")
    if not shapely.LinearRing(corners).is_ccw:
        raise BadSetting(f"{name}.footprint returned corners that run clockwise: should be counter-clockwise")
    _sample(sensor, name)


def _sample(sensor: CheckedSensor, name: str) -> None:
    """Ask a sensor for its probability on a grid; raises BadSetting where reach or area say something else."""
    reach, area, step = sensor.reach, sensor.area, 3.0 * sensor.reach / GRID
    side = (np.arange(GRID) + 0.5) * step - 1.5 * reach
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    found, far = sensor.probability(points, AT_REST), np.sqrt((points * points).sum(axis=1))
    beyond = np.flatnonzero((found > 0.0) & (far > reach * (1.0 + 1e-9)))
    if len(beyond):
        worst = beyond[np.argmax(found[beyond])]
        raise BadSetting(f"{name}.probability is {found[worst]:.2g} at {far[worst]:.3g} m: should be 0 beyond reach = {reach:g}")
    seen = int((found > 0.0).sum())
    if seen >= LEAST_SEEN and not 1.0 / AREA_FACTOR <= area / (seen * step * step) <= AREA_FACTOR:
        raise BadSetting(f"{name}.area = {area:g}: should be {seen * step * step:.3g} m^2, where its probability is above 0")
