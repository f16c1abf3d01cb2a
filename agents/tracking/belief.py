"""The replicated PHD: the belief of one agent, and its merge with the particles that other agents own.

Data types: a `Belief` holds owned `Particles` and the `Copies` of all other particles; `ParticlePhd` is the `Tracker` of them.

Rules. The owner of a cell is the authority for the particles in it. All other agents keep copies and move them with the same keyed
noise. A belief is stamped with the tick of its last round. No particle is handed over: a particle that crosses a border lands in
exactly one cell, and the particles of a dead agent live on in the copies (docs/explanation/journey.md).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from typing import Any, NamedTuple

import numpy as np

from agents.backend import Backend
from agents.config import AgentConfig, FilterSettings
from agents.gossip.table import GossipTable, as_particles
from agents.tracking.births import prior, prior_around, prior_size
from agents.tracking.claims import Claim, make_claim
from agents.tracking.merge import merge
from agents.tracking.particles import NO_PARTICLES, WIRE_TYPE, Particles, canonical, join, select
from agents.tracking.phd import predict
from agents.tracking.step import Step
from agents.tracking.tracker import (
    Belief,
    KnownDiagram,
    OwnedState,
    RegionInput,
    RegionUpdate,
    belief_without_claim,
    claims_tile_arena,
    missed_steps,
    unknown_senders,
)
from protocol.compact_particles import packed, quantised
from protocol.fields import pack, pack_labels
from protocol.messages import Gossip

MOST_COPIES = 6000  # limit against growth without bound: this number of copies,
MOST_COPIES_PER_DRAWN = 4.0  # or this many times the number in a fresh draw of the same mass, if that is more


@lru_cache(maxsize=256)
def owned_by_sender(gossip: Gossip) -> OwnedState:
    """The state that the sender of a gossip owns; a pure memo, because all listeners of a process read the same gossip."""
    particles = Particles(gossip.states.astype(float), np.full(len(gossip.ids), gossip.weight), gossip.ids, gossip.labels)
    return OwnedState(gossip.sender, make_claim(gossip.claim_names, gossip.claim), particles, gossip.diagram_hash)


class CopyInputs(NamedTuple):
    """The inputs of a round from which the copies outside the own cell are computed."""

    step: Step
    backend: Backend
    density: GossipTable | Particles  # the particles that counted, one tick before
    polygon: np.ndarray  # the own cell
    claim: Claim
    copy_distance: float = math.inf  # m from the cell: copies farther away are dropped


@dataclass
class Copies:
    """The particles that an agent holds after a round and that other agents own.

    `near` holds the corrected particles around the own cell. The others are those that counted before that round, moved by one step.
    They are computed only when the fresh claims may not cover the arena: otherwise the particles of these claims replace them.
    """

    near: Particles
    inputs: CopyInputs | None = None
    skipped_steps: tuple[Step, ...] = ()  # the steps of skipped rounds, in which the copies only move

    def compute(self) -> Particles:
        """Compute the copies that are still to be computed; return all of them, at the tick of the belief."""
        if self.inputs is not None:
            step, backend, density, polygon, claim, copy_distance = self.inputs
            copies = backend.remote_copies(self.near, as_particles(density), polygon, claim, copy_distance, step)
            self.near, self.inputs = worth_keeping(copies, step.config.filter.particles_per_target), None
        self.near, self.skipped_steps = reduce(predict, self.skipped_steps, self.near), ()
        return self.near


def worth_keeping(copies: Particles, per_target: int) -> Particles:
    """The copies, or only the heaviest of them if they exceed both limits.

    The limits are `MOST_COPIES`, and `MOST_COPIES_PER_DRAWN` times the size of a fresh draw of their mass with `per_target` particles for
    an expected target. Only copies much lighter than a drawn particle are dropped, for any number of targets.
    """
    most = max(MOST_COPIES, math.ceil(MOST_COPIES_PER_DRAWN * per_target * float(copies.weights.sum())))
    if len(copies.weights) <= most:
        return copies
    heaviest = np.argsort(-copies.weights, kind="stable")[:most]
    return select(copies, np.sort(heaviest))


def _without_claim(belief: Belief) -> Belief:
    """The belief without a claim: all particles are copies."""
    particles = canonical(join([belief.mine.targets, belief.copies.compute()]))
    return belief_without_claim(belief.mine.owner, belief.tick, NO_PARTICLES, Copies(particles))


def as_stated(particles: Particles, owner: str, step: Step) -> Particles:
    """The owned particles at the tick of a step, as the next gossip states them."""
    if not step.config.filter.compact:
        return particles
    states, ids = quantised(particles.states, step.config.filter.speed, owner, step.tick)
    return Particles(states.astype(float), particles.weights, ids, particles.labels)


class ParticlePhd(NamedTuple):
    """The particle PHD as a `Tracker`."""

    backend: Backend

    def start(self, name: str, config: AgentConfig, box: tuple[float, float, float, float] | None = None) -> Belief:
        """See `Tracker.start`."""
        filters, arena = config.filter, config.arena
        given = filters.seed, prior_size(filters, arena), filters, arena
        return belief_without_claim(name, -1, NO_PARTICLES, Copies(prior(*given) if box is None else prior_around(*given, box)))

    def gossip_fields(self, mine: OwnedState, settings: FilterSettings) -> dict[str, Any]:
        """See `Tracker.gossip_fields`."""
        states, weights, ids, labels = mine.targets
        if not len(ids):
            return {}
        table, numbers = pack_labels(labels)
        return {
            "weight": float(weights[0]),
            "states_bytes": pack(states, "<f4"),
            "ids_bytes": pack(ids, "<u8"),
            "labels_bytes": table,
            "label_numbers_bytes": numbers,
            "particles": packed(states, settings.speed) if settings.compact else b"",  # states and ids in few bytes
        }

    def weighted_points(self, density: GossipTable | Particles) -> Particles:
        """See `Tracker.weighted_points`."""
        return as_particles(density)

    def catch_up(self, belief: Belief, step: Step) -> Belief:
        """See `Tracker.catch_up`: all particles become copies, and move by the keyed noise of the missed ticks."""
        if belief.tick >= step.tick - 1:
            return belief
        released = _without_claim(belief)
        moved = reduce(predict, missed_steps(belief, step), released.copies.near)
        return replace(released, tick=step.tick - 1, copies=Copies(moved))

    def keep_claim(self, belief: Belief, step: Step, alone: RegionUpdate | None = None) -> Belief:
        """See `Tracker.keep_claim`: all particles move by the keyed noise of the missed ticks; the owned ones are rounded as on the wire.

        Particles may leave the cell meanwhile, so a kept claim counts only where all state claims of one diagram (`merge`).
        """
        missed = missed_steps(belief, step)
        if alone is not None:
            particles = alone.resampled
        else:
            particles = reduce(predict, missed, belief.mine.targets)
            particles = select(particles, particles.weights > 0.0)
            particles = particles._replace(states=particles.states.astype(WIRE_TYPE).astype(float))
        mine = belief.mine._replace(targets=as_stated(particles, belief.mine.owner, step._replace(tick=step.tick - 1)))
        copies = Copies(belief.copies.near, belief.copies.inputs, (*belief.copies.skipped_steps, *missed))
        return Belief(step.tick - 1, mine, copies, belief.generator_names, belief.known_names, kept_since=belief.claim_tick)

    def merge(self, belief: Belief, table: GossipTable, step: Step) -> GossipTable | Particles:
        """See `Tracker.merge`; in a table an id may occur twice."""
        if claims_tile_arena(belief, table):
            return table
        unknown = unknown_senders(belief, table)
        if belief.claim_tick < step.tick - 1:
            belief = _without_claim(belief)
        return merge(belief.mine, belief.copies.compute(), table, unknown, step, self.backend, owned_by_sender)

    def update(
        self, density: GossipTable | Particles, table: GossipTable, regions: Sequence[RegionInput], step: Step
    ) -> list[RegionUpdate]:
        """See `Tracker.update` and `regions.update_regions`."""
        return self.backend.update_regions(table, density, self.backend.background_births(step), regions, step)

    def belief_after(
        self, density: GossipTable | Particles, region: RegionInput, update: RegionUpdate, diagram: KnownDiagram, step: Step
    ) -> Belief:
        """See `Tracker.belief_after`: the drawn particles are owned; the copies are computed when they are needed."""
        copies = Copies(update.updated, CopyInputs(step, self.backend, density, region.polygon, region.claim, diagram.copy_distance))
        mine = OwnedState(region.owner, region.claim, as_stated(update.resampled, region.owner, step), diagram.hash)
        return Belief(step.tick, mine, copies, diagram.generator_names, diagram.known_names)
