"""The Gaussian-mixture PHD filter (Vo and Ma 2006): motion, births and the correction by a scan, as pure functions on `Mixture`.

Motion is that of the particles in its first two moments: constant speed, a heading that walks randomly, survival. A sensor sees a part of
a component: its detection probability is a mean over nine places of the component, and a miss moves the component to the part that was
not seen. Only a mean over places can tell a component beside the edge of a footprint from one across it.
"""

import math
from collections.abc import Sequence

import numpy as np

from agents.config import AgentConfig
from agents.tracking import births
from agents.tracking.births import Scan, least_density, survival_probability
from agents.tracking.gaussians import (
    EMPTY,
    KERNEL_SHARE,
    QUADRATURE_WEIGHTS,
    Mixture,
    largest_variances,
    quadrature_mean,
    quadrature_points,
    unlabelled,
)
from agents.tracking.labels import NO_LABEL, birth_labels, given_labels
from agents.tracking.measurement_likelihood import POSE_SPREAD, model_of, noise_of
from agents.tracking.particles import column_sums, join, mass_within, mirrored, select
from agents.tracking.step import Step
from protocol.arithmetic import exp_minus
from protocol.random_streams import random_key, scramble
from protocol.sensing import measurement_of

SPLIT_OFFSET = 0.7  # where the halves of a split component lie, in its standard deviations
PRIOR_DEVIATION = 0.7  # standard deviation of a component of the prior in units of the largest one; half of their distance
BACKGROUND_TURN = 0.35  # standard deviation of the velocity of a background birth, in speeds: its direction has been drawn already
LEAST_BIRTH = 2.0  # weight of a background birth in units of `mixture.pruned`, at least
OUTSIDE = 3.0  # standard deviations of a detection from the arena, beyond which it shows no new target


def prior(config: AgentConfig) -> Mixture:
    """The uniform PHD of density `prior_density` with which all agents start: a grid of components with unknown headings."""
    filters, arena, deviation = config.filter, config.arena, PRIOR_DEVIATION * config.mixture.spread
    columns, rows = (max(1, math.ceil(side / (2.0 * deviation))) for side in (arena.width, arena.height))
    if filters.prior_density <= 0.0:
        return EMPTY
    places = np.array([((c + 0.5) / columns * arena.width, (r + 0.5) / rows * arena.height) for r in range(rows) for c in range(columns)])
    weights = np.full(len(places), filters.prior_density * arena.width * arena.height / len(places))
    ids = scramble(np.arange(len(places), dtype=np.uint64), random_key(filters.seed, "prior"))
    order = np.argsort(ids, kind="stable")
    covariances = _covariances(len(ids), deviation**2, 0.5 * filters.speed**2)
    return unlabelled(weights, np.column_stack([places, np.zeros_like(places)])[order], covariances, ids[order])


def _covariances(count: int, place: float, velocity: float) -> np.ndarray:
    """Covariances (count, 4, 4) with these variances on each axis, m^2 and m^2/s^2."""
    return np.tile(np.diag([place, place, velocity, velocity]), (count, 1, 1))


def background_births(step: Step) -> Mixture:
    """The background births of a tick: a component at each particle of `births.background_births`.

    What would be so light that it is dropped is born every few ticks instead, with the mass of all of them.
    """
    config = step.config
    born = births.background_births(step)
    if not len(born.ids):
        return EMPTY
    ticks = max(1, math.ceil(min(LEAST_BIRTH * config.mixture.pruned / born.weights[0], 2.0**53)))
    if (step.tick + 1) % ticks:
        return EMPTY
    covariances = _covariances(len(born.ids), (0.5 * config.mixture.spread) ** 2, (BACKGROUND_TURN * config.filter.speed) ** 2)
    return unlabelled(ticks * born.weights, born.states, covariances, born.ids)


def predict(mixture: Mixture, step: Step) -> Mixture:
    """The components one step later: moved, the wide ones split, and those outside an open border removed."""
    return _in_arena(_split(_moved(mixture, step), step), step)


