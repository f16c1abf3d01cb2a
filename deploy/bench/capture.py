"""Real inputs of rounds: what the agents of a simulation had in hand when they closed the rounds of one tick."""

from dataclasses import dataclass, field
from typing import NamedTuple

from agents.membership.peer_table import PeerTable
from agents.round import AgentContext, RoundResult
from deploy.scenario import Scenario
from deploy.simulation import Simulation
from protocol import codec
from protocol.keys import all_of, message_key, order
from protocol.messages import Gossip
from protocol.node import Effect, Event, Node, Started, Subscribe, messages_of
from protocol.observer_messages import Truth


class Captured(NamedTuple):
    """One round of one agent: all that `agents.round.run_round` takes."""

    me: AgentContext
    last: RoundResult
    peer_table: PeerTable
    mine: Gossip
    heard: dict[str, Gossip]


@dataclass
class GossipCollector(Node):
    """A Node that keeps the gossip of one tick."""

    run: str
    tick: int
    name: str = "collector"
    role: str = "recorder"
    incarnation: int = 1
    gossips: dict[str, Gossip] = field(default_factory=dict)

    def handle(self, event: Event, now: float) -> list[Effect]:
        if isinstance(event, Started):
            return [Subscribe(all_of(self.run, "gossip"))]
        for message in messages_of(event):
            if isinstance(message, Gossip) and message.tick == self.tick:
                self.gossips[message.sender] = message
        return []

    def deadline(self) -> float | None:
        return None


def capture(scenario: Scenario, tick: int) -> list[Captured]:
    """The rounds of `tick` of all agents of a run without faults."""
    simulation, lasts = Simulation(scenario), dict[str, RoundResult]()
    collector = GossipCollector(scenario.run.name, tick)
    simulation.bus.add(collector)

    def on_truth(truth: Truth) -> None:
        if truth.tick == tick:
            lasts.update((name, agent.outcome) for name, agent in simulation.agents.items())

    simulation.on_truth = on_truth
    while not simulation.done and all(agent.tick <= tick for agent in simulation.agents.values()):
        simulation.bus.step()
    names = sorted(collector.gossips, key=order)
    rounds = []
    for name, agent in simulation.agents.items():
        heard = {other: collector.gossips[other] for other in names if other != name and other in agent.peer_table.peers}
        rounds.append(Captured(agent.context, lasts[name], agent.peer_table, collector.gossips[name], heard))
    return rounds


def cold(rounds: list[Captured]) -> list[Captured]:
    """The same rounds as processes of their own would play them: nothing that was derived from a message is remembered."""
    return [
        captured._replace(
            mine=_again(captured.mine, captured.me.config.run.name),
            heard={name: _again(gossip, captured.me.config.run.name) for name, gossip in captured.heard.items()},
        )
        for captured in rounds
    ]


def _again(gossip: Gossip, run: str) -> Gossip:
    """The gossip as it comes from the wire, unread."""
    message = codec.decode(message_key(run, gossip), codec.encode(gossip))
    assert isinstance(message, Gossip)
    return message
