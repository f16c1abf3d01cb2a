"""Scenarios: one TOML file each, with the options of the command line laid over it, resolved into the run.toml of a run."""

import hashlib
import math
import re
import tomllib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from agents.config import AgentConfig, ExtractionSettings
from protocol.fields import RESERVED
from protocol.keys import order
from protocol.settings import (
    BadOption,
    BadSetting,
    Fraction,
    NetworkSettings,
    NotNegative,
    Positive,
    RunSettings,
    Section,
    SensorSettings,
    convert,
    read_toml,
    sensor_of,
)
from world.config import BodySettings, RecordedSettings, TargetSettings, WorldConfig, WorldRun
from world.sources import recording_of

LOCKSTEP_HASTE = 5  # times the messages a second that are no flood: nothing holds the world up there, and one agent alone does 700 ticks/s
SEARCH_EXTRACTION = {"bin": 0.7, "threshold": 0.3, "beside": 0.7}  # what goes with search-and-track where the scenario says nothing
LAW_TITLES = {"lloyd": "the paper's method", "search-and-track": "search and track"}
MOST_SEARCH_BINS = 1_000_000  # every agent keeps in mind when each bin of the arena was last seen
FOLDER = Path(__file__).parent / "scenarios"
ORACLE = "oracle"  # a control mode that only simulations have (`oracle.Oracle`)
PAPER_TEAMS: dict[str, tuple[int, ...]] = {"2": (3, 12, 9), "3": (4, 16, 12), "4": (5, 20, 15), "5": (6, 24, 18)}


class TeamSettings(Section, frozen=True, kw_only=True):
    """[team] either a team of the paper by number, or a composition such as "20E+4H" or "A4,B12"; in its place, [members]."""

    composition: str = "1"  # empty: the members are spelled out
    triple: str = "ACD"  # the three classes of teams 2 to 5, a column that Table II has lost


class FaultSettings(Section, frozen=True, kw_only=True):
    """[[faults]] one thing that happens to the swarm."""

    at: NotNegative  # world time, s
    verb: str  # what happens; docs/how-to/own-scenario.md#faults-in-a-scenario has a table of all verbs, and of which need `who`
    who: str = ""  # a name, names with commas, a number, or a share such as "30%"
    seconds: NotNegative | None = None  # for how long; None = until the end
    value: NotNegative | None = None  # of the verb: a probability, a delay in s
    options: dict[str, Any] = {}


class StudySettings(Section, frozen=True, kw_only=True):
    """[study] how results are averaged."""

    steady_share: Fraction = 0.8  # the last share of the run that counts as steady state
    cutoff: Positive = 10.0  # of OSPA and GOSPA, m


class Scenario(AgentConfig, frozen=True, kw_only=True, eq=True, forbid_unknown_fields=True):
    """A whole scenario, all sections; unknown ones are refused."""

    run: WorldRun = WorldRun()
    targets: TargetSettings = TargetSettings()
    bodies: BodySettings = BodySettings()
    recorded: RecordedSettings = RecordedSettings()
    team: TeamSettings = TeamSettings()
    study: StudySettings = StudySettings()
    faults: tuple[FaultSettings, ...] = ()


def world_config(scenario: Scenario) -> WorldConfig:
    """What the world reads of a scenario."""
    return WorldConfig(**{field: getattr(scenario, field) for field in WorldConfig.__struct_fields__})


def agent_config(scenario: Scenario) -> AgentConfig:
    """What an agent may know of a scenario (docs/explanation/knowledge.md): no targets, bodies or faults, and not the seed of the world.

    Agents that hear their neighbours get no roster either.
    """
    fields = {field: getattr(scenario, field) for field in AgentConfig.__struct_fields__}
    fields["run"] = RunSettings(**{field: getattr(scenario.run, field) for field in RunSettings.__struct_fields__})
    seed = scenario.filter.seed or filter_seed(scenario.run.seed)
    fields["filter"] = msgspec.structs.replace(scenario.filter, seed=seed)
    if scenario.timing.interest == "neighbours":
        fields["members"] = {}
    # Only certificates are checked against this list, which agents without a roster need in full.
    admitted = scenario.network.admit or tuple(scenario.members) if scenario.network.encrypted else ()
    fields["network"] = msgspec.structs.replace(scenario.network, admit=admitted)
    return AgentConfig(**fields)


