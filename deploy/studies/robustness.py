"""The robustness study: how the error runs around a fault, against the same run without it and against a fresh team of the survivors.

A *bout* is one run with one fault at one time. All bouts of a seed share tracks, starts and dice. The world does not wait (`realtime` in
virtual time), so that what is late is lost. Written: `curves.csv`, one row per bout and tick; `robustness.csv`, one row per bout;
`robustness.pdf` and `.png`, OSPA over time around the fault with the band from the lower to the upper quartile of the seeds.
"""

import csv
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from deploy.monitor_node import Score
from deploy.scenario import FaultSettings, Scenario, resolve
from deploy.simulate import Simulation
from protocol.settings import BadSetting

LEVELS: dict[str, tuple[float, ...]] = {
    "kill": (0.1, 0.3, 0.5),  # share of the agents
    "loss": (0.1, 0.3, 0.5),  # share of the messages, from the fault on
    "delay": (0.1, 0.5, 2.0),  # s, from the fault on
    "partition": (3.0, 6.0, 12.0),  # s that two halves do not hear each other
}
NONE = "none"  # the kind of the undisturbed bout
SETTLED = 30.0  # s after the fault from which on the swarm should be as good as it can be
FIRST = 10.0  # s after the fault that are averaged as its first effect
RECOVERED = 1.1  # times the reference
SMOOTH = 5.0  # s of the running mean that recovery is judged by
Row = dict[str, Any]


class Bout(NamedTuple):
    """One run: which fault, how bad, which seed, when, and for how long the run goes on."""

    kind: str
    level: float
    seed: int
    at: float  # s
    seconds: float
    options: tuple[tuple[str, Any], ...] = ()  # dotted settings


class Played(NamedTuple):
    """What a bout gave: OSPA, cardinality and uncovered area after every tick; and, after deaths, OSPA of a fresh team of the survivors."""

    bout: Bout
    times: list[float]
    ospa: list[float]
    fresh: float | None  # mean from `SETTLED` after the fault on, m
    hole: float  # the largest from half a second after the fault on, share of the arena
    survivors: int


def fault_of(bout: Bout) -> tuple[FaultSettings, ...]:
    """The fault of a bout."""
    if bout.kind == "kill":
        return (FaultSettings(at=bout.at, verb="kill", who=f"{100.0 * bout.level:g}%"),)
    if bout.kind == "loss":
        return (FaultSettings(at=bout.at, verb="drop", value=bout.level),)
    if bout.kind == "delay":
        return (FaultSettings(at=bout.at, verb="delay", value=bout.level),)
    if bout.kind == "partition":
        return (FaultSettings(at=bout.at, verb="partition", who="50%", seconds=bout.level),)
    return ()


def play(bout: Bout) -> Played:
    """Play a bout, and after deaths the same world with the survivors alone."""
    options = {"run.seed": bout.seed, "run.seconds": bout.seconds, **dict(bout.options)}
    scenario = msgspec.structs.replace(resolve("efficacy", options), faults=fault_of(bout))
    scores, alive = _run(scenario)
    fresh = None
    if bout.kind == "kill":
        members = {name: scenario.members[name] for name in alive}
        fresh = _after(_run(msgspec.structs.replace(scenario, members=members, faults=()))[0], bout.at + SETTLED)
    late = [score.hole for score in scores if score.time >= bout.at + 0.5]
    return Played(bout, [score.time for score in scores], [score.ospa for score in scores], fresh, max(late, default=0.0), len(alive))


def _run(scenario: Scenario) -> tuple[list[Score], list[str]]:
    simulation = Simulation(scenario, use_codec=False, clock="realtime")
    simulation.run()
    return simulation.scorer.scores, simulation.injector.alive()


def _after(scores: Iterable[Score], start: float) -> float:
    return float(np.mean([score.ospa for score in scores if score.time >= start]))


