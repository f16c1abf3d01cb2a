"""Trials: one run of a scenario in virtual time as a row of numbers from which the run can be repeated.

A *trial* is a scenario, a seed and dotted options. Trials that differ in their method alone are *paired*: they share the seed, and
with it target tracks, starts and every die of the detectors.
"""

import hashlib
import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec

from agents.config import AgentConfig, ControlSettings
from agents.coverage.laws import control_law
from deploy.scenario import SEARCH_EXTRACTION, Scenario, find, has_targets, resolve, toml_value
from deploy.scoring.error_parts import ErrorParts
from deploy.scoring.result import Result
from deploy.simulation import Simulation
from deploy.studies.own_code import own_code, own_files
from protocol.settings import LARGEST_SEED, BadOption, BadSetting
from world.sources import recorded_files

Row = dict[str, Any]
ROOMS = Path(__file__).resolve().parents[2]  # the folder that holds the rooms
CORE = (
    "protocol",
    "agents",
    "world",
    "deploy/simulation.py",
    "deploy/scenario.py",
    "deploy/oracle.py",
    "deploy/faults",
    "deploy/scoring",
)
LEFT_OUT = (
    "wall_s",
    "bytes",
    "kills",
    "missing",
    "events",
    "tick_rate",
    "exit_code",
)  # of a result: what another machine changes, and lists
FLAGS = {  # options of `covey simulate`
    "run.seed": "--seed",
    "team.composition": "--team",
    "team.triple": "--triple",
    "targets.count": "--targets",
    "partition.kind": "--partition",
    "capacity.mode": "--capacity",
    "control.mode": "--control",
    "run.dt": "--dt",
    "run.seconds": "--seconds",
}
SEARCH_AND_TRACK: dict[str, Any] = {"partition.kind": "power", "control.mode": "search-and-track"}
ABLATIONS: dict[str, dict[str, Any]] = {  # search-and-track without one of its ingredients
    "no-search": {"search.weight": 1.0, "search.inflow": 0.003},
    "no-sharing": {"search.sharing": 0.0},
    "no-distance": {"search.falloff": 0.0},
    "no-load": {"search.capacity": 0.0},
    "no-confirmation": {"search.confirmation": 0.0},
    "no-second-heading": {"search.second_heading": 0.0},
    "no-inflow": {"search.inflow": 0.0},
    "short-horizon": {"search.horizon": 1.0},
    "paper-extraction": {"extraction.bin": 1.0, "extraction.threshold": 0.5, "extraction.beside": 0.0},
}
METHODS: dict[str, dict[str, Any]] = {
    "power": {"partition.kind": "power"},
    "power-extraction": {  # what the extraction of search-and-track alone gains
        "partition.kind": "power",
        "control.mode": "lloyd",
        **{f"extraction.{field}": value for field, value in SEARCH_EXTRACTION.items()},
    },
    "voronoi": {"partition.kind": "voronoi"},
    "voronoi-cod": {"partition.kind": "voronoi-cod"},
    "pursuit": {"partition.kind": "power", "control.mode": "pursuit"},
    "search-and-track": SEARCH_AND_TRACK,
    **{name: {**SEARCH_AND_TRACK, **change} for name, change in ABLATIONS.items()},
    "oracle": {"partition.kind": "power", "control.mode": "oracle"},
    "uniform-density": {"partition.kind": "power", "control.mode": "uniform-density"},
    "random": {"partition.kind": "power", "control.mode": "random"},
    "static": {"partition.kind": "power", "control.mode": "static"},
}


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """One run of a study: everything that makes it what it is."""

    scenario: str
    seed: int
    team: str
    targets: int
    method: str  # a key of METHODS, or a control law `module:Class`
    options: dict[str, Any] = {}  # dotted settings beside those that the fields above and the method make

    def overrides(self) -> dict[str, Any]:
        """All dotted settings, those of the method last."""
        own = {"run.seed": self.seed, "team.composition": self.team, "targets.count": self.targets}
        return {**self.options, **own, **settings_of(self.method)}

    def resolve(self) -> Scenario:
        """The scenario to run, in lockstep unless the settings say something else; raises BadSetting naming what is wrong."""
        return resolve(self.scenario, {"run.clock": "lockstep", **self.overrides()})

    def file(self) -> Path:
        """The file of its scenario."""
        return find(self.scenario)

    def key(self) -> str:
        """What tells this trial from all others, the program that runs it included."""
        return self.key_with(self.resolve())

    def key_with(self, scenario: Scenario) -> str:
        """The key of this trial with the scenario that it has been played with."""
        return key_of([self.scenario, self.overrides(), fingerprint()], scenario)

    def command(self) -> str:
        """The command that repeats this trial."""
        words = ["covey", "simulate", self.scenario]
        for dotted, value in self.overrides().items():
            words += [FLAGS[dotted], str(value)] if dotted in FLAGS else ["--set", f"{dotted}={toml_value(value)}"]
        return shlex.join([*words, "--json"])


