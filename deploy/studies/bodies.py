"""The study of bodies: do bodies with a size touch, and what does their size cost?

Eight sensors in a closed arena of 40 m lose two agents, after a quarter and after half of the time. Their bodies stay as wrecks. Each seed
is played with some models of bodies, under the same tracks, starts, dice and deaths. Speeds are measured by `covey bench bodies`.
"""

import math
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from deploy.scenario import FaultSettings, Scenario, check_triple, find, resolve, toml_value
from deploy.simulation import Simulation
from deploy.studies.trials import CORE, Row, check_free, check_scored, check_seeds, key_of, source_hash
from protocol.observer_messages import Truth
from protocol.random_streams import stream
from protocol.settings import BadSetting
from world.physical_bodies import PhysicalBodies

SCENARIO = "efficacy"
TEAM = "A4,B4"
RADIUS = 0.25  # m
DEATHS = (0.25, 0.5)  # shares of the time after which an agent dies
POINTS = "points"  # they may meet: what the others are compared with
MODELS: dict[str, dict[str, Any]] = {
    POINTS: {},
    "radius": {"limits.radius": RADIUS},
    "mujoco": {"limits.radius": RADIUS, "bodies.model": "mujoco"},
}
CLOSED = {"targets.border": "reflect", "filter.border": "reflect", "targets.count": 6, "arena.width": 40.0, "arena.height": 40.0}


class BodyRun(msgspec.Struct, frozen=True, kw_only=True):
    """One run: which model of bodies, which seed, and for how long, s."""

    model: str  # a key of MODELS
    seed: int
    seconds: float
    deaths: bool = True
    options: dict[str, Any] = {}  # dotted settings

    def resolve(self) -> Scenario:
        """The scenario to run; raises BadSetting naming what is wrong."""
        own = {"run.seconds": self.seconds, "run.seed": self.seed, **MODELS[self.model]}
        given = resolve(SCENARIO, {"team.composition": TEAM, **CLOSED, **self.options, **own})
        if not self.deaths:
            return given
        killed = stream(self.seed, "killed").permutation(list(given.members))[: len(DEATHS)].tolist()
        faults = tuple(FaultSettings(at=share * self.seconds, verb="kill", who=name) for share, name in zip(DEATHS, killed))
        return msgspec.structs.replace(given, faults=faults)

    def file(self) -> Path:
        """The file of its scenario."""
        return find(SCENARIO)

    def key(self) -> str:
        """What tells this run from all others, the program that plays it included."""
        return key_of([msgspec.to_builtins(self), code()], self.resolve())

    def command(self) -> str:
        """The command that repeats this run."""
        words = f"covey study bodies --trials 1 --seed {self.seed} --seconds {self.seconds:g} --methods {self.model}"
        settings = [f"--set {shlex.quote(f'{dotted}={toml_value(value)}')}" for dotted, value in self.options.items()]
        return " ".join([words, *settings])


class Gaps:
    """The least distance between two of all bodies, m; within a tick they are taken to move on straight lines."""

    def __init__(self) -> None:
        self.least = math.inf
        self.touches = 0  # ticks in which two of them were closer than twice the radius
        self._before: np.ndarray | None = None

    def take(self, truth: Truth) -> None:
        """Look at a tick."""
        places = truth.poses[:, :2]
        before, self._before = places if self._before is None else self._before, places
        one, other = np.triu_indices(len(places), 1)
        start, end = before[one] - before[other], places[one] - places[other]
        move = end - start
        share = np.clip(-(start * move).sum(axis=1) / np.maximum((move * move).sum(axis=1), 1e-12), 0.0, 1.0)[:, None]
        nearest = float(np.linalg.norm(start + share * move, axis=1).min())
        self.least = min(self.least, nearest)
        self.touches += nearest < 2.0 * RADIUS


def code() -> str:
    """A hash of the source that decides what a run gives."""
    return source_hash((*CORE, "deploy/studies/bodies.py"))