def filter_seed(run_seed: int) -> int:
    """The seed that the agents share: a one-way hash of the run's seed, which reveals neither target tracks nor detections.

    Small seeds can be guessed and tried out: a run whose agents are not trusted takes a random one below 2^63.
    """
    digest = hashlib.blake2b(f"filter {run_seed}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") >> 1


def team_counts(team: TeamSettings) -> dict[str, int]:
    """Sensors of each class, in order; raises BadSetting when the text cannot be read (Table II)."""
    text = team.composition.strip()
    if text == "1":
        return {"A": 4, "B": 12}
    if text in PAPER_TEAMS:
        if len(team.triple) != 3 or len(set(team.triple)) != 3:
            raise BadSetting(f"team.triple = {team.triple!r}: should be three different sensor classes such as ACD")
        return dict(zip(team.triple, PAPER_TEAMS[text]))
    text = {"6": "20E+4H", "7": "20E+10G", "8": "20E+20F"}.get(text, text)
    counts: dict[str, int] = {}
    for part in re.split(r"[+,\s]+", text):
        match = re.fullmatch(r"(\d{1,9})([A-Za-z_]\w*)|([A-Za-z_]\w*?)(\d{1,9})", part)
        if match is None:
            right = "should be a team 1-8, or such as 20E+4H or A4,B12; a class name has letters, digits and _ here, any in [members]"
            raise BadSetting(f"team.composition = {team.composition!r}: {right}")
        sensor_class, number = match[2] or match[3], int(match[1] or match[4])
        counts[sensor_class] = counts.get(sensor_class, 0) + number
    if not 0 < sum(counts.values()) <= 10000:
        raise BadSetting(f"team.composition = {team.composition!r}: a team has 1 to 10000 sensors")
    return counts


def check_triple(composition: str, triple: object) -> None:
    """Raise BadOption for sensor classes that were given with a team that does not read them."""
    if triple is not None and composition.strip() not in PAPER_TEAMS:
        team = f"team {composition}" if composition.strip() else "agents by name"
        raise BadOption("triple", triple, f"should be left out with {team}: teams {', '.join(PAPER_TEAMS)} alone have it")


def find(name: str) -> Path:
    """The file of a scenario that is named or given by its path; raises BadSetting listing what there is."""
    path = Path(name)
    if path.suffix == ".toml" or "/" in name:
        return path
    shipped = FOLDER / f"{name}.toml"
    if not shipped.is_file():
        known = ", ".join(sorted(file.stem for file in FOLDER.glob("*.toml")))
        raise BadSetting(f"scenario {name!r} does not exist; known are {known}, or give the path of a TOML file")
    return shipped


def resolve(name: str, overrides: dict[str, Any] | None = None, *, agents_too: bool = False) -> Scenario:
    """The scenario `name` with dotted overrides such as {"run.seed": 3} laid over it and the team spelled out; see `read`."""
    data, source = read(name, overrides, agents_too=agents_too)
    return spelled_out(convert(data, Scenario, source), data, name, source)


def read(name: str, overrides: dict[str, Any] | None = None, *, agents_too: bool = False) -> tuple[dict[str, Any], str]:
    """The data of the scenario `name` with dotted overrides laid over it, and where it comes from in words; raises BadSetting.

    An agents.toml is refused unless `agents_too`: it says nothing of the world, so that its defaults would stand for it.
    """
    path = find(name)
    data = read_toml(path)
    if not data:
        raise BadSetting(f"{path}: says nothing; `covey init NAME.toml` writes a scenario to begin with")
    if not agents_too and _is_of_agents(data):
        right = "a scenario is the run.toml beside it"
        raise BadSetting(f"{path}: settings of agents, as a run writes them; {right}. `covey check {path} --network` looks for their swarm")
    _leave_out_derived(data)
    for dotted, value in (overrides or {}).items():
        _lay_over(data, dotted, value)
    return data, str(path) if not overrides else f"{path} with options"


