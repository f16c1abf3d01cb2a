"""The particle PHD filter: pure functions on `Particles`.

A PHD is a set of weighted particles; the sum of the weights in a place is the expected number of targets there. Every random
number is a pure function of (run seed, particle id, tick), so that whoever holds a copy of a particle moves it to the same place
(`protocol.streams`). Sums run one after the other in the order of the particles: a particle that contributes zero changes no bit,
hence a filter of one cell and a filter of the whole arena agree to the last bit where they overlap.
"""

import math

import numpy as np

from agents.config import BirthSettings, FilterSettings
from agents.tracking.births import Scan, birth_density, measurement_births, survival_probability
from agents.tracking.extraction import block_sums, estimate_targets
from agents.tracking.particles import NONE, WIRE, Particles, canonical, column_sums, join, squared_distances
from protocol.settings import ArenaSettings
from protocol.streams import key, normal, scramble

__all__ = ["Particles", "estimate_targets", "predict", "resample", "survival_probability", "update"]

BINS = 3.0  # bins in the length `vicinity`: two bins to each side of its own are near a particle


def predict(particles: Particles, tick: int, seed: int, dt: float, settings: FilterSettings, arena: ArenaSettings) -> Particles:
    """The particles at `tick`, a step `dt` s later: constant speed, keyed heading and position noise, survival.

    The heading turns by the Cayley map of a small angle, so that only exactly rounded operations occur. Particles that leave the
    arena keep a place in the array with weight 0 unless the border reflects.
    """
    states = particles.states
    turn = normal(scramble(particles.ids, key(seed, "turn", tick))) * (0.5 * settings.heading_noise * math.sqrt(dt))
    scale = settings.speed / np.maximum(np.sqrt(states[:, 2] * states[:, 2] + states[:, 3] * states[:, 3]), 1e-12)
    cos, sin = (1.0 - turn * turn) / (1.0 + turn * turn), 2.0 * turn / (1.0 + turn * turn)
    vx = (cos * states[:, 2] - sin * states[:, 3]) * scale
    vy = (sin * states[:, 2] + cos * states[:, 3]) * scale
    x = states[:, 0] + vx * dt + normal(scramble(particles.ids, key(seed, "east", tick))) * settings.position_noise
    y = states[:, 1] + vy * dt + normal(scramble(particles.ids, key(seed, "north", tick))) * settings.position_noise
    if settings.border == "reflect":
        x, vx = _reflect(x, vx, arena.width)
        y, vy = _reflect(y, vy, arena.height)
    weights = particles.weights * survival_probability(dt, settings)
    inside = (x >= 0.0) & (x <= arena.width) & (y >= 0.0) & (y <= arena.height)
    return Particles(np.column_stack([x, y, vx, vy]), np.where(inside, weights, 0.0), particles.ids)


