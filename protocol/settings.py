"""Settings that every process reads, and the one way in which settings are read.

A scenario is a TOML file of sections; each room declares the sections it needs as frozen structs (here, `agents.config`,
`world.config`, `deploy.scenario`). A resolved scenario, `run.toml`, is the same file with the team spelled out.
"""

import difflib
import importlib
import math
import os
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from protocol.fields import LARGEST_NUMBER, Name
from protocol.measuring import MeasurementModel
from protocol.sensing import LEAST_RADIUS, SENSOR_CLASSES, SensorModel, WedgeSensor, measurement_of

Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1.0e9)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=1.0e9)]
# what goes into messages, within their limits: a place in the arena plus the reach of a sensor is a coordinate; in 10 s nothing goes beyond
Length = Annotated[float, msgspec.Meta(gt=0.0, le=LARGEST_NUMBER / 2)]
Rate = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST_NUMBER / 100)]
LARGEST_SEED = 2**63 - 1
Seed = Annotated[int, msgspec.Meta(ge=0, le=LARGEST_SEED)]
Fraction = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


class BadSetting(ValueError):
    """A setting is wrong; the text names the file, the field, the value and what would be right."""

    exit_code = 2  # of a process that it ends


class BadOption(BadSetting):
    """An option of a command is wrong, or the argument of the same name in Python."""

    def __init__(self, option: str, value: object, right: str) -> None:
        super().__init__(option, value, right)
        self.option, self.value, self.right = option, value, right

    def __str__(self) -> str:
        return f"--{self.option} {self.value}: {self.right}"


class Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all sections: frozen, unknown fields refused."""


class RunSettings(Section, frozen=True, kw_only=True):
    """[run] what is run and how time passes; the world's own seed is in `world.config`."""

    name: Name = "covey"
    scenario: str = ""  # the name or path it was made from
    seconds: Positive = 200.0  # of world time
    dt: Annotated[float, msgspec.Meta(ge=0.01, le=10.0)] = 0.25  # world time between ticks, s
    clock: Literal["realtime", "lockstep"] = "realtime"
    rate: Positive = 1.0  # world seconds per wall second, realtime only
    max_rate: NotNegative = 0.0  # lockstep: at most so many world seconds per wall second; 0 = as fast as it goes
    patience: Positive = 5.0  # lockstep: how long a missing peer is waited for, wall s
    start_timeout: Positive = 60.0  # how long the start line waits for the next of the expected agents, once one is there, wall s
    strict: bool = False  # never start without all of them

    @property
    def ticks(self) -> int:
        """Number of ticks of the run."""
        return max(1, round(self.seconds / self.dt))


class ArenaSettings(Section, frozen=True, kw_only=True):
    """[arena] the rectangle from (0, 0) to (width, height), m."""

    width: Length = 100.0
    height: Length = 100.0

    def holds(self, x: Any, y: Any) -> Any:
        """Whether places at x and y, m, lie in the arena, its border included; both are numbers or arrays, and so is the answer."""
        return (x >= 0.0) & (x <= self.width) & (y >= 0.0) & (y <= self.height)


class DetectionSettings(Section, frozen=True, kw_only=True):
    """[detection] what a scan returns for a target in view, and what else."""

    noise: Annotated[float, msgspec.Meta(ge=0.001, le=1000.0)] = 0.25  # standard deviation of a detection per axis, m
    clutter: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 0.1  # expected clutter points per scan, uniform in the footprint


class LimitSettings(Section, frozen=True, kw_only=True):
    """[limits] of every body (paper, section IV)."""

    speed: Rate = 2.0  # m/s
    turn_rate: Rate = 5.0  # rad/s
    radius: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.0  # of every body, m; agents keep bodies apart. 0 = points that may meet


