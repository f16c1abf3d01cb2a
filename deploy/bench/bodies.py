"""`python -m deploy.bench.bodies SEEDS SECONDS`: do bodies touch, what does their size cost, and how fast are they simulated?

Eight sensors in an arena of 40 m lose two agents, whose bodies stay as wrecks. Each seed is played with points that may meet, with points
of a radius, and with MuJoCo's robots of that radius. The last rows play 16 robots without deaths, to measure speed.
"""

import math
import statistics
import sys
from collections.abc import Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from deploy.bench.timing import BenchRow, cpu_seconds, table
from deploy.scenario import FaultSettings, Scenario, resolve
from deploy.scoring.result import Result
from deploy.simulation import Simulation
from protocol.observer_messages import Truth
from protocol.streams import stream
from world.physical_bodies import PhysicalBodies

SEEDS, SECONDS = 4, 60.0
RADIUS = 0.25  # m
MODELS: dict[str, dict[str, object]] = {
    "points": {},
    "points with a radius": {"limits.radius": RADIUS},
    "mujoco": {"limits.radius": RADIUS, "bodies.model": "mujoco"},
}
CLOSED = {"targets.border": "reflect", "filter.border": "reflect", "targets.count": 6, "arena.width": 40.0, "arena.height": 40.0}


class Played(NamedTuple):
    """A run: its result, the least distance between two middles, m, in how many steps bodies touched, and CPU s."""

    result: Result
    least: float
    touches: int
    seconds: float


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


def scenario(model: str, team: str, seconds: float, seed: int, *, deaths: bool) -> Scenario:
    """A run of a team with bodies of a model; with `deaths` two agents are killed, after a quarter and after half of the time."""
    given = resolve("efficacy", {**CLOSED, "team.composition": team, "run.seconds": seconds, "run.seed": seed, **MODELS[model]})
    if not deaths:
        return given
    killed = stream(seed, "killed").permutation(list(given.members))[:2].tolist()
    faults = tuple(FaultSettings(at=share * seconds, verb="kill", who=name) for share, name in zip((0.25, 0.5), killed))
    return msgspec.structs.replace(given, faults=faults)


def play(given: Scenario) -> Played:
    """Play a run and look at the bodies in every tick."""
    simulation, gaps, found = Simulation(given), Gaps(), list[Result]()
    simulation.on_truth = gaps.take
    seconds = cpu_seconds(lambda: found.append(simulation.run()))
    bodies = simulation.world.bodies
    return Played(found[0], gaps.least, bodies.touches if isinstance(bodies, PhysicalBodies) else gaps.touches, seconds)


def measure(seeds: int = SEEDS, seconds: float = SECONDS) -> Iterator[BenchRow]:
    """A row for each model, and one for the speed of 16 robots of each."""
    runs: dict[str, list[Played]] = {model: [] for model in MODELS}
    for seed in range(1, seeds + 1):
        for model, played in runs.items():
            played.append(play(scenario(model, "A4,B4", seconds, seed, deaths=True)))
        said = [f"{model} {each[-1].least:.2f} m, OSPA {each[-1].result.steady_ospa:.3f} m" for model, each in runs.items()]
        print(f"seed {seed}: {'; '.join(said)}", file=sys.stderr, flush=True)
    for model, played in runs.items():
        ratios = [one.result.steady_ospa / point.result.steady_ospa for one, point in zip(played, runs["points"])]
        mean = statistics.fmean(one.result.steady_ospa for one in played) / statistics.fmean(
            point.result.steady_ospa for point in runs["points"]
        )
        yield {
            "bodies": model,
            "runs": f"{seeds} x {seconds:g} s",
            "touches": sum(one.touches for one in played),
            "least distance, m": min(one.least for one in played),
            "OSPA ratio, median": statistics.median(ratios),
            "OSPA ratio of means": mean,
        }
    for model in MODELS:
        for _ in range(2):  # the first one warms up
            fast = play(scenario(model, "A8,B8", 20.0, 1, deaths=False))
        yield {"bodies": model, "runs": "16 robots, 20 s", "touches": fast.touches, "x real time": 20.0 / fast.seconds}


if __name__ == "__main__":
    print(table(list(measure(*(kind(word) for kind, word in zip((int, float), sys.argv[1:]))))))