def _reflect(place: np.ndarray, speed: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    low, high = place < 0.0, place > length
    mirrored = np.where(low, -place, np.where(high, 2.0 * length - place, place))
    return mirrored, np.where(low | high, -speed, speed)


def exp_minus(values: np.ndarray) -> np.ndarray:
    """exp(-x) for x >= 0, relative error below 2e-12 up to 18 (a gate of 6), from multiplications alone and so bit-equal everywhere.

    A Taylor polynomial of x/64 by Horner's rule, squared six times.
    """
    small = values * (1.0 / 64.0)
    result = np.full_like(small, 1.0 / 3628800.0)
    for coefficient in (1.0 / 362880, 1.0 / 40320, 1.0 / 5040, 1.0 / 720, 1.0 / 120, 1.0 / 24, 1.0 / 6, 0.5, 1.0, 1.0):
        result = result * -small + coefficient
    for _ in range(6):
        result = result * result
    return result


def likelihood_noise(noise: float, settings: FilterSettings) -> float:
    """Standard deviation of a detection about a particle, m: of the sensor, and of the place that a particle stands for.

    `particles_per_target` particles of a cloud that is spread by `position_noise` in every step each stand for a Gaussian of that
    spread times N^(-1/6), Silverman's rule in the plane, times `roughening`; without it an accurate sensor leaves but a few of them.
    """
    width = settings.roughening * settings.position_noise * settings.particles_per_target ** (-1.0 / 6.0)
    return math.sqrt(noise * noise + width * width)


def update(
    particles: Particles, scans: list[Scan], tick: int, seed: int, noise: float, settings: FilterSettings, birth: BirthSettings
) -> Particles:
    """The PHD after all scans of a tick, one after the other (iterated corrector), births appended in the order of detections.

    For each scan with clutter density kappa: w <- w m + sum over detections z of w p_d g(z) / (kappa + p_d(z) b(z) +
    sum of w p_d g(z)), with m the factor of a miss (`missed`), g a Gaussian cut at `gate` standard deviations, and b(z) the density
    of targets not yet represented. The term p_d b(z) becomes `copies` new particles around z.
    """
    predicted = particles
    for scan in scans:
        corrected, per_copy = correct(particles, predicted, scan, noise, settings, birth)
        particles = Particles(particles.states, corrected, particles.ids)
        if birth.measurement and len(scan.detections):
            particles = join([particles, measurement_births(scan, per_copy, tick, seed, noise, settings, birth)])
    return particles


def correct(
    particles: Particles, predicted: Particles, scan: Scan, noise: float, settings: FilterSettings, birth: BirthSettings
) -> tuple[np.ndarray, np.ndarray]:
    """The weights (N,) after one scan, and the weight of each copy of a measurement birth at each detection (M,)."""
    probability = scan.sensor.probability(particles.states[:, :2], scan.pose)
    spread = likelihood_noise(noise, settings)
    squared = squared_distances(particles.states, scan.detections)
    within = (squared <= (settings.gate * spread) ** 2) & (probability > 0.0)[:, None]
    rows, columns = np.nonzero(within)
    likelihood = exp_minus(squared[rows, columns] * (0.5 / (spread * spread))) * (1.0 / (2.0 * math.pi * spread * spread))
    shares = np.zeros(within.shape)
    shares[rows, columns] = particles.weights[rows] * probability[rows] * likelihood
    sums = column_sums(shares)
    density = birth_density(predicted, scan, sums / _positive(scan.clutter_density + sums), birth)
    fresh = scan.sensor.probability(scan.detections, scan.pose) * density
    norms = _positive(scan.clutter_density + fresh + sums)
    gained = np.zeros(len(particles.weights))
    for number in range(len(norms)):
        gained = gained + shares[:, number] / norms[number]
    born = fresh / norms
    return particles.weights * missed(particles, probability, gained, scan.detections, born, settings) + gained, born / birth.copies


def _positive(values: np.ndarray) -> np.ndarray:
    return np.where(values > 0.0, values, 1.0)


def missed(
    particles: Particles, probability: np.ndarray, gained: np.ndarray, detections: np.ndarray, born: np.ndarray, settings: FilterSettings
) -> np.ndarray:
    """The factors (N,) of the particles, should their targets have been missed: (r / M) (1 - p_d) / (1 - p_d min(r, c)), 1 out of view.

    M is the mass in view near a particle, and r what the detections leave of it: M less what particles (`gained`, (N,)) and births
    (`born`, (M,)) near it got of them. A target that is there with probability r, and is not seen, is there with probability
    r (1 - p_d) / (1 - r p_d): by Bayes' rule for one target, where the PHD filter has r (1 - p_d), that of a Poisson number of them.
    With little mass near both are the same. Near means within two bins of `vicinity` / 3; c is `certainty`.
    """
    side, seen = settings.vicinity / BINS, probability > 0.0
    places = np.floor(np.vstack([particles.states[:, :2], detections]) / side).astype(np.int64)
    if not len(particles.weights):
        return np.ones(0)
    left, low = places.min(axis=0) - 2
    shape = tuple((places.max(axis=0) - (left, low) + 3)[::-1])
    flat = (places[:, 1] - low) * shape[1] + (places[:, 0] - left)
    own = flat[: len(gained)]
    masses = block_sums(np.bincount(own, np.where(seen, particles.weights, 0.0), shape[0] * shape[1]).reshape(shape), 2).ravel()[own]
    explained = block_sums(np.bincount(flat, np.concatenate([gained, born]), shape[0] * shape[1]).reshape(shape), 2).ravel()[own]
    rest = np.maximum(masses - explained, 0.0)
    factors = rest / _positive(masses) * ((1.0 - probability) / (1.0 - probability * np.minimum(rest, settings.certainty)))
    return np.where(seen, factors, 1.0)


def sample_size(mass: float, settings: FilterSettings) -> int:
    """Number of particles for a mass in expected targets: `particles_per_target` each, within the limits per owner."""
    return min(max(round(settings.particles_per_target * mass), settings.least_particles), settings.most_particles)


def sample_offset(seed: int, owner: str, tick: int) -> float:
    """The one uniform of a systematic draw, in [0, 1)."""
    return (key(seed, "resample", owner, tick) >> 11) * 2.0**-53


def resample(particles: Particles, owner: str, tick: int, seed: int, settings: FilterSettings) -> Particles:
    """Equally weighted particles of the same mass: systematic resampling with one uniform keyed by (seed, owner, tick).

    The first copy of a particle keeps its id, further copies get new ones. States are rounded to the precision of the wire: the
    owner keeps what it says. Ascending ids.
    """
    sums = np.add.accumulate(particles.weights)
    mass = float(sums[-1]) if len(sums) else 0.0
    if mass <= 0.0:
        return NONE
    count = sample_size(mass, settings)
    marks = (np.arange(count) + sample_offset(seed, owner, tick)) * (mass / count)
    parents = np.minimum(np.searchsorted(sums, marks, side="right"), len(sums) - 1)
    copies = np.arange(count) - np.searchsorted(parents, parents, side="left")
    ids = particles.ids[parents]
    again = copies > 0
    ids[again] = scramble(ids[again] + copies[again].astype(np.uint64), key(seed, "split", tick))
    states = particles.states[parents].astype(WIRE).astype(float)
    return canonical(Particles(states, np.full(count, mass / count), ids))
