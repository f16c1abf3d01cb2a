"""`covey fuzz`: deterministic simulation of small swarms under faults that one seed draws.

A case has three phases. In chaos the faults of its profile strike. In healing links and agents are put right; clocks that have jumped stay
wrong. In a calm end the swarm must be one again. Safety is checked after every event (`deploy.verify.invariants`), liveness at the end: all
live agents agree, and their cells tile the arena. From then on they are the central filter particle by particle. A failing seed is shrunk
until no single fault can be left out, and one command replays it.
"""

import json
import os
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import msgspec
import numpy as np

from agents.agent import Agent
from agents.backend import Backend
from deploy.faults.injector import Build
from deploy.scenario import FaultSettings, Scenario, resolve
from deploy.simulation import Simulation
from deploy.verify.invariants import LOADS, InvariantBroken, InvariantChecker
from protocol.random_streams import stream

CALM_START, CHAOS, SETTLE = 2.0, 20.0, 5.0  # s
CALM_END = 8  # ticks; the central filter starts in the first, and is compared in all others but the last two, which are not complete
HEAL_AT = CALM_START + CHAOS
KINDS = ("crash", "stop", "cut", "loss", "copies", "delay", "reorder", "spoilt", "clock", "slow", "twin", "join")
SLOWED = {"stop", "clock", "slow", "starve"}  # kinds after which a pace may still be slow
SLOW_SETTLE = 20  # ticks in which it falls and all is well: two rounds of the slowest pace, and four of silence
MIXED = "mixed"  # the profile of all kinds
PROFILES = {  # of a slow or bad network, played with the look-ahead and without; the first kind always strikes
    "late": ("late", "freeze"),
    "radio": ("jitter", "throttle"),
    "bursts": ("bursts", "group"),
}
BLANK = FaultSettings(at=0.0, verb="kill", who="0%")  # selects nobody; the victims of a fault depend on its place in the list
BLIND = {"angle": 240.0, "radius": 8.0, "prob_detection": 1e-12}  # sees nothing, so that no mass changes


class Case(NamedTuple):
    """The case of a seed."""

    seed: int
    scenario: Scenario
    is_ledger: bool  # nothing is born, detected or lost: the mass must stay, up to the tolerances `MASS_KEPT` of the invariants
    kinds: tuple[str, ...]  # of faults


class Failure(NamedTuple):
    """A seed that broke something."""

    seed: int
    what: str
    faults: tuple[FaultSettings, ...]
    profile: str = MIXED

    def __str__(self) -> str:
        profile = "" if self.profile == MIXED else f" --profile {self.profile}"
        lines = [f"seed {self.seed}: {self.what}", f"  replay: covey fuzz --seeds 1 --first {self.seed}{profile}"]
        return "\n".join(lines + [f"  {_as_text(fault)}" for fault in self.faults if fault != BLANK])


def draw(seed: int, profile: str = MIXED) -> Case:
    """The case of a seed: a swarm of 6 to 8, half of them in ledger mode.

    In the profile "mixed" one kind of fault strikes alone, or each with probability one half. The other profiles have kinds of their own.
    """
    if profile != MIXED:
        return _draw_network(seed, profile)
    rng = stream(seed, "fuzz")
    is_ledger = bool(rng.random() < 0.5)
    if rng.random() < 0.4:
        kinds: tuple[str, ...] = (KINDS[int(rng.integers(len(KINDS)))],)
    else:
        kinds = tuple(kind for kind in KINDS if rng.random() < 0.5)
    agents, dt = int(rng.integers(6, 9)), (0.25, 0.5)[int(rng.integers(2))]
    faults = tuple(
        fault for kind in kinds for _ in range(int(rng.integers(1, 4))) for fault in strike(kind, rng, "L" if is_ledger else "C")
    )
    scenario, loads = _swarm(seed, is_ledger, agents, dt, rng), stream(seed, "fuzz load")
    if loads.random() < 0.3:
        load = LOADS[int(loads.integers(len(LOADS)))]
        if loads.random() < 0.3:
            kinds, faults = (), ()
        kinds, faults = (*kinds, load), (*faults, *strike(load, loads, ""))
    longer = max(0.0, SLOW_SETTLE * dt - SETTLE) if SLOWED & set(kinds) else 0.0
    run = msgspec.structs.replace(scenario.run, seconds=scenario.run.seconds + longer)
    return Case(seed, msgspec.structs.replace(scenario, run=run, faults=faults + healing()), is_ledger, kinds)