class SensorSettings(Section, frozen=True, kw_only=True):
    """[sensors.X] a sensor class of the user's own: a wedge, or any model as `module:Class`.

    A wedge under a name of Table I is that of the paper but for what is given.
    """

    angle: Annotated[float, msgspec.Meta(ge=1.0e-4, le=360.0)] | None = None  # viewing angle, degrees
    radius: Annotated[float, msgspec.Meta(ge=LEAST_RADIUS, le=LARGEST_NUMBER / 2)] | None = None  # m
    prob_detection: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] | None = None  # at the sensor; else that of the paper, or 1
    prob_detection_far: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] | None = None  # at the radius, linear between; else no fall
    measures: Literal["position", "range-bearing", "bearing"] = "position"  # of a wedge; positions have the noise of [detection]
    range_noise: NotNegative = 0.0  # standard deviation of a range, m; of range-bearing 1e-4 to 1e6
    bearing_noise: Annotated[float, msgspec.Meta(ge=0.0, le=45.0)] = 0.0  # standard deviation of a bearing, degrees; measured: >= 6e-5
    model: str = "wedge"
    parameters: dict[str, Any] = {}

    def build(self, paper: WedgeSensor | None = None) -> SensorModel:
        """The sensor; `paper`: the sensor of this name in the paper, if any. Raises ValueError naming the mistake."""
        if self.model == "wedge":
            if paper is None:
                if self.angle is None or self.radius is None:
                    raise ValueError("a wedge needs an angle (degrees) and a radius (m)")
                paper = WedgeSensor(math.radians(self.angle), self.radius, 1.0)
            angle = paper.angle if self.angle is None else math.radians(self.angle)
            radius = paper.radius if self.radius is None else self.radius
            prob_detection = paper.prob_detection if self.prob_detection is None else self.prob_detection
            return WedgeSensor(angle, radius, prob_detection, self._measurement(), self.prob_detection_far)
        from protocol.user_classes import CheckedSensor, as_bad_setting, build, probe  # which imports this file

        sensor = build(self.model, "Class(**parameters)", (), parameters=self.parameters)
        if self.measures != "position":
            raise ValueError(f"measures = {self.measures!r}: should be 'position' for a sensor of one's own; a wedge has others")
        with as_bad_setting(self.model):
            missing = [part for part in ("reach", "area", "probability", "footprint") if not hasattr(sensor, part)]
        if missing:
            raise ValueError(f"{self.model} lacks {', '.join(missing)} of protocol.sensing.SensorModel")
        if type(sensor) is WedgeSensor:  # a class that derives from it may answer otherwise, and the compiled loops would not ask it
            return sensor
        if measurement_of(sensor):
            raise ValueError(f"{self.model}.measures: should be None in a class that derives from WedgeSensor: it measures positions")
        checked = CheckedSensor(sensor, self.model)
        probe(checked, self.model)
        return checked

    def _measurement(self) -> MeasurementModel | None:
        """What a wedge measures; raises ValueError naming the noise that is missing or superfluous."""
        if self.measures == "position":
            if self.range_noise or self.bearing_noise:
                raise ValueError("range_noise, bearing_noise: a sensor of positions has the noise of [detection]")
            return None
        return MeasurementModel(self.measures, math.radians(self.bearing_noise), self.range_noise)


class NetworkSettings(Section, frozen=True, kw_only=True):
    """[network] the Zenoh session."""

    mode: Literal["peer", "client", "router"] = "peer"  # peer: everybody is linked to everybody; client: to a router, which passes all on
    listen: tuple[str, ...] = ("tcp/127.0.0.1:0",)
    seeds: tuple[str, ...] = ()  # endpoints to dial
    lease: Positive = 5.0  # s without a byte until a link counts as lost; longer than a machine or a slow link stands still
    most_per_second: Annotated[int, msgspec.Meta(ge=1)] = 1000  # messages of one session under one key; more is a flood. In lockstep 5000
    insecure: bool = False  # allow endpoints beyond loopback without TLS
    ca: str = ""  # mutual TLS: the file of the authority that all trust; here and in the next two {name} stands for the process's name
    certificate: str = ""
    key: str = ""
    admit: tuple[Name, ...] = ()  # agents whose certificates count; none: the members
    link_faults: bool = False  # let the supervisor cut and spoil the links between agents

    @property
    def encrypted(self) -> bool:
        """Whether mutual TLS is asked for."""
        return bool(self.ca or self.certificate or self.key)

    def files(self, name: str) -> dict[str, str]:
        """The files of mutual TLS by field, for the owner of that common name."""
        return {field: getattr(self, field).replace("{name}", name) for field in ("ca", "certificate", "key")}


class CommonSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The sections that every process of a run needs."""

    run: RunSettings = RunSettings()
    arena: ArenaSettings = ArenaSettings()
    detection: DetectionSettings = DetectionSettings()
    limits: LimitSettings = LimitSettings()
    network: NetworkSettings = NetworkSettings()
    sensors: dict[str, SensorSettings] = {}
    members: dict[Name, str] = {}  # agent name -> sensor class, in team order

    @property
    def shared_seed(self) -> int:
        """The seed of the random streams of this process: of agents the one that all share."""
        return 0


def load_named(name: str) -> Any:
    """The object that `module:Name` names; raises ValueError or ImportError naming the mistake."""
    module, colon, attribute = name.partition(":")
    if not colon or not module or not attribute or module.startswith("."):
        raise ValueError(f"{name!r} should read module:Name")
    if module.endswith(".py"):
        raise ValueError(f"{name!r}: should be the name of a module, without .py: {module.removesuffix('.py')}:{attribute}")
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError as error:
        where = f"{error}: it should lie in {os.getcwd()} or in a folder of PYTHONPATH" if error.name == module else str(error)
        raise ValueError(where) from error
    except ImportError:
        raise
    except (Exception, SystemExit) as error:  # any error that the import of a user's module raises
        where = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise ValueError(
            f"module {module} cannot be imported: {type(error).__name__}: {error.args[0] if error.args else ''}{where}"
        ) from error
    if not hasattr(found, attribute):
        alike = difflib.get_close_matches(attribute, dir(found), 1)
        raise ValueError(f"module {module} has no {attribute}; " + (f"did you mean {alike[0]}?" if alike else f"it is {found}"))
    return getattr(found, attribute)


_BUILT: dict[int, tuple[SensorSettings, SensorModel | ValueError]] = {}  # settings by their id -> settings, and model or what is wrong
_MOST_BUILT = 256


def sensor_of(settings: CommonSettings, sensor_class: str) -> SensorModel:
    """The sensor model of a class: the scenario's own, or one of Table I; raises BadSetting naming the class."""
    own = settings.sensors.get(sensor_class)
    if own is None and sensor_class in SENSOR_CLASSES:
        return SENSOR_CLASSES[sensor_class]
    known = list(dict.fromkeys([*settings.sensors, *SENSOR_CLASSES]))
    if own is None:
        raise BadSetting(f"sensor class {sensor_class!r} does not exist; known are {', '.join(known)}")
    known_as, built = _BUILT.get(id(own), (None, None))
    if known_as is not own or built is None:
        if len(_BUILT) >= _MOST_BUILT:
            _BUILT.clear()
        try:
            built = own.build(SENSOR_CLASSES.get(sensor_class))
        except ValueError as error:  # is kept too: each Hello of such a class would build it anew
            built = error
        _BUILT[id(own)] = own, built
    if isinstance(built, ValueError):
        raise BadSetting(f"sensors.{sensor_class}: {built}") from built.__cause__
    return built


