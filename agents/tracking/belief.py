"""The replicated PHD: the belief of one agent, and its merge with the particles that other agents own.

Data types: `Belief` holds the owned state and the `Copies` of all other particles; `ParticlePhd` is the `Tracker` of them.

Rules. The owner of a cell is the authority for the particles in it. All other agents keep copies and move them with the same keyed
noise. A belief is stamped with the tick of its last round. No particle is handed over: a particle that crosses a border lands in
exactly one cell, and the particles of a dead agent live on in the copies (docs/journey.md).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agents.backend import Backend
from agents.gossip.table import GossipTable, received_particles
from agents.tracking.claims import NO_CLAIM, Claim, end_to_end, make_claim
from agents.tracking.particles import NONE, Particles, canonical, join, select
from agents.tracking.regions import RegionUpdate, predict
from agents.tracking.step import Step
from agents.tracking.tracker import Diagram, OwnedState, RegionInput
from protocol.keys import order
from protocol.messages import Gossip

MOST_COPIES = 6000  # limit against growth without bound: this number of copies,
MOST_TIMES = 4.0  # or this many times the number in a fresh draw of the same mass, if that is more


def share_of(gossip: Gossip) -> OwnedState:
    """The state that the sender of a gossip owns."""
    names = gossip.claim_names
    claim = make_claim(names, gossip.claim, tuple(order(name) for name in names)) if names else NO_CLAIM
    particles = Particles(gossip.states.astype(float), np.full(len(gossip.ids), gossip.weight), gossip.ids)
    return OwnedState(gossip.sender, claim, particles, gossip.view)


class Round(NamedTuple):
    """The inputs of a round from which the copies outside the own cell are computed."""

    step: Step
    backend: Backend
    received: GossipTable | Particles  # the particles that counted, one tick before
    polygon: np.ndarray  # the own cell
    claim: Claim
    horizon: float = math.inf  # m from the cell: copies farther away are dropped


@dataclass
class Copies:
    """The particles that an agent holds after a round and that other agents own.

    `near` holds the corrected particles around the own cell. The others are the received particles of that round, moved by one step.
    They are computed only when a peer falls silent: otherwise fresh claims replace them.
    """

    near: Particles
    round: Round | None = None

    def all(self) -> Particles:
        """All copies, at the stamp of the belief."""
        if self.round is not None:
            step, backend, received, polygon, claim, horizon = self.round
            copies = backend.remote_copies(self.near, received_particles(received), polygon, claim, horizon, step)
            self.near, self.round = worth_keeping(copies, step.config.filter.particles_per_target), None
        return self.near


def worth_keeping(copies: Particles, per_target: int) -> Particles:
    """The copies, or only the heaviest of them if they exceed both limits.

    The limits are `MOST_COPIES`, and `MOST_TIMES` the size of a fresh draw of their mass with `per_target` particles for an expected
    target. Only copies much lighter than a drawn particle are dropped, for any number of targets.
    """
    most = max(MOST_COPIES, math.ceil(MOST_TIMES * per_target * float(copies.weights.sum())))
    if len(copies.weights) <= most:
        return copies
    heaviest = np.argsort(-copies.weights, kind="stable")[:most]
    return select(copies, np.sort(heaviest))


@dataclass
class Belief:
    """The belief of an agent after the round of tick `stamp`: its owned state, and copies of all other particles."""

    stamp: int
    mine: OwnedState
    copies: Copies
    everyone: frozenset[str] = frozenset()  # the agents with a generator in the diagram of `mine`
    acquainted: frozenset[str] | None = None  # the agents known in that round; None if the agent receives all gossips


def start(prior: Particles, name: str) -> Belief:
    """The belief before the first round: copies of the prior, and no owned particle."""
    return Belief(stamp=-1, mine=OwnedState(name, NO_CLAIM, NONE, 0), copies=Copies(prior))


class ParticlePhd(NamedTuple):
    """The particle PHD as a `Tracker`."""

    backend: Backend

    def predict(self, belief: Belief, step: Step) -> Belief:
        """See `Tracker.predict`: all particles become copies, and move by the keyed noise of the missed ticks."""
        if belief.stamp >= step.tick - 1:
            return belief
        particles = canonical(join([belief.mine.particles, belief.copies.all()]))
        for missed in range(belief.stamp + 1, step.tick):
            particles = predict(particles, step._replace(tick=missed))
        return Belief(step.tick - 1, OwnedState(belief.mine.owner, NO_CLAIM, NONE, 0), Copies(particles))

    def merge(self, belief: Belief, table: GossipTable, step: Step) -> GossipTable | Particles:
        """The particles that count at `belief.stamp`, or the table itself when only its particles count; there an id may occur twice.

        `table` holds all gossips of the tick, the own one included. Copies count outside all fresh claims. Two claims overlap when
        their views differ: within `timing.overlap` m of the border the particles of both count, and deeper inside the smaller power
        distance wins. Agents with the same diagram have claims that tile the arena. An unknown agent has cut another diagram, even
        if it states the same view.
        """
        # All newcomers share the view of an empty diagram. It claims nothing, so that their copies count.
        unknown = set() if belief.acquainted is None else table.everyone - belief.acquainted - {belief.mine.owner}
        last, config = step.tick - 1, step.config
        agreed = belief.mine.view != 0 and table.claimed == (last, belief.mine.view) and not unknown
        if agreed and belief.everyone and belief.everyone <= table.everyone:
            return table
        shares = [share_of(gossip) for gossip in table.gossips if gossip.claim_tick == last and gossip.sender != belief.mine.owner]
        shares.insert(0, belief.mine)
        claims = end_to_end([share.claim for share in shares])
        views = [~share.view if share.owner in unknown else share.view for share in shares]
        received, sizes = join([share.particles for share in shares]), [len(share.particles.ids) for share in shares]
        kept = self.backend.resolve_conflicts(received.states, sizes, claims, views, config.timing.overlap)
        copies = belief.copies.all()
        free = self.backend.orphaned(copies.states, claims, config.arena)
        return self.backend.merge(received, kept, copies, free)

    def update(
        self, received: GossipTable | Particles, table: GossipTable, regions: Sequence[RegionInput], step: Step
    ) -> list[RegionUpdate]:
        """See `Tracker.update` and `regions.update_regions`."""
        return self.backend.update_regions(table, received, self.backend.background_births(step), regions, step)

    def share(self, received: GossipTable | Particles, region: RegionInput, update: RegionUpdate, diagram: Diagram, step: Step) -> Belief:
        """See `Tracker.share`: the drawn particles are owned; the copies are computed when a peer falls silent."""
        copies = Copies(update.updated, Round(step, self.backend, received, region.polygon, region.claim, diagram.horizon))
        mine = OwnedState(region.owner, region.claim, update.kept, diagram.view)
        return Belief(step.tick, mine, copies, diagram.everyone, diagram.acquainted)