def _draw_network(seed: int, profile: str) -> Case:
    """The case of a seed in one of the `PROFILES`: with a look-ahead in two thirds of the cases, with small messages in a third."""
    rng = stream(seed, f"fuzz {profile}")
    is_ledger, agents, dt = bool(rng.random() < 0.5), int(rng.integers(6, 9)), (0.25, 0.5)[int(rng.integers(2))]
    first, *others = PROFILES[profile]
    kinds = (first, *(kind for kind in others if rng.random() < 0.5))
    faults = tuple(fault for kind in kinds for _ in range(int(rng.integers(1, 4))) for fault in strike(kind, rng, ""))
    scenario = _swarm(seed, is_ledger, agents, dt, rng)
    timing = msgspec.structs.replace(scenario.timing, look_ahead=(0.0, 1.0, 2.5)[int(rng.integers(3))])
    filters = msgspec.structs.replace(scenario.filter, compact=bool(rng.random() < 0.33) and not timing.overlap)
    run = msgspec.structs.replace(scenario.run, seconds=scenario.run.seconds + timing.look_ahead)
    scenario = msgspec.structs.replace(scenario, run=run, faults=faults + healing(), timing=timing, filter=filters)
    return Case(seed, scenario, is_ledger, kinds)


def _swarm(seed: int, is_ledger: bool, agents: int, dt: float, rng: np.random.Generator) -> Scenario:
    team = f"L{agents}" if is_ledger else f"A2,C{agents - 3},D1"
    side = float(rng.integers(25, 46))
    options = {"run.seed": seed, "run.name": "fuzz", "run.dt": dt, "run.seconds": HEAL_AT + SETTLE + CALM_END * dt}
    options |= {"arena.width": side, "arena.height": side, "team.composition": team, "targets.count": 0 if is_ledger else 5}
    options |= {"filter.particles_per_target": 30, "filter.least_particles": 12}
    redrawn = is_ledger and stream(seed, "fuzz turnover").random() < 0.5  # so many per owner that new particles replace old ones each tick
    if not redrawn and stream(seed, "fuzz overlap").random() < 0.3:
        options |= {"timing.overlap": 3.0}  # both sides of a contested border count: only so can an id be told twice
    if is_ledger:
        options |= {"filter.least_particles": 150} if redrawn else {}
        options |= {"filter.lifetime": 0.0, "filter.border": "reflect", "filter.prior_density": 0.01, "birth.background": False}
        options |= {"birth.measurement": False, "detection.clutter": 0.0, "sensors.L": BLIND}
    return resolve("efficacy", options)


def strike(kind: str, rng: np.random.Generator, guest: str) -> Iterator[FaultSettings]:
    """The faults of one blow of a kind; newcomers have the sensor class `guest`."""
    at, seconds = round(CALM_START + rng.random() * (CHAOS - 1.0), 2), round(0.5 + 6.0 * rng.random(), 2)
    share = f"{int(rng.integers(10, 61))}%"
    dice, flag = float(rng.random()), bool(rng.random() < 0.5)

    def blow(
        verb: str, who: str = share, value: float | None = None, lasting: float | None = seconds, options: dict[str, object] | None = None
    ) -> FaultSettings:
        return FaultSettings(at=at, verb=verb, who=who, value=value, seconds=lasting, options=options or {})

    match kind:
        case "crash":
            yield blow("kill", options={"silent": flag})
        case "stop":
            yield blow("pause")
        case "cut":
            yield blow("partition", options={"kind": ("both", "one-way", "bridge")[int(3.0 * dice)], "tokens": flag})
        case "loss":
            yield blow("drop", "100%", round(0.05 + 0.3 * dice, 3), options={"burst": float(rng.integers(2, 8)) if flag else 0.0})
        case "copies":  # up to 8 s late: also a replay of what is long over
            yield blow("duplicate", value=round(0.1 + 0.5 * dice, 3), options={"spread": 8.0 if flag else 0.3})
        case "delay":
            yield blow("delay", value=round(0.6 * dice, 3), options={"jitter": 0.3 if flag else 0.0})
        case "late":
            yield blow("delay", "100%" if flag else share, value=round(2.0 * dice, 3), options={"jitter": float(rng.choice([0.0, 0.3]))})
        case "jitter":
            yield blow("delay", "100%", value=round(0.6 * dice, 3) if flag else 0.01, options={"jitter": 0.2})
        case "throttle":
            yield blow("throttle", "100%", 64.0)
        case "bursts":
            yield blow("drop", "100%", round(0.1 + 0.3 * dice, 3), options={"burst": float(rng.integers(2, 9))})
        case "group":
            yield blow("pause")
        case "reorder":
            yield blow("reorder", value=round(0.1 + 0.5 * dice, 3), options={"spread": 0.4})
        case "spoilt":
            yield blow("flip", value=round(0.02 + 0.3 * dice, 3))
        case "clock":
            yield blow("jump", value=round(600.0 * dice, 1), lasting=None, options={"back": flag})
        case "slow":
            yield blow("slow", value=round(0.05 + 0.6 * dice, 2))
        case "starve":
            yield blow("starve", who="100%" if flag else share, value=round(0.15 + 0.6 * dice, 2))
        case "freeze":
            yield blow("freeze", who="", value=round(0.5 + 6.0 * dice, 2), lasting=None)
        case "twin":
            yield blow("twin", who="1", lasting=None)
        case "join":
            yield blow("join", who=f"g{int(1e6 * dice)}", lasting=None, options={"class": guest})