T = TypeVar("T")


def read_toml(path: Path) -> dict[str, Any]:
    """The contents of a TOML file; raises BadSetting naming the file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise BadSetting(f"{path}: there is no such file") from None
    except OSError as error:
        raise BadSetting(f"{path}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadSetting(f"{path}: not a TOML file: {error}") from None


def convert(data: dict[str, Any], into: type[T], source: str) -> T:
    """`data` as the struct `into`; raises BadSetting naming source, field, value and what would be right."""
    try:
        return msgspec.convert(data, into)
    except msgspec.ValidationError as error:
        raise BadSetting(f"{source}: {explain(str(error), data, into)}") from None
    except ValueError as error:
        raise BadSetting(f"{source}: {error}") from None


def load(path: Path, into: type[T]) -> T:
    """The sections of a TOML file that `into` declares."""
    return convert(read_toml(path), into, str(path))


def explain(text: str, data: Any, into: Any) -> str:
    """A msgspec complaint in the words of the file: `section.field = value: what would be right`."""
    complaint, _, where = text.partition(" - at ")
    path, value, hint = locate(data, into, where)
    unknown = re.search(r"unknown field `(.*)`", complaint)
    if unknown:
        fields = list(getattr(hint, "__struct_encode_fields__", ()))
        close = difflib.get_close_matches(unknown[1], fields, n=1)
        hint = f"did you mean {close[0]}?" if close else f"known are {', '.join(fields)}"
        return f"{field_path([*path, unknown[1]])}: there is no such field; {hint}"
    missing = re.search(r"missing required field `(.*)`", complaint)
    if missing:
        return f"{field_path(path)} = {value!r}: the field {missing[1]} is missing"
    return f"{field_path(path)} = {value!r}: {_expectation(complaint, hint)}"


def field_path(path: Sequence[str | int]) -> str:
    """A place in a file in words: `faults[0].at`, where lists count from 0."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).removeprefix(".")


PLAIN_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}


def _expectation(complaint: str, hint: Any) -> str:
    """What would be right, from a msgspec complaint and the type that it is about."""
    if get_origin(hint) is Literal:
        return f"should be one of {', '.join(str(choice) for choice in get_args(hint))}"
    if "matching regex" in complaint:
        return "should be 1 to 64 letters, digits, or any of _ . -"
    words = re.sub(r"`(\w+)(?: \| null)?`", lambda match: PLAIN_WORDS.get(match[1], match[1]), complaint)
    return words.replace("Expected", "should be", 1)


def locate(data: Any, into: Any, where: str) -> tuple[list[str | int], Any, Any]:
    """Names and numbers, value and type along a msgspec path such as `$.faults[0].at`; `[...]`, some key, is looked up by trying."""
    path: list[str | int] = []
    value, hint = data, into
    for step in re.findall(r"\.\.\.|[^.\[\]`$]+", where.removeprefix("`key` in ")):
        if step == "...":
            step = next((key for key, item in value.items() if not fits(item, get_args(hint)[-1])), step)
        path.append(int(step) if isinstance(value, list | tuple) else step)
        value = value[int(step)] if isinstance(value, list | tuple) else value.get(step)
        hint = part_of(hint, step)
    if where.startswith("`key`"):
        value = next((key for key in value if not fits(key, get_args(hint)[0])), value)
    return path, value, hint


def part_of(hint: Any, step: str) -> Any:
    """The type of the part `step` of a struct, table or list."""
    arguments = get_args(hint)
    if hasattr(hint, "__struct_fields__"):
        inner = get_type_hints(hint, include_extras=True)[step]
    elif get_origin(hint) is dict:
        inner = arguments[1]
    else:
        inner = arguments[0] if arguments[-1] is ... else arguments[int(step)]
    return get_args(inner)[0] if get_origin(inner) is Annotated else inner


def fits(value: Any, hint: Any) -> bool:
    """Whether a value is right for a type."""
    try:
        msgspec.convert(value, hint)
    except (msgspec.ValidationError, ValueError):
        return False
    return True