def derived_settings(clock: object, law: object) -> dict[str, dict[str, Any]]:
    """Settings that follow from clock and control law where nobody says them, by section and name."""
    extraction = msgspec.to_builtins(ExtractionSettings()) | (SEARCH_EXTRACTION if law == "search-and-track" else {})
    haste = LOCKSTEP_HASTE if clock == "lockstep" else 1
    return {"network": {"most_per_second": haste * NetworkSettings().most_per_second}, "extraction": extraction}


def _leave_out_derived(data: dict[str, Any]) -> None:
    """Take out of a resolved scenario what was derived and has not been changed since: with options something else may follow."""
    run, control = data.get("run"), data.get("control", {})
    if not isinstance(run, dict) or not isinstance(run.get("derived"), list) or not isinstance(control, dict):
        return
    for section, fields in derived_settings(run.get("clock"), control.get("mode")).items():
        if isinstance(contents := data.get(section), dict):
            gone = [field for field in fields if f"{section}.{field}" in run["derived"] and contents.get(field) == fields[field]]
            data[section] = {field: value for field, value in contents.items() if field not in gone}


def _is_of_agents(data: dict[str, Any]) -> bool:
    """Whether data are what `agent_config` leaves of a scenario: all that agents read, their own seed, and no word of the world."""
    run = data.get("run")
    return set(data) == set(AgentConfig.__struct_fields__) and isinstance(run, dict) and set(run) == set(RunSettings.__struct_fields__)


def spelled_out(scenario: Scenario, data: dict[str, Any], name: str, source: str) -> Scenario:
    """A scenario with its members by name, and with what follows from its `data`; raises BadSetting for a team that cannot be."""
    for sensor_class, sensor in scenario.sensors.items():
        check_sensor_fields(sensor, f"{source}: sensors.{sensor_class}.")
    try:
        team, members = _team_and_members(scenario, data.get("team", {}))
        for sensor_class in dict.fromkeys(members.values()):
            sensor_of(scenario, sensor_class)
    except BadSetting as error:
        field = "members" if scenario.members else "team.triple" if scenario.team.composition.strip() in PAPER_TEAMS else "team.composition"
        raise BadSetting(f"{source}: {'' if str(error).startswith(('team.', 'sensors.')) else f'{field}: '}{error}") from None
    if scenario.filter.compact and scenario.timing.overlap:  # copies of a particle are known by its id
        raise BadSetting(f"{source}: filter.compact = true: each owner numbers particles anew, so timing.overlap should be 0")
    follows = {
        section: {field: value for field, value in fields.items() if field not in data.get(section, {})}
        for section, fields in derived_settings(scenario.run.clock, scenario.control.mode).items()
    }
    derived = tuple(f"{section}.{field}" for section, fields in follows.items() for field in fields)
    run = msgspec.structs.replace(scenario.run, scenario=scenario.run.scenario or name, derived=derived)
    if scenario.control.mode == "search-and-track":
        if scenario.search.horizon < scenario.run.dt:
            raise BadSetting(f"{source}: search.horizon = {scenario.search.horizon:g}: should be run.dt ({scenario.run.dt:g} s) or more")
        area, side = scenario.arena.width * scenario.arena.height, scenario.search.bin
        if area / side**2 > MOST_SEARCH_BINS:
            wrong = f"{source}: search.bin = {side:g}: the arena has {area / side**2:.0f} bins, and search-and-track looks at"
            least = math.ceil(10.0 * math.sqrt(area / MOST_SEARCH_BINS)) / 10.0
            raise BadSetting(
                f"{wrong} at most {MOST_SEARCH_BINS}; should be at least {least:g} m; about a fifth of what sensors reach is usual"
            )
    recorded = scenario.recorded
    if recorded.data:  # another process reads it, from another folder
        recorded = msgspec.structs.replace(recorded, data=str((find(name).parent / recorded.data).absolute()))
    sections = {section: msgspec.structs.replace(getattr(scenario, section), **fields) for section, fields in follows.items()}
    return msgspec.structs.replace(scenario, members=members, team=team, run=run, recorded=recorded, **sections)