def healing() -> tuple[FaultSettings, ...]:
    """What puts everything right."""
    everyone = [("slow", 0.0), ("starve", 0.0), ("resume", None), ("restart", None)]
    return (
        FaultSettings(at=HEAL_AT, verb="heal"),
        *(FaultSettings(at=HEAL_AT, verb=verb, who="100%", value=value) for verb, value in everyone),
    )


def settled_at(scenario: Scenario) -> float:
    """World time in s from which on the swarm must be one. Messages that are on their way at the healing come up to a look-ahead later."""
    return scenario.run.seconds - CALM_END * scenario.run.dt


def play(case: Case, build: Build = Agent, backend: Backend | None = None) -> str | None:
    """What a case broke, None when all is well."""
    try:
        simulation = Simulation(case.scenario, clock="realtime", build=build, backend=backend)
        watch = InvariantChecker(simulation, settled_at(case.scenario), case.is_ledger, case.kinds)
        simulation.run()
        watch.finish()
    except InvariantBroken as broken:
        return str(broken)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} in {os.path.basename(place.filename)}:{place.lineno}: {error}"
    return None


def check(seed: int, profile: str = MIXED) -> Failure | None:
    """The failure of a seed, shrunk; None when all is well."""
    case = draw(seed, profile)
    what = play(case)
    if what is None:
        return None
    smaller, what = shrink(case, what)
    return Failure(seed, what, smaller.scenario.faults, profile)


def shrink(case: Case, what: str, play: Callable[[Case], str | None] = play) -> tuple[Case, str]:
    """The case with blanks in place of faults, until none of the others can be left out, and what it breaks; healing stays."""
    shrinks = True
    while shrinks:
        shrinks = False
        for number, fault in enumerate(case.scenario.faults):
            if fault in (BLANK, *healing()):
                continue
            faults = (*case.scenario.faults[:number], BLANK, *case.scenario.faults[number + 1 :])
            smaller = case._replace(scenario=msgspec.structs.replace(case.scenario, faults=faults))
            broken = play(smaller)
            if broken is not None:
                case, what, shrinks = smaller, broken, True
    return case, what


def run(
    seeds: Sequence[int],
    jobs: int | None = None,
    progress: Callable[[int, int], None] = lambda done, failed: None,
    profile: str = MIXED,
) -> list[Failure]:
    """The failures among some seeds, on all cores; `progress` is called with (cases done, failures)."""
    failures: list[Failure] = []
    with ProcessPoolExecutor(jobs or os.cpu_count()) as pool:
        for done, failure in enumerate(pool.map(partial(check, profile=profile), seeds), start=1):
            failures += [failure] if failure else []
            progress(done, len(failures))
    return failures


def _as_text(fault: FaultSettings) -> str:
    """A fault in one line, as it would stand in a scenario."""
    return _as_table({name: value for name, value in msgspec.to_builtins(fault).items() if value not in (None, {})})


def _as_table(values: Mapping[str, Any]) -> str:
    """An inline table of TOML."""
    texts = {name: _as_table(value) if isinstance(value, Mapping) else json.dumps(value) for name, value in values.items()}
    return "{" + ", ".join(f"{name} = {text}" for name, text in texts.items()) + "}"
