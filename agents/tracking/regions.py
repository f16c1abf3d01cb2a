"""The computation of a round: the update of the PHD around the cell of each owner, step by step.

Data types: a `RegionInput` is an owner with its cell; a `RegionUpdate` is the result: the particles within the halo of the cell, those in
it, and those drawn from the latter.

Rules. All particles are predicted, and those around the cell are corrected with all scans that reach it. Targets are estimated, and some
particles around those in the cell are renamed. Then those in the cell are resampled. What is left becomes copies, once they are
needed. These functions are the reference; agents/compiled/region_kernels.py and copy_kernels.py compute the same bits.
"""

import math
from collections.abc import Sequence

import numpy as np

from agents.gossip.table import GossipTable, as_particles
from agents.tracking import claims, phd
from agents.tracking.births import near_part
from agents.tracking.claims import Claim
from agents.tracking.extraction import NO_ESTIMATES, estimate_targets
from agents.tracking.labels import renamed
from agents.tracking.measurement_likelihood import BEARING, model_of
from agents.tracking.particles import Particles, canonical, join, select, total
from agents.tracking.phd import predict
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput, RegionUpdate
from protocol import geometry
from protocol.sensing import Pose, SensorModel, measurement_of


def update_regions(
    table: GossipTable, density: GossipTable | Particles, births: Particles, regions: Sequence[RegionInput], step: Step
) -> list[RegionUpdate]:
    """One update per owner. `density` holds the particles that count one tick before, `table` the scans of the tick.

    `births` are the background births of the tick.
    """
    predicted = predict(canonical(as_particles(density)), step)
    return [_update_region(table, predicted, births, region, step) for region in regions]


def _update_region(table: GossipTable, predicted: Particles, births: Particles, region: RegionInput, step: Step) -> RegionUpdate:
    config, claim = step.config, region.claim
    near, far = split_by_halo(predicted, births, region, step)
    updated = correct(near, table, region.polygon, step)
    owned = claims.owned(updated.states, claim, config.arena)
    estimates = NO_ESTIMATES
    if claim.names:
        estimates = estimate_targets(updated, config.extraction, step.tick)
        estimates = select(estimates, claims.owned(estimates.positions, claim, config.arena))
        updated = updated._replace(labels=renamed(updated, owned, near, estimates.positions, config.extraction.bin))
    own = canonical(select(updated, owned))
    mass, moment_x, moment_y = moments(own)
    near_load, near_detected = in_view(updated, region.sensor, region.pose)
    far_load, far_detected = in_view(far, region.sensor, region.pose)
    resampled = phd.resample(own, region.owner, step)
    return RegionUpdate(updated, own, resampled, mass, moment_x, moment_y, near_load + far_load, near_detected + far_detected, estimates)


def split_by_halo(predicted: Particles, births: Particles, region: RegionInput, step: Step) -> tuple[Particles, Particles]:
    """The predicted particles and births within the halo of a cell, and the other predicted particles within reach of the sensor.

    In the first set the births stand behind the predicted particles.
    """
    halo, (x, y), reach = step.config.filter.halo, region.pose[:2], region.sensor.reach
    close = geometry.distances(region.polygon, predicted.states) <= halo
    born = select(births, geometry.distances(region.polygon, births.states) <= halo)
    dx, dy = predicted.states[:, 0] - x, predicted.states[:, 1] - y
    return join([select(predicted, close), born]), select(predicted, ~close & (dx * dx + dy * dy <= reach * reach))


def correct(particles: Particles, table: GossipTable, polygon: np.ndarray, step: Step) -> Particles:
    """The PHD around a cell after all scans that reach its halo, by their detections within the halo (`phd.correct`)."""
    halo, close = step.config.filter.halo, []
    for scan in table.scans():
        apart = geometry.distances(polygon, np.array([scan.pose]))[0]
        if apart <= halo + scan.sensor.reach:
            near = geometry.distances(polygon, scan.detections) <= halo
            if model_of(measurement_of(scan.sensor))[0] == BEARING:  # its beam may come near although its middle does not
                near |= True
            close.append(near_part(scan, near))
    return phd.correct(particles, close, step)


def moments(particles: Particles) -> tuple[float, float, float]:
    """Mass in expected targets, and the mass-weighted sums of x and y in m (17)."""
    weights, states = particles.weights, particles.states
    return total(weights), total(weights * states[:, 0]), total(weights * states[:, 1])


def in_view(particles: Particles, sensor: SensorModel, pose: Pose) -> tuple[float, float]:
    """The integrals of v and of p_d v over the footprint (10), expected targets."""
    probability = sensor.probability(particles.states[:, :2], pose)
    seen = np.where(probability > 0.0, particles.weights, 0.0)
    return total(seen), total(seen * probability)


def remote_copies(near: Particles, density: Particles, polygon: np.ndarray, claim: Claim, copy_distance: float, step: Step) -> Particles:
    """The copies after a round, all of positive weight: particles `near` the cell, then those of the `density` one step before.

    Of the corrected particles `near` the cell, those in the arena and outside the claim are copies. Of the density, moved
    by one step, those farther than the halo and within `copy_distance` m of the cell are copies. `polygon` (V, 2) is the cell, m.
    """
    arena, states = step.config.arena, near.states
    others = select(near, ~claims.owned(states, claim, arena) & arena.holds(states[:, 0], states[:, 1]))
    moved = predict(density, step)
    away = geometry.distances(polygon, moved.states)
    apart, within = away > step.config.filter.halo, (away <= copy_distance) | (copy_distance == math.inf)
    copies = join([others, select(moved, apart & within)])
    return select(copies, copies.weights > 0.0)