def _moved(mixture: Mixture, step: Step) -> Mixture:
    """The components after a step of constant speed whose heading turns by a normal angle: its first two moments."""
    filters, dt = step.config.filter, step.config.run.dt
    turning = filters.heading_noise**2 * dt
    remaining, mixed = math.exp(-0.5 * turning), 0.5 * (1.0 - math.exp(-2.0 * turning))
    velocity, before = mixture.means[:, 2:], mixture.covariances
    second = before[:, 2:, 2:] + velocity[:, :, None] * velocity[:, None, :]
    scale = filters.speed / np.sqrt(np.maximum(second[:, 0, 0] + second[:, 1, 1], 1e-12))
    turned = np.empty_like(second)
    turned[:, 0, 0], turned[:, 1, 1] = second[:, 1, 1], second[:, 0, 0]
    turned[:, 0, 1] = turned[:, 1, 0] = -second[:, 0, 1]
    second = ((1.0 - mixed) * second + mixed * turned) * (scale * scale)[:, None, None]
    velocity = velocity * (remaining * scale)[:, None]
    after, cross = np.empty_like(before), before[:, :2, 2:] * (remaining * scale)[:, None, None]
    after[:, 2:, 2:] = second - velocity[:, :, None] * velocity[:, None, :]
    cross = cross + dt * after[:, 2:, 2:]
    after[:, :2, 2:], after[:, 2:, :2] = cross, cross.transpose(0, 2, 1)
    after[:, :2, :2] = before[:, :2, :2] + dt * (cross + cross.transpose(0, 2, 1)) - dt * dt * after[:, 2:, 2:]
    after[:, 0, 0] += filters.position_noise**2
    after[:, 1, 1] += filters.position_noise**2
    means = np.concatenate([mixture.means[:, :2] + dt * velocity, velocity], axis=1)
    return Mixture(mixture.weights * survival_probability(dt, filters), means, after, mixture.ids, mixture.labels)


def _split(mixture: Mixture, step: Step) -> Mixture:
    """The components, each of a place wider than `mixture.spread` as two halves beside each other; mean and covariance stay."""
    wide = np.flatnonzero(largest_variances(mixture) > step.config.mixture.spread**2)
    if not len(wide):
        return mixture
    halves = select(mixture, wide)
    xx, xy, yy = halves.covariances[:, 0, 0], halves.covariances[:, 0, 1], halves.covariances[:, 1, 1]
    variance = largest_variances(halves)
    east, north = np.where(xx >= yy, variance - yy, xy), np.where(xx >= yy, xy, variance - xx)
    length = np.sqrt(east * east + north * north)
    east, north = np.where(length > 0.0, east, 1.0), np.where(length > 0.0, north, 0.0)
    length = np.where(length > 0.0, length, 1.0) * np.sqrt(variance)
    shift = SPLIT_OFFSET * (
        halves.covariances[:, :, 0] * (east / length)[:, None] + halves.covariances[:, :, 1] * (north / length)[:, None]
    )
    covariances = halves.covariances - shift[:, :, None] * shift[:, None, :]
    first = halves._replace(weights=0.5 * halves.weights, means=halves.means + shift, covariances=covariances)
    again = scramble(halves.ids, random_key(step.config.filter.seed, "split", step.tick))
    return join([_put(mixture, wide, first), first._replace(means=halves.means - shift, ids=again)])


def _put(mixture: Mixture, rows: np.ndarray, others: Mixture) -> Mixture:
    """The mixture with other components in some of its rows."""
    columns = [column.copy() for column in mixture]
    for column, new in zip(columns, others):
        column[rows] = new
    return Mixture(*columns)


