"""The particle PHD filter: pure functions on `Particles`.

Data types: a PHD is a set of weighted particles; the sum of the weights in a place is the expected number of targets there.

Rules. Each random number is a pure function of (`filter.seed`, particle id, tick), so that all copies of a particle move to the same place
(protocol/random_streams.py). Sums run one after the other in the order of the particles, and a particle that contributes zero changes no
bit. A filter of one cell and a filter of the whole arena therefore agree to the last bit where they overlap.
"""

import math
from collections.abc import Sequence

import numpy as np

from agents.config import FilterSettings
from agents.tracking.births import Scan, birth_density, founded_labels, measurement_births, survival_probability
from agents.tracking.extraction import block_sums
from agents.tracking.labels import ADOPTED_SHARE, NO_LABEL, given_labels
from agents.tracking.measurement_likelihood import distances_and_peaks, kernel_variance, model_of, noise_of
from agents.tracking.particles import NO_PARTICLES, WIRE_TYPE, Particles, canonical, column_sums, join, mirrored, squared_distances
from agents.tracking.step import Step
from protocol.arithmetic import exp_minus
from protocol.gaussian_components import MOST_OWN_MASS
from protocol.random_streams import normal, random_key, scramble
from protocol.sensing import measurement_of

BINS_IN_VICINITY = 3.0  # bins in the length `vicinity`; two bins to each side of its own bin are near a particle


def predict(particles: Particles, step: Step) -> Particles:
    """The particles one step later: constant speed, keyed heading and position noise, survival.

    The heading turns by the Cayley map of a small angle, so that only exactly rounded operations occur. Particles that leave the
    arena stay in the array with weight 0, unless the border reflects.
    """
    settings, arena, dt = step.config.filter, step.config.arena, step.config.run.dt
    seed, tick, states = settings.seed, step.tick, particles.states
    turn = normal(scramble(particles.ids, random_key(seed, "turn", tick))) * (0.5 * settings.heading_noise * math.sqrt(dt))
    scale = settings.speed / np.maximum(np.sqrt(states[:, 2] * states[:, 2] + states[:, 3] * states[:, 3]), 1e-12)
    cos, sin = (1.0 - turn * turn) / (1.0 + turn * turn), 2.0 * turn / (1.0 + turn * turn)
    vx = (cos * states[:, 2] - sin * states[:, 3]) * scale
    vy = (sin * states[:, 2] + cos * states[:, 3]) * scale
    x = states[:, 0] + vx * dt + normal(scramble(particles.ids, random_key(seed, "east", tick))) * settings.position_noise
    y = states[:, 1] + vy * dt + normal(scramble(particles.ids, random_key(seed, "north", tick))) * settings.position_noise
    if settings.border == "reflect":
        (x, beyond_x), (y, beyond_y) = mirrored(x, arena.width), mirrored(y, arena.height)
        vx, vy = np.where(beyond_x, -vx, vx), np.where(beyond_y, -vy, vy)
    weights = particles.weights * survival_probability(dt, settings)
    return Particles(np.column_stack([x, y, vx, vy]), np.where(arena.holds(x, y), weights, 0.0), particles.ids, particles.labels)


def likelihood_noise(noise: float, settings: FilterSettings) -> float:
    """Standard deviation in m of a detection about a particle: that of the sensor and that of the particle's kernel together.

    The position noise of one step spreads N = `particles_per_target` particles. The kernel of each is a Gaussian of that spread times
    N^(-1/6) (Silverman's rule in the plane) times `roughening`. Without a kernel an accurate sensor leaves weight on few particles.
    """
    return math.sqrt(noise * noise + kernel_variance(settings))


def correct(particles: Particles, scans: Sequence[Scan], step: Step) -> Particles:
    """The PHD after all scans of a tick, one after the other in their order (iterated corrector), births behind in the order of detections.

    For each scan with clutter density kappa: w <- w m + sum over detections z of w p_d g(z) / (kappa + p_d(z) b(z) +
    sum of w p_d g(z)), with m the factor of a miss (`missed`), g a Gaussian cut at `gate` standard deviations, and b(z) the density
    of targets not yet represented. The term p_d b(z) becomes `birth.measurement_particles` new particles around z.
    """
    predicted = particles
    for scan in scans:
        corrected, per_particle, labels, given = correct_scan(particles, predicted, scan, step)
        particles = Particles(particles.states, corrected, particles.ids, labels)
        if step.config.birth.measurement and len(scan.detections):
            particles = join([particles, measurement_births(scan, per_particle, given, step)])
    return particles


