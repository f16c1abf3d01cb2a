"""`covey bench simulate` and `scale`: how fast a swarm plays in virtual time, beside the centralised reference and as it grows."""

import math
import time
from itertools import compress

import numpy as np

from agents.agent import Agent
from deploy.bench import central
from deploy.bench.timing import Row, cpu_seconds
from deploy.scenario import Scenario, resolve
from deploy.simulate import Simulation, compiled
from protocol.messages import Message, Truth
from protocol.node import Effect, Event

AREA_PER_AGENT = 10000.0 / 48.0  # m^2, as team 5 has
INSIDE = 60.0  # m from every edge of the arena: who is farther from them is counted apart
ALIKE = range(26, 34)  # gossips: who hears so many is timed apart


class Timed(Agent):
    """An agent that notes its CPU, s."""

    spent = 0.0

    def handle(self, event: Event, now: float) -> list[Effect]:
        begun = time.perf_counter()
        effects = super().handle(event, now)
        self.spent += time.perf_counter() - begun
        return effects

    def take_all(self, messages: list[Message], now: float) -> list[Effect]:
        begun = time.perf_counter()
        effects = super().take_all(messages, now)
        self.spent += time.perf_counter() - begun
        return effects


def figure_4(seconds: float) -> Scenario:
    """Team 4 ACD of figure 4 with 30 targets and dt 0.5 s."""
    return resolve("efficacy", {"team.composition": "4", "run.dt": 0.5, "run.seconds": seconds})


def simulate(seconds: float = 60.0) -> list[Row]:
    """Simulated seconds per second of CPU: with the codec, without, and the central filter without agents and messages."""
    scenario, arithmetic = figure_4(seconds), compiled()
    Simulation(figure_4(5.0)).run()
    central.play(figure_4(5.0), arithmetic)
    reference = cpu_seconds(lambda: central.play(scenario, arithmetic))
    rows = []
    for name, codec in (("with codec", True), ("without codec", False)):
        simulation = Simulation(scenario, use_codec=codec)
        spent = cpu_seconds(simulation.run)
        rounds = scenario.run.ticks * len(scenario.members)
        rows.append(
            {
                "what": name,
                "simulated s per CPU s": seconds / spent,
                "ms per agent-round": 1000.0 * spent / rounds,
                "of the central speed": reference / spent,
            }
        )
    each = 1000.0 * reference / (scenario.run.ticks * len(scenario.members))
    rows.append({"what": "central", "simulated s per CPU s": seconds / reference, "ms per agent-round": each, "of the central speed": 1.0})
    return rows


def crowd(agents: int, interest: str, ticks: int) -> Scenario:
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
        "timing.interest": interest,
        # twelve background births for every hundred metres squared, whatever the size
        "birth.background_particles": max(1, round(12 * side / 100.0)),
    }
    return resolve("efficacy", options)


def scale(sizes: tuple[int, ...] = (48, 200, 400, 1000, 5000), ticks: int = 24) -> list[Row]:
    """Per agent-round at constant density, once all have chosen their neighbours: CPU, deliveries, messages, bytes, peers listened to.

    The CPU is that of agents, bus, codec and world; the swarm is not scored, because that is nobody's part of a round. In a small arena
    most agents live at its edge, where there are fewer to be heard: the time for each gossip heard and for each delivery leaves that out,
    and so does the time of those agents (without bus and world) that hear 26 to 33, and the number of those to whom an agent listens that
    is far from every edge.
    """
    rows = []
    for agents in sizes:
        for interest in ("all", "neighbours"):
            if interest == "all" and agents > 200:
                continue  # grows with the square
            rows.append(_steady(crowd(agents, interest, ticks if agents < 2000 else ticks // 2), interest))
    for row in rows:
        row["of the smallest"] = row["ms per agent-round"] / next(
            first["ms per agent-round"] for first in rows if first["interest"] == row["interest"]
        )
    return rows


def _steady(scenario: Scenario, interest: str) -> Row:
    """The second half of a short run."""
    ticks, begun = scenario.run.ticks, time.process_time()
    simulation = Simulation(scenario, scores=False, build=Timed)
    marks: list[tuple[float, int, int, int]] = []
    half = ticks // 2
    alike: list[float] = []
    inside: list[int] = []

    def mark(truth: Truth) -> None:
        if truth.tick in (half, ticks - 1):
            marks.append((time.process_time(), simulation.bus.deliveries, simulation.bus.messages, simulation.bus.bytes))
        for agent in simulation.agents.values():
            assert isinstance(agent, Timed)
            if truth.tick > half and len(agent.neighbours.circle) in ALIKE:
                alike.append(agent.spent)
            agent.spent = 0.0
        if truth.tick == ticks - 1:
            x, y, _ = truth.poses.T
            far = np.minimum(np.minimum(x, y), np.minimum(scenario.arena.width - x, scenario.arena.height - y)) > INSIDE
            inside.extend(len(simulation.agents[name].neighbours.circle) for name in compress(truth.bodies, far.tolist()))

    simulation.on_truth = mark
    simulation.run()
    agents, rounds = len(scenario.members), len(scenario.members) * (ticks - 1 - half)
    spent, deliveries, messages, size = ((late - early) / rounds for early, late in zip(marks[0], marks[-1]))
    heard, known = (
        sum(len(group) for group in groups) / agents
        for groups in zip(*((agent.neighbours.circle, agent.neighbours.peers) for agent in simulation.agents.values()))
    )
    certified = sum(agent.neighbours.certified for agent in simulation.agents.values()) / agents
    return {
        "agents": agents,
        "interest": interest,
        "ms per agent-round": 1000.0 * spent,
        "ms if 26 to 33 are heard": 1000.0 * sum(alike) / len(alike) if alike else "",
        "us per gossip heard": 1e6 * spent / max(1.0, heard),
        "us per delivery": 1e6 * spent / deliveries,
        "deliveries": deliveries,
        "messages": messages,
        "bytes": size,
        "listened to": heard,
        "listened to inside": sum(inside) / len(inside) if inside else "",
        "known": known,
        "certified": certified,
        "start and first rounds, CPU s": marks[0][0] - begun,
    }
