"""Small swarms for the tests: scenarios, and what is written down after every tick of a run."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec

from agents.agent import Agent
from agents.backend import Backend
from deploy.scenario import FaultSettings, Scenario, resolve
from deploy.scoring.result import Result
from deploy.simulation import Simulation
from protocol.keys import all_of
from protocol.node import Effect, Event, Node, Started, Subscribe, messages_of
from protocol.observer_messages import Estimate

LATE = 8  # ticks; who wakes from a long sleep still says what it made of the last thing it was told
BLIND = {"angle": 240.0, "radius": 8.0, "prob_detection": 1e-12}


def fault(at: float, verb: str, who: str = "", value: float | None = None, seconds: float | None = None, **options: Any) -> FaultSettings:
    return FaultSettings(at=at, verb=verb, who=who, value=value, seconds=seconds, options=options)


def tracking(*faults: FaultSettings, team: str = "A2,C3,D2", side: float = 40.0, targets: int = 6, **settings: Any) -> Scenario:
    """A swarm that tracks; settings as section__field."""
    options = {"team.composition": team, "targets.count": targets, "arena.width": side, "arena.height": side, "run.seconds": 20.0}
    scenario = resolve("efficacy", options | {name.replace("__", "."): value for name, value in settings.items()})
    return msgspec.structs.replace(scenario, faults=faults)


def ledger(*faults: FaultSettings, agents: int = 8, side: float = 40.0, **settings: Any) -> Scenario:
    """A swarm whose mass must not change: nothing is born, nothing dies or leaves, and sensors that see nothing return nothing."""
    quiet = {"filter__lifetime": 0.0, "filter__border": "reflect", "filter__prior_density": 0.01, "birth__background": False}
    quiet |= {"birth__measurement": False, "detection__clutter": 0.0, "sensors__L": BLIND}
    return tracking(*faults, team=f"L{agents}", side=side, targets=0, **(quiet | settings))


@dataclass
class Listener(Node):
    """A Node that keeps all estimates by tick and sender, but for those that come when the others are long past that tick."""

    run: str
    name: str = "listener"
    role: str = "recorder"
    incarnation: int = 1
    estimates: dict[int, dict[str, Estimate]] = field(default_factory=dict)

    def handle(self, event: Event, now: float) -> list[Effect]:
        if isinstance(event, Started):
            return [Subscribe(all_of(self.run, "estimate"))]
        for said in messages_of(event):
            if isinstance(said, Estimate) and said.tick >= max(self.estimates, default=0) - LATE:
                self.estimates.setdefault(said.tick, {})[said.sender] = said
        return []

    def deadline(self) -> float | None:
        return None


@dataclass
class Watched:
    """A run, tick by tick."""

    simulation: Simulation
    result: Result
    masses: list[float]  # of all that the agents own after each tick, expected targets
    views: list[int]  # how many different views the agents have
    living: list[list[str]]  # who has played the tick
    holes: list[float]
    overlaps: list[float]

    @property
    def agents(self) -> dict[str, Agent]:
        return self.simulation.agents

    def at(self, time: float) -> int:
        """The tick of a time."""
        return round(time / self.simulation.scenario.run.dt)


def watch(
    scenario: Scenario,
    *,
    backend: Backend | None = None,
    clock: Literal["lockstep", "realtime"] = "lockstep",
    at_tick: Callable[[int, Simulation], None] = lambda tick, simulation: None,
) -> Watched:
    """Play a scenario; `at_tick` is called with every tick of the world that begins."""
    simulation = Simulation(scenario, backend=backend, clock=clock)
    listener = Listener(scenario.run.name)
    simulation.bus.add(listener)
    simulation.on_truth = lambda truth: at_tick(truth.tick, simulation)
    result = simulation.run()
    said = [list(listener.estimates.get(tick, {}).values()) for tick in range(scenario.run.ticks)]
    return Watched(
        simulation,
        result,
        masses=[sum(estimate.mass for estimate in found) for found in said],
        views=[len({estimate.diagram_hash for estimate in found}) for found in said],
        living=[sorted(estimate.sender for estimate in found) for found in said],
        holes=[score.hole for score in simulation.scorer.scores],
        overlaps=[score.overlap for score in simulation.scorer.scores],
    )
