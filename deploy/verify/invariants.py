"""Invariants: conditions after every event of a simulation under any fault, and conditions after all faults have ended."""

import itertools
import math
from collections import Counter, deque
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np

from agents.agent import Agent
from agents.gossip.round_inbox import WINDOW_TICKS, RoundInbox
from agents.round import RoundResult
from agents.tracking import gaussian_belief
from agents.tracking.belief import MOST_COPIES, owned_by_sender
from agents.tracking.gaussians import EMPTY, Mixture
from agents.tracking.particles import Particles, canonical, join
from deploy.simulation import Simulation
from deploy.verify.central_filter import CentralFilter, CentralMixture, mixture_difference, particle_difference, united
from protocol.geometry import polygon_area
from protocol.keys import all_of
from protocol.messages import Command, Gossip, Hello
from protocol.node import Alive, Effect, Event, Node, Received, Started, Subscribe
from protocol.observer_messages import Estimate, Truth

GENTLE = {"loss", "copies", "reorder", "freeze"}  # kinds of faults under which the cells hardly move apart
LOADS = ("starve", "freeze")  # kinds of overload, under which nobody dies
MOST_HOLE, MOST_OVERLAP = 0.03, 0.10  # mean shares of the arena in a case of gentle kinds
MASS_KEPT = {True: 0.01, False: 0.06}  # of the mass, in ledger mode after everything has healed: one kind of fault, several
MASS_KEPT_REDRAWN = {True: 0.15, False: 0.4}  # the same where every tick particles are new, or have new ids
SILENT_ROUNDS = 4  # that a silent peer stays a generator
LEAST_COMPARISONS = 3  # with the central filter in the calm end of a case
SLACK = 1.0 + 1e-9


class InvariantBroken(Exception):
    """An invariant does not hold."""


def need(condition: bool, what: str) -> None:
    """Raise `InvariantBroken` unless the condition holds."""
    if not condition:
        raise InvariantBroken(what)


