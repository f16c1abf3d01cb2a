"""`covey bench overload`: a live swarm whose machine has too little time for it, beside the same run in lockstep.

A swarm of 32 agents runs at rate 2, twice as fast as real time. After it has settled, something happens for some seconds: nothing,
busy loops beside a swarm of low priority, a stop of all processes at once, or a death under load. The status is read several times a
second, and the scores of all ticks at the end. The supervisor, which measures, keeps its priority. Starved like the agents it would
leave out messages, and call cells a hole of which it has not read yet. The lockstep figures are those of a simulation of the same
scenario and seed, over the same ticks.
"""

import contextlib
import math
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from deploy.bench.processes import NAME, Swarm, swarm
from deploy.bench.timing import BenchRow
from deploy.scenario import resolve
from deploy.scoring.scores import Score, read_scores
from deploy.simulation import Simulation
from deploy.storage.run_directory import RunDirectory

SETTLE, CALM, AFTER = 12.0, 4.0, 8.0  # wall s: until the swarm tracks, before and after what happens
POLL = 0.2  # wall s between two looks at the status
BACK = 2.0  # wall s after the end of a load or a death until all must be well again
LOW = 15  # niceness of a swarm of low priority


class LoadProfile(NamedTuple):
    """What a swarm goes through."""

    agents: int = 32
    rate: str = "2"
    loops: int = 0  # busy processes beside a swarm of low priority
    frozen: float = 0.0  # s for which all processes are stopped
    deaths: int = 0  # evenly spread; each agent is restarted before the next one dies
    lasts: float = 25.0  # wall s


PROFILES = {
    "quiet": LoadProfile(),
    "three loops": LoadProfile(loops=3),
    "eight loops": LoadProfile(loops=8),
    "frozen 3 s": LoadProfile(frozen=3.0, lasts=6.0),
    "death, three loops": LoadProfile(loops=3, deaths=1, lasts=15.0),
    "48 agents, rate 1": LoadProfile(agents=48, rate="1"),
    "auto, three loops": LoadProfile(rate="auto", loops=3),
    "auto, eight loops": LoadProfile(rate="auto", loops=8),
}
LONG = {"100 deaths, three loops": LoadProfile(loops=3, deaths=100, lasts=600.0)}  # only by name: takes 12 minutes


class StatusSample(NamedTuple):
    """One look at the status."""

    at: float  # wall s
    tick: int
    rounds: int
    skipped: int


def measure(names: Sequence[str] = tuple(PROFILES), seeds: Sequence[int] = (1,)) -> Iterator[BenchRow]:
    """One row for each profile and seed."""
    for seed in seeds:
        for name in names:
            yield {"load": name, "seed": seed, **play((PROFILES | LONG)[name], seed)}


def play(profile: LoadProfile, seed: int) -> BenchRow:
    """One live run through a profile, and the lockstep run of the same seed beside it."""
    samples: list[StatusSample] = []
    words = ["--seed", str(seed), "--rate", profile.rate]
    if profile.rate == "auto":
        words += ["--set", "run.max_rate=2"]
    with swarm(profile.agents, "zygote", words) as running:
        if profile.loops:
            lower_children(running.pid)
        watch(running, SETTLE + CALM, samples)
        begin = time.monotonic()
        with busy(profile.loops):
            if profile.frozen:
                freeze(running, profile.frozen)
            for death in range(profile.deaths):
                name, half = f"s{3 + death % (profile.agents - 2)}", 0.5 * profile.lasts / profile.deaths
                watch(running, half, samples)
                running.ask("kill", name)
                watch(running, half, samples)
                running.ask("restart", name)
            watch(running, profile.lasts - (time.monotonic() - begin) if not profile.frozen else profile.lasts, samples)
        end = time.monotonic()
        watch(running, AFTER, samples)
        result = running.end()
        scores = read_scores(RunDirectory(NAME).scores)
    return figures(profile, seed, samples, scores, begin, end, result)


def watch(running: Swarm, seconds: float, samples: list[StatusSample]) -> None:
    """Look at the status for some seconds."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        status = running.status()["swarm"]
        rate = status["tick_rate"]
        samples.append(StatusSample(time.monotonic(), status["tick"], rate["rounds"], rate["skipped"]))
        time.sleep(POLL)


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Processes of normal priority that take all the time that they get."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def lower_children(pid: int) -> None:
    """Give the children of a process a low priority, and theirs, with all their threads. What they start later inherits it."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in map(int, (task / "children").read_text(encoding="utf-8").split()):
            for thread in Path(f"/proc/{child}/task").iterdir():
                os.setpriority(os.PRIO_PROCESS, int(thread.name), LOW)
            lower_children(child)


def freeze(running: Swarm, seconds: float) -> None:
    """Stop all processes of a swarm at once, its supervisor included, and let them go on."""
    pids = [running.pid, *(row["pid"] for row in running.status()["processes"] if row["pid"])]
    for number in (signal.SIGSTOP, signal.SIGCONT):
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)
        if number is signal.SIGSTOP:
            time.sleep(seconds)


def figures(
    profile: LoadProfile,
    seed: int,
    samples: list[StatusSample],
    scores: list[Score],
    begin: float,
    end: float,
    result: dict[str, Any],
) -> BenchRow:
    """The row of a run: while it lasted, and from `BACK` s after its end on (of a freeze: from 1 s on).

    Every tick counts once, live and in lockstep. The newest score at a look would not do: bad ticks are scored later, and stand for longer.
    """
    if profile.frozen:
        begin += profile.frozen + 1.0
    during = [sample for sample in samples if begin <= sample.at <= end]
    after = [sample for sample in samples if sample.at > end + BACK]
    lockstep = reference(profile, seed, samples[-1].tick)
    rounds, skipped = (during[-1][column] - during[0][column] for column in (2, 3))
    row: BenchRow = {"ticks per s": (during[-1].tick - during[0].tick) / (during[-1].at - during[0].at)}
    row |= {"skipped, %": 100.0 * skipped / max(1, rounds + skipped)}
    for label, part in (("", during), (" after", after)):
        live, exact = ([score for score in each if part[0].tick <= score.tick <= part[-1].tick] for each in (scores, lockstep))
        row |= {f"OSPA{label}, m": mean([score.ospa for score in live]), f"lockstep{label}, m": mean([score.ospa for score in exact])}
        row |= {f"hole{label}, %": 100.0 * mean([score.hole for score in live])}
        row |= {f"most overlap{label}, %": 100.0 * max(score.overlap for score in live)}
    row["ratio"] = row["OSPA, m"] / max(row["lockstep, m"], 1e-9)
    row["false deaths"] = len(result["kills"]) - profile.deaths
    if profile.deaths:
        closed = [math.inf if kill["closed_seconds"] is None else kill["closed_seconds"] for kill in result["kills"]]
        row |= {"hole closed, s": max(closed), "in the median, s": statistics.median(closed)}
        row["closed in 2 s, %"] = 100.0 * mean([float(seconds <= BACK) for seconds in closed])
    return row


def reference(profile: LoadProfile, seed: int, ticks: int) -> list[Score]:
    """The scores of the lockstep run of the same scenario and seed."""
    team = {32: "3", 48: "5"}[profile.agents]
    seconds = (ticks + 1) * 0.25
    simulation = Simulation(resolve("efficacy", {"team.composition": team, "run.seed": seed, "run.seconds": seconds}))
    simulation.run()
    return simulation.scorer.scores


def mean(values: Sequence[float]) -> float:
    """The mean; 0 of nothing."""
    return sum(values) / len(values) if values else 0.0
