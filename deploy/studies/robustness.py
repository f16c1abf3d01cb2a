"""The robustness study: how the error runs around a fault, against the same run without it and against a fresh team of the survivors.

A *bout* is one run with one fault at one time; it is a job of the study's machinery (`deploy.studies.engines`). All bouts of a seed share
tracks, starts and dice. Beside each bout with deaths goes a *fresh* one: the same world with the survivors alone from its start. The
world does not wait (`realtime` in virtual time), so that what is late is lost.
"""

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from deploy.faults.faults import Schedule
from deploy.scenario import FaultSettings, Scenario, check_triple, find, resolve
from deploy.simulation import Simulation
from deploy.studies.trials import CORE, Row, check_free, check_scored, check_seeds, key_of, source_hash
from protocol.settings import BadSetting

SCENARIO = "efficacy"
LEVELS: dict[str, tuple[float, ...]] = {
    "kill": (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9),  # share of the agents
    "loss": (0.1, 0.3, 0.5),  # share of the messages between agents, from the fault on
    "bursts": (0.1, 0.3, 0.5),  # the same, lost in runs of `RUN` messages in the mean (Gilbert-Elliott)
    "delay": (0.1, 0.5, 2.0),  # s, of the messages between agents, from the fault on
    "throttle": (128.0, 64.0, 32.0),  # kbit/s of each link between agents, from the fault on
    "partition": (3.0, 6.0, 12.0),  # s that two halves do not hear each other
}
RUN = 4.0  # messages
NONE, FRESH = "none", "fresh"  # kinds of bouts without a fault: the whole team, and the survivors of the level of "kill"
LEAST_AGENTS = 6  # of which nine tenths leave one
SETTLED = 30.0  # s after the fault from which on the swarm should be as good as it can be
FIRST = 10.0  # s after the fault that are averaged as its first effect
RECOVERED = 1.1  # times the reference
SMOOTH = 5.0  # s of the running mean that recovery is judged by
SETTLING_SECONDS = 0.5  # s after the fault from which on the uncovered area is read


class Bout(msgspec.Struct, frozen=True, kw_only=True):
    """One run: which fault, how bad, which seed, when, and for how long the run goes on."""

    kind: str
    level: float
    seed: int
    at: float  # s
    seconds: float
    options: dict[str, Any] = {}  # dotted settings

    def resolve(self) -> Scenario:
        """The scenario to run; raises BadSetting naming what is wrong."""
        scenario = resolve(SCENARIO, {**self.options, "run.seed": self.seed, "run.seconds": self.seconds})
        if self.kind != FRESH:
            return msgspec.structs.replace(scenario, faults=self.faults())
        everyone = list(scenario.members)
        [deaths] = Schedule(self.seed, self.faults()).due(self.at, everyone, [], everyone)
        survivors = {name: kind for name, kind in scenario.members.items() if name not in deaths.names}
        return msgspec.structs.replace(scenario, members=survivors)

    def faults(self) -> tuple[FaultSettings, ...]:
        """The fault of the bout; of a fresh team that by which the others died."""
        match self.kind:
            case "kill" | "fresh":
                return (FaultSettings(at=self.at, verb="kill", who=f"{100.0 * self.level:g}%"),)
            case "loss":
                return (FaultSettings(at=self.at, verb="drop", value=self.level),)
            case "bursts":
                return (FaultSettings(at=self.at, verb="drop", value=self.level, options={"burst": RUN}),)
            case "delay" | "throttle":
                return (FaultSettings(at=self.at, verb=self.kind, value=self.level),)
            case "partition":
                return (FaultSettings(at=self.at, verb="partition", who="50%", seconds=self.level),)
        return ()

    def file(self) -> Path:
        """The file of its scenario."""
        return find(SCENARIO)

    def key(self) -> str:
        """What tells this bout from all others, the program that runs it included."""
        return key_of([msgspec.to_builtins(self), code()], self.resolve())

    def command(self) -> str:
        """What this bout is, for people."""
        return f"robustness, seed {self.seed}, {self.kind} {self.level:g}"


def code() -> str:
    """A hash of the source that decides what a bout gives."""
    return source_hash((*CORE, "deploy/studies/robustness.py"))


def plan(trials: int, seed: int, at: float, seconds: float, options: dict[str, Any]) -> list[Bout]:
    """All bouts of a study, seed by seed; raises BadSetting for a run that ends too early or a team that is too small."""
    check_free(options, {"run.seed": "seed", "run.clock": ""})
    least = at + SETTLED + FIRST
    if trials < 1 or seconds < least:
        raise BadSetting(f"--trials {trials} --seconds {seconds:g}: should be at least one trial, and at least {least:g} s")
    check_seeds(seed, trials)
    cells = [(NONE, 0.0), *((kind, level) for kind, levels in LEVELS.items() for level in levels)]
    cells += [(FRESH, level) for level in LEVELS["kill"]]
    bouts = [
        Bout(kind=kind, level=level, seed=seed + trial, at=at, seconds=seconds, options=options)
        for trial in range(trials)
        for kind, level in cells
    ]
    scenario = bouts[0].resolve()
    check_triple(scenario.team.composition, options.get("team.triple"))
    check_scored(scenario)
    agents = len(scenario.members)
    if agents < LEAST_AGENTS:
        raise BadSetting(f"--team: has {agents} agents; should have at least {LEAST_AGENTS}, for nine in ten of them die")
    return bouts


