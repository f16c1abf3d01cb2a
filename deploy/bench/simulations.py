"""`covey bench simulate` and `scale`: how fast a swarm plays in virtual time, beside the centralised reference and as it grows."""

import math
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import compress

import msgspec
import numpy as np

from agents.agent import Agent
from deploy.bench import central
from deploy.bench.timing import BenchRow, in_turns
from deploy.scenario import FaultSettings, Scenario, resolve
from deploy.simulation import Simulation, compiled
from protocol.node import Effect, Event
from protocol.observer_messages import Truth

AREA_PER_AGENT = 10000.0 / 48.0  # m^2, as team 5 has
INSIDE = 60.0  # m from every edge of the arena: who is farther from them is counted apart
ALIKE = range(26, 34)  # gossips: agents that hear so many are timed apart
SETTLED, END = 26, 34  # ticks of a growing crowd: those between them are measured
MOST_SEEDS = 20


class Timed(Agent):
    """An agent that notes its CPU, s."""

    spent = 0.0

    def handle(self, event: Event, now: float) -> list[Effect]:
        begun = time.perf_counter()
        effects = super().handle(event, now)
        self.spent += time.perf_counter() - begun
        return effects


def figure_4(seconds: float) -> Scenario:
    """Team 4 ACD of figure 4 with 30 targets and dt 0.5 s."""
    return resolve("efficacy", {"team.composition": "4", "run.dt": 0.5, "run.seconds": seconds})


def simulate(seconds: float = 60.0, turns: int = 3) -> Iterator[BenchRow]:
    """Simulated seconds per second of CPU: all heard, a tenth of the messages between agents lost, and the central filter without agents
    and messages. They take turns, so that all meet the machine in the same mood; medians."""
    scenario, backend = figure_4(seconds), compiled()
    lossy = msgspec.structs.replace(scenario, faults=(FaultSettings(at=0.0, verb="drop", value=0.1),))
    kinds: dict[str, Callable[[], object]] = {
        "all heard": lambda: Simulation(scenario).run(),
        "10 % lost": lambda: Simulation(lossy).run(),
        "central": lambda: central.play(scenario, backend),
    }
    Simulation(figure_4(5.0)).run()
    central.play(figure_4(5.0), backend)
    spent = {name: statistics.median(times) for name, times in in_turns(kinds, turns).items()}
    rounds = scenario.run.ticks * len(scenario.members)
    for name, each in spent.items():
        yield {
            "what": name,
            "simulated s per CPU s": seconds / each,
            "ms per agent-round": 1000.0 * each / rounds,
            "of the central speed": spent["central"] / each,
        }


def crowd(agents: int, interest: str, ticks: int, seed: int = 1) -> Scenario:
    """A swarm of classes A, C and D as in team 5, at its density of agents and of targets (50 per 48 agents)."""
    side = math.sqrt(agents * AREA_PER_AGENT)
    few, many = agents // 8, agents // 2
    options = {
        "team.composition": f"A{few},C{many},D{agents - few - many}",
        "targets.count": round(agents * 50 / 48),
        "arena.width": side,
        "arena.height": side,
        "run.dt": 0.5,
        "run.seconds": 0.5 * ticks,
        "run.seed": seed,
        "timing.interest": interest,
        # twelve background births for every hundred metres squared, whatever the size
        "birth.background_particles": max(1, round(12 * side / 100.0)),
    }
    return resolve("efficacy", options)