def _in_arena(mixture: Mixture, step: Step) -> Mixture:
    """The components whose means lie in the arena; at a border that reflects, those outside are mirrored first."""
    arena = step.config.arena
    if step.config.filter.border == "reflect":
        means, signs = mixture.means.copy(), np.ones((len(mixture.ids), 4))
        for axis, length in ((0, arena.width), (1, arena.height)):
            means[:, axis], outside = mirrored(means[:, axis], length)
            signs[outside, axis] = signs[outside, axis + 2] = -1.0
        means[:, 2:] *= signs[:, 2:]
        mixture = mixture._replace(means=means, covariances=mixture.covariances * signs[:, :, None] * signs[:, None, :])
    return select(mixture, arena.holds(mixture.means[:, 0], mixture.means[:, 1]))


def correct(mixture: Mixture, scans: Sequence[Scan], step: Step) -> Mixture:
    """The PHD after all scans of a tick, one after the other (iterated corrector)."""
    for scan in scans:
        mixture = _corrected(mixture, scan, step)
    return mixture


def _corrected(mixture: Mixture, scan: Scan, step: Step) -> Mixture:
    """The PHD after one scan.

    The components in view as missed ones, then one for each pair of component and detection within the gate, then the births. Pairs keep
    the label of their component, or take that of their detection if it has none.
    """
    config = step.config
    x, y, _ = scan.pose
    width = 3.0 * np.sqrt(largest_variances(mixture)) + (scan.sensor.reach + POSE_SPREAD * scan.pose_noise[0])
    dx, dy = mixture.means[:, 0] - x, mixture.means[:, 1] - y
    close = dx * dx + dy * dy <= width * width
    near, noise = select(mixture, close), measured_covariances(scan, config)
    seen = scan.probability(quadrature_points(near).reshape(-1, 2)).reshape(-1, len(QUADRATURE_WEIGHTS))
    rows, columns, found, likelihood = _detected(near, scan, noise, step)
    terms = np.zeros((len(near.ids), len(scan.detections)))
    terms[rows, columns] = likelihood
    fresh = scan.probability(scan.detections) * birth_density(scan, config) * _may_lie_in_arena(scan.detections, noise, config)
    norms = scan.clutter_density + fresh + column_sums(terms)
    norms = np.where(norms > 0.0, norms, 1.0)
    born = _births(scan, noise, fresh / norms, step)
    given = given_labels(near.labels, terms, norms, born.labels)
    labels = np.where(found.labels == NO_LABEL, given[columns], found.labels)
    found, born = found._replace(weights=likelihood / norms[columns], labels=labels), born._replace(labels=given)
    gained = np.zeros(len(near.ids))
    for number in range(len(norms)):
        gained = gained + terms[:, number] / norms[number]
    left = missed(near, seen, gained, scan.detections, born.weights, config)
    stays = np.ones(len(mixture.ids), dtype=bool)
    stays[close] = (left.weights >= config.mixture.pruned) | (quadrature_mean(seen) < 0.5)
    parts = [select(_put(mixture, np.flatnonzero(close), left), stays)]
    return join([*parts, *(select(part, part.weights >= config.mixture.pruned) for part in (found, born))])


def measured_covariances(scan: Scan, config: AgentConfig) -> np.ndarray:
    """Covariances (M, 2, 2) in m^2 of the places of detections: of the sensor and of the own pose."""
    model, noise = model_of(measurement_of(scan.sensor)), config.detection.noise
    if scan.rays is None:
        return np.tile(np.eye(2) * (noise * noise), (len(scan.detections), 1, 1))
    found = noise_of(model, noise, 0.0, scan.pose_noise)
    east, north, far = scan.rays[:, 0], scan.rays[:, 1], scan.rays[:, 2]
    along, across = found.along, found.across + found.bearing * (far * far)
    result = np.empty((len(far), 2, 2))
    result[:, 0, 0], result[:, 1, 1] = along * east * east + across * north * north, along * north * north + across * east * east
    result[:, 0, 1] = result[:, 1, 0] = (along - across) * (east * north)
    return result