def with_run_name(scenario: Scenario, run: str) -> Scenario:
    """The scenario as a run of that name."""
    return msgspec.structs.replace(scenario, run=msgspec.structs.replace(scenario.run, name=run))


def has_targets(scenario: Scenario) -> bool:
    """Whether there are true targets to compare estimates with; those of a room in which robots are is not among what a run knows."""
    return scenario.recorded.kind != "none" or scenario.targets.count > 0


def targets_in_words(scenario: Scenario) -> str:
    """How many targets there are, or where they come from."""
    recorded = scenario.recorded
    if recorded.kind != "none":
        return f"{recorded.kind} of {Path(recorded.data).name}"
    targets = scenario.targets
    arrive = targets.border == "cross" and targets.count * targets.speed > 0.0  # as `arrival_rate`
    return f"{targets.count} target{'s' * (targets.count != 1)}{' at the start, and others enter and leave' if arrive else ''}"


def law_in_words(mode: str) -> str:
    """A control law for people."""
    return LAW_TITLES.get(mode, mode)


def with_deaths(scenario: Scenario) -> Scenario:
    """The scenario, with 3 agents that die at mid-run where it has no faults; one agent at least is left."""
    if scenario.faults or len(scenario.members) == 1:
        return scenario
    deaths = FaultSettings(at=scenario.run.seconds / 2.0, verb="kill", who=str(min(3, len(scenario.members) - 1)))
    return msgspec.structs.replace(scenario, faults=(deaths,))


def user_classes(scenario: Scenario) -> list[str]:
    """The user's own classes that a scenario names, each as `module:Class`."""
    named = (
        *(sensor.model for sensor in scenario.sensors.values()),
        scenario.control.mode,
        scenario.targets.motion,
        scenario.bodies.platform,
    )
    return sorted({name for name in named if ":" in name})


def unsimulated(scenario: Scenario) -> set[str]:
    """The processes of a live run that a simulation does not have, so that no fault can strike them there."""
    return {"world", *(f"{member}.body" for member in scenario.members)}


def recording_remarks(scenario: Scenario) -> tuple[str, ...]:
    """What was left out of the files of a recorded world, a line each; raises BadSetting for wrong files."""
    return recording_of(world_config(scenario)).remarks if scenario.recorded.kind != "none" else ()


def check_sensor_fields(sensor: SensorSettings, where: str) -> None:
    """Raise BadSetting for a field that a sensor of this kind does not read, or needs; `where` stands before the names of fields."""
    if sensor.model != "wedge":
        for field in ("angle", "radius", "prob_detection", "prob_detection_far", "range_noise", "bearing_noise"):
            if value := getattr(sensor, field):
                raise BadSetting(f"{where}{field} = {value:g}: only a wedge reads it; should be left out, or stand in parameters")
        return
    if sensor.parameters:
        raise BadSetting(f"{where}parameters = {sensor.parameters}: a wedge has none; should be left out, or model be module:Class")
    if sensor.measures != "position" and not sensor.bearing_noise:
        raise BadSetting(f"{where}bearing_noise = 0: should be more than 0 and at most 45 degrees with measures = {sensor.measures!r}")
    if sensor.measures == "bearing" and sensor.range_noise:
        raise BadSetting(f"{where}range_noise = {sensor.range_noise:g}: should be left out, for measures = 'bearing' has no range")