def key_of(made_of: list[Any], scenario: Scenario) -> str:
    """The key of a run: a hash of what it is made of, of all settings of its scenario, and of the files that the scenario names.

    Each of these files, and that of the scenario, may have changed meanwhile.
    """
    digest = hashlib.blake2b(json.dumps(made_of).encode() + msgspec.json.encode(scenario), digest_size=8)
    for file in [*own_files(scenario), *recorded_files(scenario.recorded)]:
        digest.update(hashlib.blake2b(file.read_bytes()).digest())
    return digest.hexdigest()


def check_free(options: Mapping[str, Any], taken: Mapping[str, str]) -> None:
    """Raise BadSetting for a setting of all runs that none of them would have; `taken` names options by which a study sets it, or none."""
    for dotted in options:
        if dotted in taken:
            right = f"given as {taken[dotted]}" if taken[dotted] else "left out"
            raise BadSetting(f"{dotted} = {options[dotted]!r}: the study itself sets it; should be {right}")


def check_seeds(first: int, number: int) -> None:
    """Raise BadOption unless `number` seeds from `first` on are seeds of runs."""
    largest = LARGEST_SEED + 1 - number
    if not 0 <= first <= largest:
        raise BadOption("seed", first, f"should be a whole number from 0 to {largest}")


def check_scored(scenario: Scenario) -> None:
    """Raise BadSetting for a scenario without targets: its scores say nothing, and a study compares scores."""
    if not has_targets(scenario):
        raise BadSetting("targets.count = 0: there are no scores without targets, and a study compares them; should be 1 or more")


def settings_of(method: str) -> dict[str, Any]:
    """The dotted settings of a method; those of a control law of the user's own, `module:Class`, are the paper's but for the law."""
    return METHODS.get(method, {"partition.kind": "power", "control.mode": method})


def check_method(name: str) -> None:
    """Raise BadOption unless there is such a method, or a control law of that name."""
    if name in METHODS:
        return
    if ":" not in name:
        raise BadOption("methods", name, f"should be one or more of {', '.join(METHODS)}, or a control law of your own as module:Class")
    if name.startswith("__main__:") or "<locals>" in name:
        right = "should be at the top of a file that is imported, as module:Class"
        raise BadOption("methods", name, f"trials run in processes of their own, which lack this class; {right}")
    try:
        control_law(AgentConfig(control=ControlSettings(mode=name)))
    except BadSetting as error:
        raise BadOption("methods", name, str(error).partition(": ")[2]) from error.__cause__


def fingerprint() -> str:
    """A hash of the source that decides what a trial gives: results of different programs are not mixed."""
    return source_hash(CORE)


@lru_cache(maxsize=4)
def source_hash(parts: tuple[str, ...]) -> str:
    """A hash of source files and folders, named from the root."""
    digest = hashlib.blake2b(digest_size=6)
    for file in _source_files(parts):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def newest_source() -> Path:
    """The file of `CORE` that was changed last."""
    return max(_source_files(CORE), key=lambda file: file.stat().st_mtime)


def _source_files(parts: Sequence[str]) -> list[Path]:
    paths = [ROOMS / part for part in parts]
    return [file for path in paths for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])]


def run_trial(trial: Trial, progress: Callable[[float], None] = lambda share: None) -> Row:
    """Play a trial and return its row; `progress` is told the share of the ticks that are done."""
    scenario = trial.resolve()
    simulation = Simulation(scenario, clock=scenario.run.clock)
    simulation.on_truth = lambda truth: progress((truth.tick + 1) / scenario.run.ticks)
    parts = ErrorParts(scenario)
    simulation.scorer.on_scored = parts.see
    result = simulation.run()
    split = {"ospa": parts.mean(), "gospa": parts.mean_gospa()}
    named = {f"{score}_{name}": part for score, found in split.items() for name, part in found._asdict().items()}
    return {**row_of(trial, scenario, result), **named}


def row_of(trial: Trial, scenario: Scenario, result: Result) -> Row:
    """A trial as one row of plain values: what it is, what came out, how to repeat it, and every setting."""
    found = {name: value for name, value in msgspec.to_builtins(result).items() if name not in LEFT_OUT}
    head = {"scenario": trial.scenario, "seed": trial.seed, "team": trial.team, "triple": scenario.team.triple}
    head |= {"start_targets": trial.targets, "method": trial.method}
    tail = {"code": fingerprint(), "own_code": own_code(scenario), "command": trial.command()}
    return {**head, **found, **tail, **flat_settings(scenario), "wall_s": result.wall_s, "key": trial.key_with(scenario)}


def flat_settings(scenario: Scenario) -> Row:
    """Every setting of a scenario under its dotted name; tables and lists as JSON."""
    flat: Row = {}
    for section, fields in msgspec.to_builtins(scenario).items():
        if not isinstance(fields, dict) or section in ("members", "sensors", "network"):
            if section != "network":
                flat[section] = json.dumps(fields)
            continue
        for field, value in fields.items():
            flat[f"{section}.{field}"] = json.dumps(value) if isinstance(value, dict | list | tuple) else value
    return flat


def cost(scenario: Scenario) -> float:
    """How long a trial takes, in units of its own: every agent plays every round and hears every other."""
    agents = len(scenario.members)
    return scenario.run.ticks * agents * (1.0 + agents / 60.0)


def methods_of(rows: Sequence[Row]) -> list[str]:
    """The methods that occur, in the order of the rows, which is that of the plan."""
    return list(dict.fromkeys(row["method"] for row in rows))