def play(bout: Bout, progress: Callable[[float], None] = lambda share: None) -> Row:
    """The row of a bout: what it is, and OSPA in m after every tick; `progress` is told the share of the ticks that are done."""
    started = time.perf_counter()
    scenario = bout.resolve()
    simulation = Simulation(scenario, clock="realtime")
    simulation.on_truth = lambda truth: progress((truth.tick + 1) / scenario.run.ticks)
    simulation.run()
    scores = simulation.scorer.scores
    return {
        "kind": bout.kind,
        "level": bout.level,
        "seed": bout.seed,
        "at": bout.at,
        "agents": len(simulation.injector.alive()),  # at the end
        "hole": max(score.hole for score in scores if score.time >= bout.at + SETTLING_SECONDS),  # share of the arena
        "times": [score.time for score in scores],
        "ospa": [score.ospa for score in scores],
        "wall_s": round(time.perf_counter() - started, 3),
        "code": code(),
        "key": bout.key(),
    }


class Curve(NamedTuple):
    """OSPA (T,) in m at the times (T,) in s around the fault at 0 s."""

    times: np.ndarray
    ospa: np.ndarray

    def mean(self, start: float, end: float = np.inf) -> float:
        """The mean from `start` s to before `end` s."""
        return float(self.ospa[(self.times >= start) & (self.times < end)].mean())


def curve(row: Row) -> Curve:
    """The curve of a bout."""
    return Curve(np.array(row["times"]) - row["at"], np.array(row["ospa"]))


def table(rows: Sequence[Row]) -> list[Row]:
    """One line per bout but the fresh ones: OSPA before, in the first seconds after, and settled; the reference; their ratio; the time to
    recover, s, None where it does not.

    The reference is the settled OSPA of the fresh team of the survivors after deaths, else of the same seed without the fault.
    """
    references = {(row["seed"], row["kind"], row["level"]): curve(row).mean(SETTLED) for row in rows if row["kind"] in (NONE, FRESH)}
    return [line(row, references[reference_of(row)]) for row in rows if row["kind"] != FRESH]


def reference_of(row: Row) -> tuple[int, str, float]:
    """Seed, kind and level of the bout with which a bout is compared."""
    return (row["seed"], FRESH, row["level"]) if row["kind"] == "kill" else (row["seed"], NONE, 0.0)


def line(row: Row, reference: float) -> Row:
    """One line of `table`."""
    found = curve(row)
    settled = found.mean(SETTLED)
    return {
        **{name: row[name] for name in ("kind", "level", "seed", "agents")},
        "before": found.mean(-SETTLED, 0.0),
        "first": found.mean(0.0, FIRST),
        "settled": settled,
        "reference": reference,
        "ratio": settled / reference if reference else math.inf if settled else 1.0,
        "recovery_s": recovery(found, row["level"] if row["kind"] == "partition" else 0.0, reference),
        "largest_hole": row["hole"],
    }


def recovery(found: Curve, over: float, reference: float) -> float | None:
    """How long after `over` s, when the fault has ended, the running mean of OSPA is back at 1.1 x reference, s; None: never."""
    for start in found.times[(found.times >= over) & (found.times <= found.times[-1] - SMOOTH)]:
        if found.mean(start, start + SMOOTH) <= RECOVERED * reference:
            return float(start - over)
    return None


def summary(lines: Sequence[Row]) -> list[Row]:
    """For every kind and level medians over the seeds, with the quartiles of what is settled and of its ratio to the reference."""
    cells = list(dict.fromkeys((found["kind"], found["level"]) for found in lines))
    return [
        {"kind": kind, "level": level, **_medians([found for found in lines if (found["kind"], found["level"]) == (kind, level)])}
        for kind, level in cells
    ]


def quantile(values: Sequence[float], share: float) -> float:
    """The value below which a share of them lies, linear between two of them; infinite where the larger one is. numpy gives NaN there."""
    place, ordered = share * (len(values) - 1), sorted(values)
    low, high = ordered[math.floor(place)], ordered[math.ceil(place)]
    return low if low == high else low + (place - math.floor(place)) * (high - low)


def _medians(lines: Sequence[Row]) -> Row:
    found: Row = {"seeds": len(lines), "agents": int(np.median([one["agents"] for one in lines]))}
    for name in ("before", "first", "settled", "reference", "ratio"):
        values = [one[name] for one in lines]
        found[name] = float(np.median(values))
        if name in ("settled", "reference", "ratio"):
            found[f"{name}_low"], found[f"{name}_high"] = quantile(values, 0.25), quantile(values, 0.75)
    times = [np.inf if one["recovery_s"] is None else one["recovery_s"] for one in lines]
    return {**found, "recovery_s": float(np.median(times)), "largest_hole": max(one["largest_hole"] for one in lines)}
