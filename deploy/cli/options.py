"""Options that all commands that run a scenario share. Every command loads this file, so it imports little."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter, Token

from deploy.cli import completion

if TYPE_CHECKING:
    from deploy.scenario import FaultSettings, Scenario

FLAG = Parameter(negative="")


def whole(kind: object, tokens: Sequence[Token]) -> int:
    """A whole number; 1.5 is none, and is not rounded."""
    try:
        return int(tokens[-1].value)
    except ValueError:
        raise ValueError(f"{tokens[-1].value} is no whole number") from None


WHOLE = Parameter(converter=whole)


@dataclass(frozen=True)
class DisplayOptions:
    """How a run with processes is shown and kept."""

    json: bool = False  # the result as one JSON object on the last line
    record: bool | Path = False
    page: bool | str = False
    open: bool = False  # the page in a browser
    stays: bool = False  # the page stays after the end when a person uses the terminal
    beside: "Scenario | None" = None  # what the page shows beside the run, simulated


@dataclass
class RunOptions:
    """Laid over the scenario file. An option that is not given leaves the file's value."""

    seed: Annotated[int | None, WHOLE] = None
    """Seed of the run: the same scenario and seed, the same run."""
    team: str | None = None
    """A team of the paper (1-8), or a composition such as 20E+4H or A4,B12."""
    triple: str | None = None
    """The three sensor classes of teams 2 to 5."""
    targets: Annotated[int | None, WHOLE] = None
    """Number of targets at the start."""
    data: Path | None = None
    """The files of a recorded world: a file, or the folder of mrclam."""
    partition: Literal["power", "voronoi", "voronoi-cod"] | None = None
    capacity: Literal["literal", "expected", "static", "saturating"] | None = None
    control: str | None = None
    """lloyd, static, random, uniform-density, pursuit, search-and-track, or module:Class; in a simulation also oracle."""
    dt: float | None = None
    """World time between two ticks, s."""
    seconds: float | None = None
    """World time of the run, s."""
    kill: Annotated[list[str], FLAG] = field(default_factory=list)
    """Kill agents at a world time: 30%@300, 4@100, s3@50 or s3,s4@50. May be repeated."""
    loss: float | None = None
    """Lose this share (0 to 1) of the messages between agents from the start."""
    delay: float | None = None
    """Deliver the messages between agents this many seconds late."""
    settings: Annotated[list[str], Parameter(name="--set", negative="", completer=completion.settings)] = field(default_factory=list)
    """Any setting of the scenario: section.key=value. May be repeated."""
    run: str | None = None
    """Name of the run, and of its directory under ./runs (or COVEY_RUNS); default: <date>-<scenario>-<n>."""
    bodies: Literal["world", "own"] | None = None
    """Who runs the bodies: one world process, or every body its own."""
    lockstep: Annotated[bool, FLAG] = False
    """As fast as it goes: the world waits for every live agent."""
    rate: float | Literal["auto"] | None = None
    """Real time, so many world seconds per second; auto: at most real time, and slower where the agents need it."""
    spawn: Literal["zygote", "exec"] = "zygote"
    """How agent processes start: forked from a prepared process, or each executed anew. Of demo and up only."""
    strict: Annotated[bool, FLAG] = False
    """Never start with fewer agents than the scenario has: an agent that dies before the first tick ends the run."""
    insecure: Annotated[bool, FLAG] = False
    """Allow endpoints beyond this machine without TLS."""
    keys: Path | None = None
    """Mutual TLS with the certificates in this folder; `covey keys` makes them."""
    json: Annotated[bool, FLAG] = False
    """The last line of standard output is the result as one JSON object."""

    def overrides(self) -> dict[str, Any]:
        """The options as dotted settings."""
        from deploy.scenario import parse_set

        named = {
            "run.seed": self.seed,
            "team.composition": self.team,
            "team.triple": self.triple,
            "targets.count": self.targets,
            "recorded.data": str(self.data.absolute()) if self.data else None,
            "partition.kind": self.partition,
            "capacity.mode": self.capacity,
            "control.mode": self.control,
            "run.dt": self.dt,
            "run.seconds": self.seconds,
            "run.name": self.run,
            "bodies.host": self.bodies,
            **self._clock(),
            "run.strict": self.strict or None,
            "network.insecure": self.insecure or None,
            **self._certificates(),
            "network.link_faults": True if self.loss is not None or self.delay is not None else None,
        }
        given = {dotted: value for dotted, value in named.items() if value is not None}
        return {**given, **dict(parse_set(text) for text in self.settings)}

    def _clock(self) -> dict[str, str | float | None]:
        """How time passes. A world that waits for its agents, but is no faster than real time, slows down to what they can do."""
        if self.rate == "auto":
            return {"run.clock": "lockstep", "run.max_rate": 1.0}
        return {"run.rate": self.rate, "run.clock": "lockstep" if self.lockstep else "realtime" if self.rate is not None else None}

    def _certificates(self) -> dict[str, str | None]:
        """Where `covey keys` has put them."""
        files = {"ca": "ca.pem", "certificate": "{name}.pem", "key": "{name}.key"}
        return {f"network.{field}": str(self.keys.absolute() / file) if self.keys else None for field, file in files.items()}

    def scenario(self, name: str, dotted: Mapping[str, Any] = MappingProxyType({}), *, agents_too: bool = False) -> "Scenario":
        """The resolved scenario, and remarks on a recording for people; raises BadSetting naming what is wrong.

        `dotted`: settings that outweigh the options. With `agents_too` it may be an agents.toml.
        """
        from deploy.cli.errors import tell_remarks
        from deploy.scenario import recording_remarks

        scenario = self.variant(name, dotted, agents_too=agents_too)
        tell_remarks(recording_remarks(scenario))
        return scenario

    def variant(self, name: str, dotted: Mapping[str, Any] = MappingProxyType({}), *, agents_too: bool = False) -> "Scenario":
        """The resolved scenario with further settings such as {"control.mode": "random"}; raises BadSetting naming what is wrong."""
        from deploy.cli.scenario_checks import check_scenario
        from deploy.scenario import find
        from protocol.settings import BadSetting

        scenario = self.unchecked(name, dotted, agents_too=agents_too)
        try:
            check_scenario(scenario)
        except BadSetting as error:
            changed = {**self.overrides(), **dotted} or self.faults()
            raise BadSetting(f"{find(name)}{' with options' if changed else ''}: {error}") from error.__cause__
        return scenario

    def unchecked(self, name: str, dotted: Mapping[str, Any] = MappingProxyType({}), *, agents_too: bool = False) -> "Scenario":
        """The same without the checks beyond types, as for a scenario in which `mistakes` has found none."""
        import msgspec

        from deploy.scenario import check_triple, resolve

        scenario = resolve(name, {**self.overrides(), **dotted}, agents_too=agents_too)
        check_triple(scenario.team.composition, self.triple)
        return msgspec.structs.replace(scenario, faults=(*scenario.faults, *self.faults()))

    def requested_name(self, scenario: "Scenario") -> str | None:
        """The name that the user gives the run, here or in the scenario; None: there is none."""
        from protocol.settings import RunSettings

        return self.run or (scenario.run.name if scenario.run.name != RunSettings().name else None)

    def mistakes(self, name: str, *, agents_too: bool) -> list[str]:
        """Everything that is wrong with the scenario and the options, a line each."""
        from deploy.cli.scenario_checks import all_mistakes
        from deploy.scenario import read
        from protocol.settings import BadSetting

        try:
            data, source = read(name, self.overrides(), agents_too=agents_too)
            return all_mistakes(data, name, source, self.faults())
        except BadSetting as error:
            return [str(error)]

    def faults(self) -> "tuple[FaultSettings, ...]":
        """What --kill, --loss and --delay stand for."""
        from deploy.scenario import FaultSettings

        links = tuple(FaultSettings(at=0.0, verb=verb, value=value) for verb, value in self._links() if value is not None)
        return (*map(parse_kill, self.kill), *links)

    def _links(self) -> list[tuple[str, float | None]]:
        from protocol.settings import BadOption

        if self.loss is not None and not 0.0 <= self.loss <= 1.0:
            raise BadOption("loss", self.loss, "should be a share between 0 and 1")
        if self.delay is not None and not 0.0 <= self.delay < 1e6:
            raise BadOption("delay", self.delay, "should be a number of seconds from 0 to less than 1e6")
        return [("drop", self.loss), ("delay", self.delay)]


def switch_or_text(kind: object, tokens: Sequence[Token]) -> bool | str:
    """`--page` alone is True, `--no-page` is False. A text stays a text: `0` is a port."""
    return tokens[-1].implicit_value if isinstance(tokens[-1].implicit_value, bool) else tokens[-1].value


def parse_kill(text: str) -> "FaultSettings":
    """`30%@300` as a fault: the selected agents, and s of world time."""
    from deploy.scenario import FaultSettings
    from protocol.settings import BadOption

    who, at, when = text.rpartition("@")
    try:
        time = float(when)
    except ValueError:
        time = -1.0
    if not at or not who or not 0.0 <= time < 1e9:
        raise BadOption("kill", text, "should read who@when, such as 30%@300, 4@100 or s3@50 (when in s of world time)")
    return FaultSettings(at=time, verb="kill", who=who)