def plan(trials: int, seed: int, at: float, seconds: float, kinds: Sequence[str], options: dict[str, Any]) -> list[Bout]:
    """All bouts of a study; raises BadSetting for an unknown kind or a run that ends too early."""
    unknown = [kind for kind in kinds if kind not in LEVELS]
    if unknown:
        raise BadSetting(f"--kinds {','.join(kinds)}: {unknown[0]!r} is unknown; known are {', '.join(LEVELS)}")
    if trials < 1 or seconds < at + SETTLED + FIRST:
        raise BadSetting(f"--trials {trials} --seconds {seconds:g}: at least one trial, and at least {at + SETTLED + FIRST:g} s")
    cells = [(NONE, 0.0), *((kind, level) for kind in kinds for level in LEVELS[kind])]
    fixed = tuple(sorted(options.items()))
    return [Bout(kind, level, seed + trial, at, seconds, fixed) for trial in range(trials) for kind, level in cells]


def run(bouts: Sequence[Bout], jobs: int | None = None, progress: Callable[[int], None] = lambda done: None) -> list[Played]:
    """Play all bouts on all cores; `progress` is called with how many are done."""
    played = []
    with ProcessPoolExecutor(jobs or os.cpu_count()) as pool:
        for done, found in enumerate(pool.map(play, bouts), start=1):
            played.append(found)
            progress(done)
    return played


def table(played: Sequence[Played]) -> list[Row]:
    """One row per bout: OSPA before, in the first seconds after, and settled; the reference; their ratio; the time to recover, s.

    The reference is the fresh team of the survivors after deaths, else the same seed without the fault.
    """
    calm = {found.bout.seed: found for found in played if found.bout.kind == NONE}
    return [row_of(found, calm[found.bout.seed]) for found in played]


def row_of(found: Played, calm: Played) -> Row:
    """One row of `table`."""
    bout, times, ospa = found.bout, np.array(found.times), np.array(found.ospa)
    reference = found.fresh if found.fresh is not None else float(np.mean(np.array(calm.ospa)[np.array(calm.times) >= bout.at + SETTLED]))
    settled = float(np.mean(ospa[times >= bout.at + SETTLED]))
    return {
        "kind": bout.kind,
        "level": bout.level,
        "seed": bout.seed,
        "survivors": found.survivors,
        "before": float(np.mean(ospa[(times >= bout.at - SETTLED) & (times < bout.at)])),
        "first": float(np.mean(ospa[(times >= bout.at) & (times < bout.at + FIRST)])),
        "settled": settled,
        "reference": reference,
        "ratio": settled / reference,
        "recovery_s": recovery(times, ospa, bout, reference),
        "largest_hole": found.hole,
    }


def recovery(times: np.ndarray, ospa: np.ndarray, bout: Bout, reference: float) -> float | None:
    """How long after the fault (a partition: after its end) the running mean of OSPA is back at 1.1 x reference, s; None: never."""
    over = bout.at + (bout.level if bout.kind == "partition" else 0.0)
    for time in times[times >= over]:
        window = ospa[(times >= time) & (times < time + SMOOTH)]
        if window.mean() <= RECOVERED * reference:
            return float(time - over)
    return None


def summary(rows: Sequence[Row]) -> list[Row]:
    """Medians over the seeds for every kind and level."""
    cells = list(dict.fromkeys((row["kind"], row["level"]) for row in rows))
    return [
        {"kind": kind, "level": level, **_medians([row for row in rows if (row["kind"], row["level"]) == (kind, level)])}
        for kind, level in cells
    ]


def _medians(rows: Sequence[Row]) -> Row:
    names = ("before", "first", "settled", "reference", "ratio")
    found: Row = {name: float(np.median([row[name] for row in rows])) for name in names}
    times = [row["recovery_s"] for row in rows]
    found["recovery_s"] = float(np.median([np.inf if time is None else time for time in times]))
    return {**found, "largest_hole": max(row["largest_hole"] for row in rows), "seeds": len(rows)}


def write(played: Sequence[Played], into: Path) -> list[Path]:
    """Write curves and table as CSV, and the figure; the paths."""
    from deploy.studies.robustness_figure import draw

    into.mkdir(parents=True, exist_ok=True)
    curves, bouts = into / "curves.csv", into / "robustness.csv"
    with curves.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["kind", "level", "seed", "time", "ospa"])
        for found in played:
            writer.writerows([*found.bout[:3], time, ospa] for time, ospa in zip(found.times, found.ospa))
    rows = table(played)
    with bouts.open("w", newline="", encoding="utf-8") as file:
        table_writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table_writer.writeheader()
        table_writer.writerows(rows)
    return [curves, bouts, *draw(played, into / "robustness")]