def check_names(scenario: Scenario) -> None:
    """Raise BadSetting for an agent that bears the name of another process."""
    for name in RESERVED:
        if name in scenario.members:
            raise BadSetting(f"members.{name}: this name belongs to the {name}; call the agent otherwise")
    for name in bodies_of(scenario).values():
        if name in scenario.members:
            raise BadSetting(f"members.{name}: this name belongs to a body; call the agent otherwise")


def bodies_of(scenario: Scenario) -> dict[str, str]:
    """The names of body processes by agent, such as s3.body; none where one world has all bodies."""
    return {name: f"{name}.body" for name in scenario.members} if scenario.bodies.host == "own" else {}


def world_names(scenario: Scenario) -> list[str]:
    """The processes that are the world of a run: one world, or the bodies."""
    return [*bodies_of(scenario).values()] or ["world"]


def in_team_order(scenario: Scenario, names: Collection[str]) -> list[str]:
    """Names of agents: members in the order of the scenario, then guests in the order of names."""
    guests = sorted((name for name in names if name not in scenario.members), key=order)
    return [*(name for name in scenario.members if name in names), *guests]


def _team_and_members(scenario: Scenario, said: dict[str, Any]) -> tuple[TeamSettings, dict[str, str]]:
    """The team and its members by name, when [team] has `said` this; raises BadSetting where it says others than [members]."""
    own = scenario.members
    team = msgspec.structs.replace(scenario.team, composition="") if own and not said else scenario.team
    members = own if own and not team.composition else _name_members(team_counts(team))
    if own and members != own:
        field = "composition" if "composition" in said else next(iter(said))
        empty = ", or empty" if field == "composition" else ""
        raise BadSetting(f"team.{field} = {said[field]!r}: should be left out{empty}, for [members] names other agents")
    return team, members


def _name_members(counts: dict[str, int]) -> dict[str, str]:
    classes = [sensor_class for sensor_class, number in counts.items() for _ in range(number)]
    return {f"s{number}": sensor_class for number, sensor_class in enumerate(classes, start=1)}


def _lay_over(data: dict[str, Any], dotted: str, value: Any) -> None:
    *sections, field = dotted.split(".")
    if not sections:
        raise BadSetting(f"{dotted}: should be the name of a setting with its section, such as detection.clutter")
    for section in sections:
        data = data.setdefault(section, {})
        if not isinstance(data, dict):
            raise BadSetting(f"{dotted}: {section} is not a section")
    data[field] = value


def parse_set(text: str) -> tuple[str, Any]:
    """`section.key=value` as a dotted name and a TOML value (bare words count as strings)."""
    dotted, equals, value = text.partition("=")
    if not equals or "." not in dotted:
        raise BadSetting(f"--set {text}: should read section.key=value")
    try:
        return dotted.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return dotted.strip(), value.strip()


def toml_text(settings: msgspec.Struct | dict[str, Any]) -> str:
    """The TOML file of a scenario, of a part of it, or of plain data; None stands for a setting that is left out."""
    return tomli_w.dumps(_without_none(msgspec.to_builtins(settings)))


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value] if isinstance(value, list | tuple) else value


def toml_value(value: Any) -> str:
    """A value on one line of TOML: lists in brackets, tables in braces."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{tomli_w.dumps({key: 0})[:-5]} = {toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return tomli_w.dumps({"value": value}).removeprefix("value = ").removesuffix("\n")


def check_oracle(scenario: Scenario) -> None:
    """Raise BadSetting where the oracle, which assigns all bodies at once, would have no world with all bodies."""
    if bodies_of(scenario):
        raise BadSetting("bodies.host = 'own': should be 'world' with control.mode = 'oracle', which assigns all bodies at once")


def refuse_oracle(scenario: Scenario) -> None:
    """Raise BadSetting for a live run that asks for the oracle."""
    if scenario.control.mode == ORACLE:
        raise BadSetting("control.mode = 'oracle': knows the true targets, which a live run tells no agent; use covey simulate")