class MessageCollector(Node):
    """A Node that hears all gossip, estimates and commands; only the newest ticks are kept."""

    role, name, incarnation = "recorder", "collector", 1

    def __init__(self, run: str) -> None:
        self.run = run
        self.gossips: dict[int, dict[str, Gossip]] = {}
        self.estimates: dict[int, dict[str, Estimate]] = {}
        self.commands: list[Command] = []

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Keep what is said."""
        if isinstance(event, Started):
            return [Subscribe(all_of(self.run, kind)) for kind in ("gossip", "estimate", "command")]
        if isinstance(event, Received):
            for message in event.batch.messages:
                if isinstance(message, Gossip):
                    self._keep(self.gossips, message.tick, message)
                elif isinstance(message, Estimate):
                    self._keep(self.estimates, message.tick, message)
                elif isinstance(message, Command):
                    self.commands.append(message)
        return []

    def deadline(self) -> float | None:
        """Never."""
        return None

    def _keep(self, table: dict[int, dict[str, Any]], tick: int, message: Any) -> None:
        table.setdefault(tick, {})[message.sender] = message
        while len(table) > 50:
            del table[min(table)]


class InvariantChecker:
    """Watches a simulation; `settled` is the world time from which on the swarm must be one again."""

    def __init__(self, simulation: Simulation, settled: float, is_ledger: bool, kinds: Collection[str]) -> None:
        self._simulation = simulation
        self._settled = round(settled / simulation.scenario.run.dt)
        self._kinds = kinds
        self._is_spoilt = "spoilt" in kinds  # wrong numbers may have got in, and stay
        self._is_ledger, self._is_gentle = is_ledger and not self._is_spoilt, set(kinds) <= GENTLE
        filters = simulation.scenario.filter
        renumbered = (
            filters.least_particles > 100 or filters.compact
        )  # in each tick, so that the id does not tell a copy from another particle
        self._mass_kept = (MASS_KEPT_REDRAWN if renumbered else MASS_KEPT)[len(kinds) <= 1]
        self._outcomes: dict[str, RoundResult] = {}
        self._newest: dict[tuple[str, int, str], int] = {}  # (name, incarnation, other's name) -> the youngest incarnation it has seen
        self._prints: dict[tuple[str, int], Fingerprint] = {}
        self._last: dict[tuple[str, int], dict[str, tuple[int, int]]] = {}  # incarnation and tick of the newest gossip of each peer
        self._rounds: dict[tuple[str, int], deque[tuple[int, int]]] = {}  # number and tick of the last rounds of each incarnation
        self._first_mass: float | None = None
        self._central_filter: CentralFilter | None = None
        self._central_mixture: CentralMixture | None = None
        self._comparisons = 0  # of a tick with the central filter
        self._collector = MessageCollector(simulation.scenario.run.name)
        simulation.bus.add(self._collector)
        simulation.bus.tap = self._after
        simulation.on_truth = self._on_truth

    def finish(self) -> None:
        """The run is over: liveness."""
        scores = self._simulation.scorer.scores
        need(len(scores) == self._simulation.scenario.run.ticks, f"only {len(scores)} ticks were scored")
        enough = self._comparisons >= LEAST_COMPARISONS or self._is_spoilt
        need(enough, f"{self._comparisons} comparisons with the central filter, not {LEAST_COMPARISONS}")
        for score in scores[self._settled :]:
            need(
                score.hole <= 1e-9 and score.overlap <= 1e-9,
                f"tick {score.tick}: hole {score.hole:.4f}, overlap {score.overlap:.4f} though healed",
            )
        if set(self._kinds) <= set(LOADS):
            given_up = sum(agent.peer_table.silence_timeouts for agent in self._simulation.agents.values())
            need(given_up == 0, f"{given_up} times a peer was given up though all were only late")
        if self._is_gentle:
            hole, overlap = float(np.mean([score.hole for score in scores])), float(np.mean([score.overlap for score in scores]))
            need(hole <= MOST_HOLE, f"mean hole {hole:.4f} though no agent was touched")
            need(overlap <= MOST_OVERLAP, f"mean overlap {overlap:.4f} though no agent was touched")

    # ------------------------------------------------------------------ after every event

    def _after(self, node: Node, event: Event) -> None:
        if not isinstance(node, Agent):
            return
        self._check_incarnations(node, event)
        label, outcome = f"{node.name}#{node.incarnation}", node.outcome
        before = self._outcomes.get(label, outcome)
        self._outcomes[label] = outcome
        if outcome is not before:
            check_round(node, is_first=before.belief.tick < 0)
            check_words(node)
            if outcome.belief.claim_tick == outcome.belief.tick:  # else a held belief, whose diagram is an older one
                check_diagram(node, self._silent_since(node))
            self._check_order(node)
        while self._collector.commands:
            self._check_command(self._collector.commands.pop())

    def _silent_since(self, agent: Agent) -> int:
        """The tick of the round that the agent played `SILENT_ROUNDS` rounds ago, or a later one; not every tick has a round."""
        number = agent.counters["rounds"]
        played = self._rounds.setdefault((agent.name, agent.incarnation), deque(maxlen=SILENT_ROUNDS + 1))
        played.append((number, agent.outcome.belief.tick))
        return min(tick for other, tick in played if other >= number - SILENT_ROUNDS)

    def _check_order(self, agent: Agent) -> None:
        """The newest gossip of a peer in closed rounds is never replaced by an older one of the same incarnation."""
        own, last = (agent.name, agent.incarnation), agent.peer_table.inbox.newest_closed
        for name, (incarnation, tick) in self._last.get(own, {}).items():
            gossip = last.get(name)
            goes_back = gossip is not None and gossip.incarnation == incarnation and gossip.tick < tick
            need(not goes_back, f"{agent.name}: after tick {tick} of {name} an older one counts as its newest")
        self._last[own] = {name: (gossip.incarnation, gossip.tick) for name, gossip in last.items()}

    def _check_incarnations(self, agent: Agent, event: Event) -> None:
        """A message of an incarnation older than one whose token was seen changes nothing.

        In a batch the other messages may change the agent: then what it holds of the old one's sender must be what it was.
        """
        own = agent.name, agent.incarnation
        if isinstance(event, Alive) and event.role == "agent":
            who = (*own, event.name)
            self._newest[who] = max(event.incarnation, self._newest.get(who, 0))
        if max(self._newest.values(), default=0) <= 1:
            return
        before, after = self._prints.get(own), fingerprint(agent)
        batch = event.batch.messages if isinstance(event, Received) else ()
        messages = [message for message in batch if isinstance(message, Gossip | Hello) and message.sender != agent.name]
        is_old = [(said.sender, said.incarnation < self._newest.get((*own, said.sender), 0)) for said in messages]
        others = {sender for sender, old in is_old if not old}
        alone = not others and len(is_old) == len(batch)
        for sender in {sender for sender, old in is_old if old} - others:
            same = before is None or (after == before if alone else after.of(sender) == before.of(sender))
            need(same, f"{agent.name}: a message of an old incarnation of {sender} changed its state")
        self._prints[own] = after

    def _check_command(self, command: Command) -> None:
        limits = self._simulation.scenario.limits
        speed = math.hypot(*command.velocity)
        need(speed <= limits.speed * SLACK, f"{command.sender} wants to move at {speed} m/s")
        need(abs(command.turn_rate) <= limits.turn_rate * SLACK, f"{command.sender} wants to turn at {command.turn_rate} rad/s")

    # ------------------------------------------------------------------ after every tick

    def _on_truth(self, truth: Truth) -> None:
        """A tick of the world begins: the one before last is complete."""
        tick = truth.tick - 2
        estimates = self._collector.estimates.get(tick, {})
        if self._first_mass is None and tick >= 0:
            self._first_mass = math.fsum(estimate.mass for estimate in estimates.values())
        if tick < self._settled:
            return
        self._check_unity(tick, estimates)
        self._compare(tick)

    def _check_unity(self, tick: int, estimates: dict[str, Estimate]) -> None:
        """All live agents, one of each name, have played the tick and cut the same diagram; in ledger mode nothing has been lost."""
        alive = set(self._simulation.injector.alive())
        names = Counter(agent.name for agent in self._simulation.agents.values())
        need(len(names) == names.total(), f"tick {tick}: {sorted(name for name in names if names[name] > 1)} live twice though healed")
        need(alive == set(estimates), f"tick {tick}: alive are {sorted(alive)}, but {sorted(estimates)} have played")
        hashes = {estimate.diagram_hash for estimate in estimates.values()}
        need(len(hashes) == 1, f"tick {tick}: {len(hashes)} different diagrams though healed")
        for agent in self._simulation.agents.values():
            need(
                agent.outcome.belief.generator_names == alive,
                f"{agent.name} believes that {sorted(agent.outcome.belief.generator_names)} are alive",
            )
        if self._is_ledger and self._first_mass:
            kept = math.fsum(estimate.mass for estimate in estimates.values()) / self._first_mass
            need(abs(kept - 1.0) <= self._mass_kept, f"tick {tick}: {kept:.4f} of the mass though healed")

    def _compare(self, tick: int) -> None:
        """From the settled tick on the agents are the central filter that starts from what they own."""
        following = self._collector.gossips.get(tick + 1, {})
        stated = {name: said for name, said in following.items() if said.claim_names}
        if self._simulation.scenario.filter.kind == "gaussian-mixture":
            self._compare_mixtures(tick, stated)
            return
        told = {name: owned_by_sender(said) for name, said in stated.items()}
        owned = united({name: each.targets for name, each in told.items()})
        if len(np.unique(owned.ids)) < len(owned.ids):
            need(self._is_spoilt, f"tick {tick}: a particle is owned by two agents though healed")
            self._central_filter = None
            return
        if self._central_filter is None:
            self._central_filter = CentralFilter(self._simulation.injector.scenario, owned, tick)
            return
        self._central_filter.play(self._collector.gossips[tick], {name: each.claim for name, each in told.items()})
        apart = particle_difference(owned, self._central_filter.particles)
        need(apart.exact, f"tick {tick}: not the central filter: {apart}")
        self._comparisons += 1

    def _compare_mixtures(self, tick: int, stated: dict[str, Gossip]) -> None:
        """The same of Gaussian mixtures, to the last bit."""
        told = {name: gaussian_belief.owned_by_sender(said) for name, said in stated.items()}
        owned = join([EMPTY, *(each.targets for each in told.values())])
        if len(np.unique(owned.ids)) < len(owned.ids):
            need(self._is_spoilt, f"tick {tick}: a component is owned by two agents though healed")
            self._central_mixture = None
            return
        if self._central_mixture is None:
            self._central_mixture = CentralMixture(self._simulation.injector.scenario, canonical(owned), tick)
            return
        self._central_mixture.play(self._collector.gossips[tick], {name: each.claim for name, each in told.items()})
        apart = mixture_difference(canonical(owned), self._central_mixture.mixture)
        need(apart == 0.0, f"tick {tick}: not the central mixture: {apart}")
        self._comparisons += 1


def check_round(agent: Agent, is_first: bool) -> None:
    """What must hold of an agent whenever it has played a round."""
    outcome, name = agent.outcome, agent.name
    belief = outcome.belief
    owned: Particles | Mixture = belief.mine.targets
    near: Particles | Mixture
    if isinstance(owned, Particles):
        near, states = belief.copies.near, [owned.states]
    else:
        near, states = belief.copies, [owned.means, owned.covariances]
    need(all(bool(np.all(np.isfinite(numbers))) for numbers in states), f"{name}: a part of the PHD that is nowhere")
    need(bool(np.all(np.isfinite(owned.weights)) and np.all(owned.weights >= 0.0)), f"{name}: a weight that is no mass")
    need(bool(np.all(owned.ids[1:] > owned.ids[:-1])), f"{name}: ids that do not ascend")
    need(len(np.unique(near.ids)) == len(near.ids), f"{name}: a part of the PHD that counts twice")
    need(math.isfinite(outcome.mass) and outcome.mass >= 0.0, f"{name}: a mass of {outcome.mass}")
    need(math.isfinite(outcome.load) and outcome.load >= 0.0, f"{name}: a load of {outcome.load}")
    need(0.0 <= outcome.unused <= agent.context.announced.facts.capability * SLACK, f"{name}: an unused capacity of {outcome.unused}")
    need(bool(np.all(np.isfinite(outcome.estimates.positions))), f"{name}: a target that is nowhere")
    arena = agent.config.arena
    need(polygon_area(outcome.cell) <= arena.width * arena.height * SLACK, f"{name}: a cell larger than the arena")
    need(not (is_first and outcome.belief.tick > 0 and belief.mine.claim.names), f"{name}: a newcomer with a cell before it has listened")
    ticks = Counter(itertools.chain.from_iterable(agent.peer_table.inbox.rounds.values()))
    need(max(ticks.values(), default=0) <= 2 * WINDOW_TICKS, f"{name}: a queue of {max(ticks.values(), default=0)} ticks of a peer")
    need(len(near.ids) <= 4 * MOST_COPIES, f"{name}: {len(near.ids)} copies")


def check_words(agent: Agent) -> None:
    """The inputs of the newest round are finite numbers, and no capacity exceeds the largest announced one.

    One bad float could win every cell.
    """
    carried = [peer.announced for peer in agent.peer_table.peers.values() if peer.announced is not None]
    most = SLACK * max([agent.context.announced.facts.capability, *(announced.facts.capability for announced in carried)])
    for name, gossip in agent.peer_table.inbox.newest_closed.items():
        if gossip.tick == agent.outcome.belief.tick:
            numbers = (*gossip.pose, *gossip.cod, gossip.power_radius, gossip.unused, gossip.weight)
            need(all(map(math.isfinite, numbers)) and gossip.weight >= 0.0, f"{agent.name}: believes {numbers} of {name}")
            need(bool(np.all(np.isfinite(gossip.states))), f"{agent.name}: took a particle that is nowhere from {name}")
            need(math.pi * gossip.power_radius**2 <= most, f"{agent.name}: believes a power radius of {gossip.power_radius} of {name}")


def check_diagram(agent: Agent, since: int) -> None:
    """Every live peer that was heard in the tick `since` or later has a generator (`PeerTable.generators`)."""
    belief, peer_table = agent.outcome.belief, agent.peer_table
    for name, peer in peer_table.interest_set.items():
        last = peer_table.inbox.newest_closed.get(name)
        if last is None or last.incarnation != peer.incarnation or last.listening or not peer.token or peer.is_gone:
            continue
        need(
            last.tick < since or name in belief.generator_names,
            f"{agent.name}: {name} is alive, was heard at {last.tick}, no generator at {belief.tick}",
        )


class Identity:
    """An object that equals itself alone; it is kept here, so that no other one gets its address."""

    def __init__(self, thing: object) -> None:
        self._thing = thing

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Identity) and self._thing is other._thing


class Fingerprint(NamedTuple):
    """Everything about an agent that a message could change, but for the counters."""

    tick: int
    outcome: Identity
    peers: dict[str, tuple[Any, ...]]  # what it knows of each peer
    held: dict[str, tuple[object, ...]]  # what it holds of each peer's gossips

    def of(self, name: str) -> tuple[Any, ...]:
        """The part that is about one peer."""
        return self.peers.get(name), self.held.get(name)


def fingerprint(agent: Agent) -> Fingerprint:
    """The print of an agent; taking it changes nothing about how the agent keeps its gossips."""
    peer_table = agent.peer_table
    peers = {
        name: (peer.incarnation, peer.token, peer.refused_until, peer.silent_rounds, Identity(peer.announced), peer.suspected, peer.differs)
        for name, peer in peer_table.peers.items()
    }
    return Fingerprint(agent.tick, Identity(agent.outcome), peers, held(peer_table.inbox))


def held(inbox: RoundInbox) -> dict[str, tuple[object, ...]]:
    """What is kept of each peer's gossips, as values to compare."""
    found: dict[str, list[object]] = {}
    for tick, gossips in inbox.rounds.items():
        for name, gossip in gossips.items():
            found.setdefault(name, []).append((tick, Identity(gossip)))
    for name, gossip in inbox.newest_closed.items():
        found.setdefault(name, []).append((gossip.incarnation, gossip.tick))
    return {name: tuple(values) for name, values in found.items()}
