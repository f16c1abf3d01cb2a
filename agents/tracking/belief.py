"""The replicated PHD: what one agent holds, and how it merges what the others say they own.

The owner of a cell is the authority for what is in it; everybody else keeps copies and moves them with the same keyed noise. A
belief is stamped with the tick of the round after which it holds. Nothing is ever handed over: a particle that crosses a border
lands in exactly one cell, and the particles of a dead agent live on in the copies (docs/journey.md).
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

MOST_COPIES = 6000  # a backstop against growth without bound: so many copies,
MOST_TIMES = 4.0  # or so many times what a fresh draw of their mass would have


def share_of(gossip: Gossip) -> OwnedState:
    """What a gossip says its sender owns."""
    names = gossip.claim_names
    claim = make_claim(names, gossip.claim, tuple(order(name) for name in names)) if names else NO_CLAIM
    particles = Particles(gossip.states.astype(float), np.full(len(gossip.ids), gossip.weight), gossip.ids)
    return OwnedState(gossip.sender, claim, particles, gossip.view)


class Round(NamedTuple):
    """What a round knew of the particles outside the own cell, as far as copies are made of it."""

    step: Step
    backend: Backend
    received: GossipTable | Particles  # everything that counted, one tick before
    polygon: np.ndarray  # the own cell
    claim: Claim
    horizon: float = math.inf  # m from the cell: copies farther away are given up


@dataclass
class Copies:
    """What an agent holds of what others own, after a round.

    `near` is what it corrected around its own cell. The rest is what it received in that round, one step on: it is only computed
    when somebody falls silent, because fresh claims replace it otherwise.
    """

    near: Particles
    round: Round | None = None

    def all(self) -> Particles:
        """Every copy, at the stamp of the belief."""
        if self.round is not None:
            step, backend, received, polygon, claim, horizon = self.round
            copies = backend.remote_copies(self.near, received_particles(received), polygon, claim, horizon, step)
            self.near, self.round = worth_keeping(copies, step.config.filter.particles_per_target), None
        return self.near


def worth_keeping(copies: Particles, per_target: int) -> Particles:
    """All copies; the heaviest if they are more than `MOST_COPIES` and than `MOST_TIMES` as many as their mass is drawn with, at
    `per_target` for an expected target. Whatever the number of targets, only what is much lighter than a drawn particle is given up."""
    most = max(MOST_COPIES, math.ceil(MOST_TIMES * per_target * float(copies.weights.sum())))
    if len(copies.weights) <= most:
        return copies
    heaviest = np.argsort(-copies.weights, kind="stable")[:most]
    return select(copies, np.sort(heaviest))


@dataclass
class Belief:
    """An agent's belief after the round `stamp`: what it owns, and its copies of everything else."""

    stamp: int
    mine: OwnedState
    copies: Copies
    everyone: frozenset[str] = frozenset()  # whose generators made the diagram that `mine` was cut from
    acquainted: frozenset[str] | None = None  # which others it knew then, if it hears only a part of all


def start(prior: Particles, name: str) -> Belief:
    """The belief before the first round: everybody holds the prior, nobody owns anything."""
    return Belief(stamp=-1, mine=OwnedState(name, NO_CLAIM, NONE, 0), copies=Copies(prior))


class ParticlePhd(NamedTuple):
    """The particle PHD as a `Tracker`."""

    backend: Backend

    def predict(self, belief: Belief, step: Step) -> Belief:
        """See `Tracker`: all particles become copies, and are moved by the keyed noise of the missed ticks."""
        if belief.stamp >= step.tick - 1:
            return belief
        particles = canonical(join([belief.mine.particles, belief.copies.all()]))
        for missed in range(belief.stamp + 1, step.tick):
            particles = predict(particles, step._replace(tick=missed))
        return Belief(step.tick - 1, OwnedState(belief.mine.owner, NO_CLAIM, NONE, 0), Copies(particles))

    def merge(self, belief: Belief, table: GossipTable, step: Step) -> GossipTable | Particles:
        """Everything at `belief.stamp` that counts, given all gossips of the tick, the own one included; an id may occur twice.

        Copies count where no fresh claim lies. Where two claims overlap (the views differed), both count within `timing.overlap` m
        of the border, and deeper the smaller power distance wins. When all cut the same diagram their claims tile the arena; an
        agent that was unknown has cut another one, no matter which view it states.
        """
        # A diagram of nobody, which all newcomers share, claims nothing: their copies count.
        strangers = set() if belief.acquainted is None else table.everyone - belief.acquainted - {belief.mine.owner}
        last, config = step.tick - 1, step.config
        agreed = belief.mine.view != 0 and table.claimed == (last, belief.mine.view) and not strangers
        if agreed and belief.everyone and belief.everyone <= table.everyone:
            return table
        shares = [share_of(gossip) for gossip in table.gossips if gossip.claim_tick == last and gossip.sender != belief.mine.owner]
        shares.insert(0, belief.mine)
        claims = end_to_end([share.claim for share in shares])
        views = [~share.view if share.owner in strangers else share.view for share in shares]
        received, sizes = join([share.particles for share in shares]), [len(share.particles.ids) for share in shares]
        kept = self.backend.resolve_conflicts(received.states, sizes, claims, views, config.timing.overlap)
        copies = belief.copies.all()
        free = self.backend.orphaned(copies.states, claims, config.arena)
        return self.backend.merge(received, kept, copies, free)

    def update(
        self, received: GossipTable | Particles, table: GossipTable, regions: Sequence[RegionInput], step: Step
    ) -> list[RegionUpdate]:
        """See `regions.update_regions`."""
        return self.backend.update_regions(table, received, self.backend.background_births(step), regions, step)

    def share(self, received: GossipTable | Particles, region: RegionInput, update: RegionUpdate, diagram: Diagram, step: Step) -> Belief:
        """See `Tracker`: the drawn particles are owned; the copies are made of the rest when somebody falls silent."""
        copies = Copies(update.updated, Round(step, self.backend, received, region.polygon, region.claim, diagram.horizon))
        mine = OwnedState(region.owner, region.claim, update.kept, diagram.view)
        return Belief(step.tick, mine, copies, diagram.everyone, diagram.acquainted)
