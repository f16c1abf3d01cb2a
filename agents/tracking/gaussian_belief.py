"""The replicated Gaussian-mixture PHD: the belief of one agent, and its merge with the components that other agents own.

The rules are those of the particles (`agents.tracking.belief`). A component belongs to the cell in which its mean lies. Copies move
without random numbers, so they need no keys. A round corrects all components that the agent has heard of, because wide ones reach far:
there are few, and so agents that hear everybody compute the same bits.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Any, NamedTuple

from agents.backend import Backend
from agents.config import AgentConfig, FilterSettings
from agents.gossip.table import GossipTable
from agents.tracking import claims, gaussian_phd
from agents.tracking.claims import Claim, make_claim
from agents.tracking.extraction import TargetEstimates
from agents.tracking.gaussian_reduction import estimate_and_label, limited, merged
from agents.tracking.gaussians import (
    EMPTY,
    Mixture,
    clamped,
    packed,
    quadrature_mean,
    quadrature_points,
    unpacked,
    weighted_points,
)
from agents.tracking.merge import merge
from agents.tracking.particles import Particles, canonical, join, select, total
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
from protocol import geometry
from protocol.messages import Gossip

PEAK_RADIUS_BINS = 2.0  # bins around a component that are one peak


def owned_by_sender(gossip: Gossip) -> OwnedState:
    """The state that the sender of a gossip owns."""
    return OwnedState(gossip.sender, make_claim(gossip.claim_names, gossip.claim), unpacked(gossip.components), gossip.diagram_hash)


def as_mixture(density: GossipTable | Mixture) -> Mixture:
    """The components of a table, or the components themselves."""
    return unpacked(density.components) if isinstance(density, GossipTable) else density


def take(mixture: Mixture, claim: Claim, step: Step) -> Mixture:
    """What an owner states: the components in its cell, the heaviest if they exceed `mixture.most_components`."""
    return limited(select(mixture, claims.owned(mixture.means, claim, step.config.arena)), step.config.mixture.most_components)


def filter_step(density: Mixture, table: GossipTable, step: Step) -> tuple[TargetEstimates, Mixture]:
    """The estimates and the PHD one step later, after all scans of a table, background births included; in canonical order."""
    born = join([gaussian_phd.predict(canonical(density), step), gaussian_phd.background_births(step)])
    corrected, settings = _tidied(gaussian_phd.correct(born, table.scans(), step), step), step.config.extraction
    return estimate_and_label(corrected, settings.threshold, settings.beside, PEAK_RADIUS_BINS * settings.bin)


def _moved(mixture: Mixture, step: Step) -> Mixture:
    """The components one step later, when nothing is heard."""
    return _tidied(gaussian_phd.predict(mixture, step), step)


def _tidied(mixture: Mixture, step: Step) -> Mixture:
    """The components in canonical order, merged where they have come close, without light ones, and rounded as on the wire.

    A scan moves means, but no target out of the arena: what lies beyond the border would belong to no cell.
    Two parts of a swarm that do not hear each other should hold the same components of what neither sees. So no cell enters here.
    """
    inside = clamped(canonical(mixture), step.config.arena)
    whole = canonical(merged(inside, step.config.mixture))
    return unpacked(packed(select(whole, whole.weights >= step.config.mixture.pruned)))


def _without_claim(belief: Belief) -> Belief:
    """The belief without a claim: all components are copies."""
    return belief_without_claim(belief.mine.owner, belief.tick, EMPTY, canonical(join([belief.mine.targets, belief.copies])))


class MixturePhd(NamedTuple):
    """The Gaussian-mixture PHD as a `Tracker`."""

    backend: Backend

    def start(self, name: str, config: AgentConfig, box: tuple[float, float, float, float] | None = None) -> Belief:
        """See `Tracker.start`."""
        known = gaussian_phd.prior(config)
        if box is not None:
            x, y = known.means[:, 0], known.means[:, 1]
            known = select(known, (x >= box[0]) & (y >= box[1]) & (x <= box[2]) & (y <= box[3]))
        return belief_without_claim(name, -1, EMPTY, known)

    def gossip_fields(self, mine: OwnedState, settings: FilterSettings) -> dict[str, Any]:
        """See `Tracker.gossip_fields`."""
        return {"components_bytes": packed(mine.targets).tobytes()}

    def weighted_points(self, density: GossipTable | Mixture) -> Particles:
        """See `Tracker.weighted_points`."""
        return weighted_points(as_mixture(density))

    def catch_up(self, belief: Belief, step: Step) -> Belief:
        """See `Tracker.catch_up`: all components become copies, and move by the missed ticks."""
        if belief.tick >= step.tick - 1:
            return belief
        released = _without_claim(belief)
        return replace(released, tick=step.tick - 1, copies=reduce(_moved, missed_steps(belief, step), released.copies))

    def keep_claim(self, belief: Belief, step: Step, alone: RegionUpdate | None = None) -> Belief:
        """See `Tracker.keep_claim`: all components move by the missed ticks, and those in the kept claim are owned."""
        moved = reduce(_moved, missed_steps(belief, step), _without_claim(belief).copies)
        mine = belief.mine._replace(targets=take(moved, belief.mine.claim, step) if alone is None else alone.resampled)
        copies = select(moved, ~claims.owned(moved.means, belief.mine.claim, step.config.arena))
        return Belief(step.tick - 1, mine, copies, belief.generator_names, belief.known_names, kept_since=belief.claim_tick)

    def merge(self, belief: Belief, table: GossipTable, step: Step) -> GossipTable | Mixture:
        """See `Tracker.merge`."""
        if claims_tile_arena(belief, table):
            return table
        unknown = unknown_senders(belief, table)
        if belief.claim_tick < step.tick - 1:
            belief = _without_claim(belief)
        return merge(belief.mine, belief.copies, table, unknown, step, self.backend, owned_by_sender)

    def update(self, density: GossipTable | Mixture, table: GossipTable, regions: Sequence[RegionInput], step: Step) -> list[RegionUpdate]:
        """See `Tracker.update`."""
        peaks, corrected = filter_step(as_mixture(density), table, step)
        return [_region_of(corrected, peaks, region, step) for region in regions]

    def belief_after(
        self, density: GossipTable | Mixture, region: RegionInput, update: RegionUpdate, diagram: KnownDiagram, step: Step
    ) -> Belief:
        """See `Tracker.belief_after`: copies are the corrected components in the arena, outside the cell and within `copy_distance`."""
        means, arena = update.updated.means, step.config.arena
        others = ~claims.owned(means, region.claim, arena) & arena.holds(means[:, 0], means[:, 1])
        if diagram.copy_distance < math.inf:
            others &= geometry.distances(region.polygon, means) <= diagram.copy_distance
        mine = OwnedState(region.owner, region.claim, update.resampled, diagram.hash)
        return Belief(step.tick, mine, select(update.updated, others), diagram.generator_names, diagram.known_names)


def _region_of(corrected: Mixture, peaks: TargetEstimates, region: RegionInput, step: Step) -> RegionUpdate:
    """The part of the corrected mixture, and of the estimates, that falls to an owner."""
    inside = take(corrected, region.claim, step)
    load, detected = _in_view(corrected, region)
    estimates = select(peaks, claims.owned(peaks.positions, region.claim, step.config.arena))
    mass, moment_x, moment_y = (total(inside.weights * column) for column in (1.0, inside.means[:, 0], inside.means[:, 1]))
    return RegionUpdate(corrected, inside, inside, mass, moment_x, moment_y, load, detected, estimates)


def _in_view(mixture: Mixture, region: RegionInput) -> tuple[float, float]:
    """The integrals of v and of p_d v over the footprint (10), expected targets."""
    seen = region.sensor.probability(quadrature_points(mixture).reshape(-1, 2), region.pose).reshape(-1, 9)
    return total(mixture.weights * quadrature_mean((seen > 0.0).astype(float))), total(mixture.weights * quadrature_mean(seen))
