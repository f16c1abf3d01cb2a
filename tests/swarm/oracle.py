"""A virtual run beside the central filter: after every tick, how far the agents' own particles are from it."""

from dataclasses import dataclass, field

from agents.agent import Agent
from agents.backend import PLAIN, Backend
from agents.tracking.claims import Claim
from agents.tracking.extraction import estimate_targets
from agents.tracking.particles import Particles
from deploy.scenario import Scenario
from deploy.simulation import Simulation
from deploy.verify.central_filter import CentralFilter, ParticleDifference, particle_difference, united
from protocol.keys import all_of
from protocol.messages import Gossip
from protocol.node import Effect, Event, Node, Started, Subscribe, messages_of
from protocol.observer_messages import Truth
from protocol.virtual import Link
from world.score import ospa


@dataclass
class Eavesdropper(Node):
    """A Node that keeps all gossip by tick and sender."""

    run: str
    name: str = "eavesdropper"
    role: str = "recorder"
    incarnation: int = 1
    gossips: dict[int, dict[str, Gossip]] = field(default_factory=dict)

    def handle(self, event: Event, now: float) -> list[Effect]:
        if isinstance(event, Started):
            return [Subscribe(all_of(self.run, "gossip"))]
        for message in messages_of(event):
            if isinstance(message, Gossip):
                self.gossips.setdefault(message.tick, {})[message.sender] = message
        return []

    def deadline(self) -> float | None:
        return None


def owned_by_all(agents: dict[str, Agent], tick: int) -> tuple[dict[str, Particles], dict[str, Claim]]:
    """What the agents own after round `tick`, and the claims in which they own it, by name."""
    stated = {name: agent.outcome.belief.mine for name, agent in agents.items() if agent.outcome.belief.tick == tick}
    return {name: each.targets for name, each in stated.items()}, {name: each.claim for name, each in stated.items()}


@dataclass
class Beside:
    """A virtual run with the central filter beside it; `run` plays it."""

    scenario: Scenario
    backend: Backend = PLAIN
    link: Link | None = None
    distances: list[ParticleDifference] = field(default_factory=list)  # of the agents' own particles from the filter's, after each tick
    swarm: list[float] = field(default_factory=list)  # OSPA of what the agents report, m, by tick
    central: list[float] = field(default_factory=list)  # OSPA of what is extracted from the whole filter at once, m, by tick

    def run(self) -> "Beside":
        """Play all ticks; returns itself."""
        simulation = Simulation(self.scenario, link=self.link, backend=self.backend)
        ear = Eavesdropper(self.scenario.run.name)
        simulation.bus.add(ear)
        agents = simulation.agents
        heard: list[Truth] = []
        prior = next(iter(agents.values())).outcome.belief.copies.compute()
        oracle = CentralFilter(simulation.scenario, prior, backend=self.backend)

        def after(truth: Truth) -> None:
            particles, claims = owned_by_all(agents, truth.tick)
            oracle.play(ear.gossips.pop(truth.tick), claims)
            self.distances.append(particle_difference(united(particles), oracle.particles))
            estimates = estimate_targets(oracle.updated, self.scenario.extraction).positions
            self.central.append(ospa(truth.targets, estimates))

        def on_truth(truth: Truth) -> None:
            if heard:
                after(heard.pop())
            heard.append(truth)

        simulation.on_truth = on_truth
        simulation.run()
        after(heard.pop())
        self.swarm = [score.ospa for score in simulation.scorer.scores]
        return self


def compare(scenario: Scenario, *, backend: Backend = PLAIN, link: Link | None = None) -> list[ParticleDifference]:
    """The distance of the swarm from the oracle after every tick of a run."""
    return Beside(scenario, backend, link).run().distances