def plan(trials: int, seed: int, seconds: float, models: Sequence[str], options: dict[str, Any]) -> list[BodyRun]:
    """All runs of a study, seed by seed; raises BadSetting for what is not possible."""
    for model in models:
        if model not in MODELS:
            raise BadSetting(f"--methods {model}: should be one or more of {', '.join(MODELS)}")
    sizes = {dotted: "methods" for changes in MODELS.values() for dotted in changes}
    check_free(options, {"run.seed": "seed", "run.clock": "", **sizes})
    check_seeds(seed, trials)
    runs = [
        BodyRun(model=model, seed=number, seconds=seconds, options=options) for number in range(seed, seed + trials) for model in models
    ]
    for run in runs[: len(models)]:
        scenario = run.resolve()
        check_triple(scenario.team.composition, options.get("team.triple"))
        check_scored(scenario)
        if len(scenario.members) <= len(DEATHS):
            raise BadSetting(
                f"team {scenario.team.composition}: should be of {len(DEATHS) + 1} sensors or more, for {len(DEATHS)} of them die"
            )
    return runs


def play(run: BodyRun, progress: Callable[[float], None] = lambda share: None) -> Row:
    """The row of a run: what it is, contacts, the least distance between two middles, m, and steady OSPA, m.

    `touches` counts ticks for points, and steps of the integrator for MuJoCo's robots. `progress` is told the share of the finished ticks.
    """
    started, scenario = time.perf_counter(), run.resolve()
    simulation, gaps = Simulation(scenario), Gaps()

    def look(truth: Truth) -> None:
        gaps.take(truth)
        progress((truth.tick + 1) / scenario.run.ticks)

    simulation.on_truth = look
    result = simulation.run()
    bodies = simulation.world.bodies
    return {
        "method": run.model,
        "team": scenario.team.composition,
        "seed": run.seed,
        "seconds": run.seconds,
        "start_targets": scenario.targets.count,
        "wrecks": len(scenario.members) - len(simulation.injector.alive()),
        "touches": bodies.touches if isinstance(bodies, PhysicalBodies) else gaps.touches,
        "least_distance": gaps.least,
        "steady_ospa": result.steady_ospa,
        "wall_s": round(time.perf_counter() - started, 3),
        "code": code(),
        "command": run.command(),
        "key": run.key(),
    }


def summary(rows: Sequence[Row]) -> list[Row]:
    """A line for each model: runs, contacts, distances, m, and the ratio of steady OSPA to that of points of the same seeds."""
    points = {row["seed"]: row["steady_ospa"] for row in rows if row["method"] == POINTS}
    return [_line(model, [row for row in rows if row["method"] == model], points) for model in MODELS if _has(model, rows)]


def _has(model: str, rows: Sequence[Row]) -> bool:
    return any(row["method"] == model for row in rows)


def _line(model: str, rows: Sequence[Row], points: dict[int, float]) -> Row:
    """The line of a model; the ratios are None where no seed was played with points."""
    distances = [row["least_distance"] for row in rows]
    line: Row = {
        "model": model,
        "runs": len(rows),
        "first_seed": min(row["seed"] for row in rows),
        "last_seed": max(row["seed"] for row in rows),
        "seconds": rows[0]["seconds"],
        "wrecks": sum(row["wrecks"] for row in rows),
        "touches": sum(row["touches"] for row in rows),
        "runs_with_touches": sum(row["touches"] > 0 for row in rows),
        "least_distance": min(distances),
        "median_distance": float(np.median(distances)),
        "pairs": 0,
        **dict.fromkeys(("ratio", "ratio_low", "ratio_high", "ratio_of_means")),
    }
    pairs = [(row["steady_ospa"], points[row["seed"]]) for row in rows if points.get(row["seed"])]  # to no error there is no ratio
    if pairs:
        ratios = [one / point for one, point in pairs]
        low, middle, high = map(float, np.quantile(ratios, [0.25, 0.5, 0.75]))
        line |= {"pairs": len(pairs), "ratio": middle, "ratio_low": low, "ratio_high": high}
        line["ratio_of_means"] = sum(one for one, _ in pairs) / sum(point for _, point in pairs)
    return line