def _detected(mixture: Mixture, scan: Scan, noise: np.ndarray, step: Step) -> tuple[np.ndarray, np.ndarray, Mixture, np.ndarray]:
    """The pairs of component and detection within the gate: rows, columns, corrected components, and weights times p_d g."""
    gate, filters = step.config.filter.gate, step.config.filter
    dx = scan.detections[None, :, 0] - mixture.means[:, 0, None]
    dy = scan.detections[None, :, 1] - mixture.means[:, 1, None]
    xx = mixture.covariances[:, 0, 0, None] + noise[None, :, 0, 0]
    xy = mixture.covariances[:, 0, 1, None] + noise[None, :, 0, 1]
    yy = mixture.covariances[:, 1, 1, None] + noise[None, :, 1, 1]
    volume = xx * yy - xy * xy
    squared = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / volume
    rows, columns = np.nonzero(squared <= gate * gate)
    dx, dy, volume, squared = dx[rows, columns], dy[rows, columns], volume[rows, columns], squared[rows, columns]
    inverse = np.empty((len(rows), 2, 2))
    inverse[:, 0, 0], inverse[:, 1, 1] = yy[rows, columns] / volume, xx[rows, columns] / volume
    inverse[:, 0, 1] = inverse[:, 1, 0] = -xy[rows, columns] / volume
    before, to = mixture.covariances[rows], mixture.covariances[rows][:, :, :2]
    gain = to[:, :, :1] * inverse[:, None, 0, :] + to[:, :, 1:] * inverse[:, None, 1, :]
    means = mixture.means[rows] + (gain[:, :, 0] * dx[:, None] + gain[:, :, 1] * dy[:, None])
    taken = gain[:, :, 0, None] * to[:, None, :, 0] + gain[:, :, 1, None] * to[:, None, :, 1]
    covariances = before - 0.5 * (taken + taken.transpose(0, 2, 1))
    probability = scan.probability(means[:, :2])
    likelihood = exp_minus(0.5 * squared) / (2.0 * math.pi * np.sqrt(volume))
    salt = scramble(scan.indices[columns], random_key(filters.seed, "detected", step.tick, scan.salt))
    found = Mixture(mixture.weights[rows], means, covariances, scramble(mixture.ids[rows], salt), mixture.labels[rows])
    return rows, columns, found, mixture.weights[rows] * probability * likelihood


def birth_density(scan: Scan, config: AgentConfig) -> float:
    """Density of targets at a detection that no component stands for, per m^2: the least one, since components cover what is known."""
    return least_density(scan.clutter_density, config.birth) if config.birth.measurement else 0.0


def _may_lie_in_arena(detections: np.ndarray, noise: np.ndarray, config: AgentConfig) -> np.ndarray:
    """Whether each detection (M, 2) with the covariance `noise` (M, 2, 2) may be of a target in the arena: (M,) bool.

    A footprint reaches beyond the border, and so does its clutter. Births there would all come to lie on the border (`clamped`).
    """
    x, y = detections.T
    dx, dy = x - np.clip(x, 0.0, config.arena.width), y - np.clip(y, 0.0, config.arena.height)
    near: np.ndarray = (dx * dx <= OUTSIDE**2 * noise[:, 0, 0]) & (dy * dy <= OUTSIDE**2 * noise[:, 1, 1])
    return near


def _births(scan: Scan, noise: np.ndarray, weights: np.ndarray, step: Step) -> Mixture:
    """A component at each detection with the noise of the sensor, an unknown heading and a label that it founds."""
    covariances = _covariances(len(weights), 0.0, 0.5 * step.config.filter.speed**2)
    covariances[:, :2, :2] = noise
    means = np.concatenate([scan.detections, np.zeros_like(scan.detections)], axis=1)
    ids = scramble(scan.indices, random_key(step.config.filter.seed, "birth", step.tick, scan.salt))
    founds = step.config.birth.measurement
    return Mixture(weights, means, covariances, ids, birth_labels(ids, step.tick) if founds else np.zeros_like(ids))