def correct_scan(
    particles: Particles, predicted: Particles, scan: Scan, step: Step
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The weights (N,) after one scan, the weight of each copy of a birth at each detection (M,), and the labels of both."""
    noise, settings, birth = step.config.detection.noise, step.config.filter, step.config.birth
    founded = founded_labels(scan, step) if birth.measurement else np.zeros_like(scan.indices)
    probability = scan.probability(particles.states[:, :2])
    if scan.rays is not None:
        scan_noise = noise_of(model_of(measurement_of(scan.sensor)), noise, kernel_variance(settings), scan.pose_noise)
        squared, peaks = distances_and_peaks(particles.states, scan.pose, scan.detections, scan.rays, scan.sensor.reach, scan_noise)
        rows, columns = np.nonzero((squared <= settings.gate * settings.gate) & (probability > 0.0)[:, None])
        likelihood = exp_minus(squared[rows, columns] * 0.5) * peaks[rows, columns]
    else:
        spread = likelihood_noise(noise, settings)
        squared = squared_distances(particles.states, scan.detections)
        rows, columns = np.nonzero((squared <= (settings.gate * spread) ** 2) & (probability > 0.0)[:, None])
        likelihood = exp_minus(squared[rows, columns] * (0.5 / (spread * spread))) * (1.0 / (2.0 * math.pi * spread * spread))
    terms = np.zeros(squared.shape)
    terms[rows, columns] = particles.weights[rows] * probability[rows] * likelihood
    sums = column_sums(terms)
    density = birth_density(predicted, scan, sums / _positive(scan.clutter_density + sums), birth)
    fresh = scan.probability(scan.detections) * density
    norms = _positive(scan.clutter_density + fresh + sums)
    gained = np.zeros(len(particles.weights))
    for number in range(len(norms)):
        gained = gained + terms[:, number] / norms[number]
    born = fresh / norms
    corrected = particles.weights * missed(particles, probability, gained, scan.detections, born, settings) + gained
    labels, given = _labels_after(particles.labels, corrected, terms, norms, founded)
    return corrected, born / birth.measurement_particles, labels, given


def _labels_after(
    labels: np.ndarray, weights: np.ndarray, terms: np.ndarray, norms: np.ndarray, founded: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The labels of the particles (N,) and of the births (M,) after a scan, by the rules of agents/tracking/labels.py.

    `terms` (N, M) are the terms w p_d g(z) of the particles with new `weights` (N,), and `norms` (M,) the sums N(z). `founded` (M,) are
    the labels that the detections found if no living label explains them (`labels.given_labels`).
    """
    after, given = labels.copy(), given_labels(labels, terms, norms, founded)
    for number in range(len(norms)):
        rows = np.flatnonzero(terms[:, number])
        after[rows[(labels[rows] == NO_LABEL) & (terms[rows, number] / norms[number] > ADOPTED_SHARE * weights[rows])]] = given[number]
    return after, given


def _positive(values: np.ndarray) -> np.ndarray:
    """The values, with 1 in place of those that are not positive: safe divisors."""
    return np.where(values > 0.0, values, 1.0)


def missed(
    particles: Particles, probability: np.ndarray, gained: np.ndarray, detections: np.ndarray, born: np.ndarray, settings: FilterSettings
) -> np.ndarray:
    """The weight factors (N,) of particles for missed targets: (r / M) (1 - p_d) / (1 - p_d min(r, c)) in view, 1 out of view.

    M is the mass in view near a particle. r is M less the weights that particles (`gained`, (N,)) and births (`born`, (M,)) near it
    gained from detections. c is `certainty`. Near means within two bins of side `vicinity` / 3.

    By Bayes' rule for one target of probability r, a missed target has probability r (1 - p_d) / (1 - r p_d). The PHD filter has
    r (1 - p_d), the rule for a Poisson number of targets. Both agree for small r.
    """
    side, seen, factors = settings.vicinity / BINS_IN_VICINITY, np.flatnonzero(probability > 0.0), np.ones(len(probability))
    if not len(seen):
        return factors
    places = np.floor(np.vstack([particles.states[seen, :2], detections]) / side).astype(np.int64)
    left, low = places.min(axis=0) - 2
    shape = tuple((places.max(axis=0) - (left, low) + 3)[::-1])
    flat = (places[:, 1] - low) * shape[1] + (places[:, 0] - left)
    own, found = flat[: len(seen)], probability[seen]
    masses = block_sums(np.bincount(own, particles.weights[seen], shape[0] * shape[1]).reshape(shape)).ravel()[own]
    explained = block_sums(np.bincount(flat, np.concatenate([gained[seen], born]), shape[0] * shape[1]).reshape(shape)).ravel()[own]
    rest = np.maximum(masses - explained, 0.0)
    factors[seen] = rest / _positive(masses) * ((1.0 - found) / (1.0 - found * np.minimum(rest, settings.certainty)))
    return factors


def sample_size(mass: float, settings: FilterSettings) -> int:
    """Number of particles for a mass in expected targets: `particles_per_target` for each, within the limits per owner."""
    return min(max(round(settings.particles_per_target * mass), settings.least_particles), settings.most_particles)


def sample_offset(seed: int, owner: str, tick: int) -> float:
    """The one uniform number of a systematic resampling, in [0, 1)."""
    return (random_key(seed, "resample", owner, tick) >> 11) * 2.0**-53


def resample(particles: Particles, owner: str, step: Step) -> Particles:
    """Equally weighted particles of the same mass: systematic resampling with one uniform keyed by (seed, owner, tick).

    A mass beyond `MOST_OWN_MASS` is cut to that. The first draw of a particle keeps its id, and further draws get new ids. States are
    rounded to the precision of the wire, so that the owner holds exactly the particles of its gossip. Ids ascend. All draws keep the
    label.
    """
    sums = np.add.accumulate(particles.weights)
    mass = float(sums[-1]) if len(sums) else 0.0
    if mass <= 0.0:
        return NO_PARTICLES
    tick, seed, count = step.tick, step.config.filter.seed, sample_size(mass, step.config.filter)
    marks = (np.arange(count) + sample_offset(seed, owner, tick)) * (mass / count)
    parents = np.minimum(np.searchsorted(sums, marks, side="right"), len(sums) - 1)
    repeats = np.arange(count) - np.searchsorted(parents, parents, side="left")
    ids = particles.ids[parents]
    again = repeats > 0
    ids[again] = scramble(ids[again] + repeats[again].astype(np.uint64), random_key(seed, "split", tick))
    states = particles.states[parents].astype(WIRE_TYPE).astype(float)
    return canonical(Particles(states, np.full(count, min(mass, MOST_OWN_MASS) / count), ids, particles.labels[parents]))