def scale(sizes: tuple[int, ...] = (48, 200, 400, 1000, 5000), enough: int = 1000) -> Iterator[BenchRow]:
    """Per agent-round at constant density, once all have chosen their neighbours and whoever was heard of at the start only has been
    forgotten: CPU, deliveries, messages, bytes, peers listened to. Of small swarms several are played, to measure `enough` agents.

    The CPU is that of agents, bus, codec and world; the swarm is not scored, because that is nobody's part of a round. In a small
    arena most agents live at its edge, where there are fewer to be heard. Four figures leave that out: the time for each gossip heard,
    the time for each delivery, the time of the agents that hear 26 to 33 (without bus and world), and how many an agent hears that is
    far from every edge.
    """
    smallest: dict[str, float] = {}
    for agents in sizes:
        for interest in ("all", "neighbours"):
            if interest == "all" and agents > 200:
                continue  # grows with the square
            seeds = range(1, 1 + max(1, min(MOST_SEEDS, enough // agents)))
            row = _steady([crowd(agents, interest, END + 1, seed) for seed in seeds], interest)
            spent = row["ms per agent-round"]
            yield {**row, "of the smallest": spent / smallest.setdefault(interest, spent)}


@dataclass
class _Sums:
    """Of one or several swarms, in the ticks that count."""

    spent: float = 0.0  # CPU, s
    deliveries: int = 0
    messages: int = 0
    bytes: int = 0
    start: float = 0.0  # CPU, s, until these ticks
    heard: int = 0  # the rest is of the last tick, of all agents
    known: int = 0
    certified: int = 0
    alike: list[float] = field(default_factory=list)  # CPU of the rounds of agents that hear about the same number, s
    inside: list[int] = field(default_factory=list)  # gossips heard by agents far from every edge


def _steady(scenarios: list[Scenario], interest: str) -> BenchRow:
    """Swarms of one size, one after the other."""
    sums = _Sums()
    for scenario in scenarios:
        _add(scenario, sums)
    agents = len(scenarios[0].members)
    lives = agents * len(scenarios)
    rounds = lives * (END - SETTLED)
    return {
        "agents": agents,
        "interest": interest,
        "swarms": len(scenarios),
        "ms per agent-round": 1000.0 * sums.spent / rounds,
        "ms if 26 to 33 are heard": 1000.0 * sum(sums.alike) / len(sums.alike) if sums.alike else "",
        "us per gossip heard": 1e6 * sums.spent / rounds * lives / max(1, sums.heard),
        "us per delivery": 1e6 * sums.spent / max(1, sums.deliveries),
        "deliveries": sums.deliveries / rounds,
        "messages": sums.messages / rounds,
        "bytes": sums.bytes / rounds,
        "listened to": sums.heard / lives,
        "listened to inside": sum(sums.inside) / len(sums.inside) if sums.inside else "",
        "known": sums.known / lives,
        "certified": sums.certified / lives,
        "start and first rounds, CPU s": sums.start / len(scenarios),
    }


def _add(scenario: Scenario, sums: _Sums) -> None:
    """Play a swarm and count."""
    begun = time.process_time()
    simulation = Simulation(scenario, scores=False, build=Timed)
    marks: list[tuple[float, int, int, int]] = []

    def mark(truth: Truth) -> None:
        if truth.tick in (SETTLED, END):
            marks.append((time.process_time(), simulation.bus.deliveries, simulation.bus.messages, simulation.bus.bytes))
        for agent in simulation.agents.values():
            assert isinstance(agent, Timed)
            if SETTLED < truth.tick <= END and len(agent.peer_table.interest_set) in ALIKE:
                sums.alike.append(agent.spent)
            agent.spent = 0.0
        if truth.tick == END:
            x, y, _ = truth.poses.T
            far = np.minimum(np.minimum(x, y), np.minimum(scenario.arena.width - x, scenario.arena.height - y)) > INSIDE
            sums.inside.extend(len(simulation.agents[name].peer_table.interest_set) for name in compress(truth.bodies, far.tolist()))

    simulation.on_truth = mark
    simulation.run()
    (first, *before), (last, *after) = marks
    deliveries, messages, size = (late - early for early, late in zip(before, after))
    agents = simulation.agents.values()
    sums.start += first - begun
    sums.spent += last - first
    sums.deliveries, sums.messages, sums.bytes = sums.deliveries + deliveries, sums.messages + messages, sums.bytes + size
    sums.heard += sum(len(agent.peer_table.interest_set) for agent in agents)
    sums.known += sum(len(agent.peer_table.peers) for agent in agents)
    sums.certified += sum(agent.peer_table.certified for agent in agents)