def missed(
    mixture: Mixture, seen: np.ndarray, gained: np.ndarray, detections: np.ndarray, born: np.ndarray, config: AgentConfig
) -> Mixture:
    """The components as missed ones: each node is weighed by (r / M) (1 - p_d) / (1 - p_d min(r, certainty)) in view, 1 out of view.

    `seen` (N, 9) is p_d at the quadrature points. M is the mass in view of the components within `vicinity` m, and r is M less what they
    and the births there gained (`phd.missed`). Mean and covariance become those of the weighed points; the velocity follows by regression.
    """
    means, vicinity = mixture.means, config.filter.vicinity
    in_view = mixture.weights * quadrature_mean((seen > 0.0).astype(float))
    masses = mass_within(means, means, in_view, vicinity)
    explained = mass_within(means, means, gained, vicinity) + mass_within(means, detections, born, vicinity)
    rest = np.maximum(masses - explained, 0.0)
    share = rest / np.where(masses > 0.0, masses, 1.0)
    odds = (1.0 - seen) / (1.0 - seen * np.minimum(rest, config.filter.certainty)[:, None])
    factors = np.where(seen > 0.0, share[:, None] * odds, 1.0)
    total = quadrature_mean(factors)
    left = mixture._replace(weights=mixture.weights * total)
    cut = np.flatnonzero((factors != factors[:, :1]).any(axis=1) & (left.weights > 0.0))
    return _put(left, cut, _reshaped(select(left, cut), factors[cut] / total[cut, None])) if len(cut) else left


def _reshaped(mixture: Mixture, factors: np.ndarray) -> Mixture:
    """The components with the mean and covariance of their quadrature points weighed by factors (N, 9) of mean 1."""
    offsets = quadrature_points(mixture) - mixture.means[:, None, :2]
    dx, dy = quadrature_mean(factors * offsets[:, :, 0]), quadrature_mean(factors * offsets[:, :, 1])
    ex, ey = offsets[:, :, 0] - dx[:, None], offsets[:, :, 1] - dy[:, None]
    old, place = mixture.covariances, np.empty((len(dx), 2, 2))
    place[:, 0, 0], place[:, 1, 1] = quadrature_mean(factors * ex * ex), quadrature_mean(factors * ey * ey)
    place[:, 0, 1] = place[:, 1, 0] = quadrature_mean(factors * ex * ey)
    place += KERNEL_SHARE * old[:, :2, :2]
    volume = old[:, 0, 0] * old[:, 1, 1] - old[:, 0, 1] * old[:, 0, 1]
    follow = np.empty((len(dx), 2, 2))  # the regression of velocity on place
    for axis in (0, 1):
        cross_x, cross_y = old[:, axis + 2, 0], old[:, axis + 2, 1]
        follow[:, axis, 0] = (cross_x * old[:, 1, 1] - cross_y * old[:, 0, 1]) / volume
        follow[:, axis, 1] = (cross_y * old[:, 0, 0] - cross_x * old[:, 0, 1]) / volume
    means, covariances, change = mixture.means.copy(), old.copy(), place - old[:, :2, :2]
    means[:, 0] += dx
    means[:, 1] += dy
    means[:, 2:] += follow[:, :, 0] * dx[:, None] + follow[:, :, 1] * dy[:, None]
    turned = follow[:, :, :1] * change[:, None, 0, :] + follow[:, :, 1:] * change[:, None, 1, :]
    cross = old[:, 2:, :2] + turned
    covariances[:, :2, :2], covariances[:, 2:, :2], covariances[:, :2, 2:] = place, cross, cross.transpose(0, 2, 1)
    covariances[:, 2:, 2:] += turned[:, :, :1] * follow[:, None, :, 0] + turned[:, :, 1:] * follow[:, None, :, 1]
    return mixture._replace(means=means, covariances=covariances)
