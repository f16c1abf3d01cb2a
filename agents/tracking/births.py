"""Births of particles: the prior, the background births, and the births at detections.

Data types: a `Scan` is the detections of one sensor in a tick, with its pose and clutter density.

Rules. The state and the id of a birth are pure functions of shared keys and, at detections, of the detection. All agents that
cover a place therefore make the same particles there, and the cells decide their owners.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from agents.config import BirthSettings, FilterSettings
from agents.tracking.labels import birth_labels
from agents.tracking.measurement_likelihood import BEARING, EXACT_POSE, birth_places, kernel_variance, model_of, noise_of, sigma_poses
from agents.tracking.particles import NO_PARTICLES, WIRE_TYPE, Particles, canonical, mass_within, select, unlabelled
from agents.tracking.step import Step
from protocol.compact_particles import DIRECTIONS
from protocol.random_streams import normal, random_key, scramble, uniform
from protocol.sensing import Pose, SensorModel, measurement_of
from protocol.settings import ArenaSettings

SQUARE = 25.0  # m, side of the squares of the prior in which an agent starts


class Scan(NamedTuple):
    """The detections of one sensor in a tick, or those near a region."""

    salt: int  # the key of the sensor's name
    sensor: SensorModel
    pose: Pose
    detections: np.ndarray  # (M, 2) float64: their places, m
    indices: np.ndarray  # (M,) uint64: the index of each detection in the whole scan
    clutter_density: float  # kappa, per m^2
    rays: np.ndarray | None = None  # (M, 4) of agents/tracking/measurement_likelihood.py; None if these are positions from an exact pose
    pose_noise: tuple[float, float] = EXACT_POSE  # standard deviations of the pose, m on each axis and rad

    def probability(self, points: np.ndarray) -> np.ndarray:
        """p_d of points (N, 2): (N,), the mean over the poses that the sensor may have."""
        poses = sigma_poses(self.pose, self.pose_noise)
        found = self.sensor.probability(points, poses[0])
        for pose in poses[1:]:
            found = found + self.sensor.probability(points, pose)
        return found / float(len(poses))


def near_part(scan: Scan, close: np.ndarray) -> Scan:
    """The scan with the detections chosen by a mask (M,) alone."""
    rays = None if scan.rays is None else scan.rays[close]
    return scan if close.all() else scan._replace(detections=scan.detections[close], indices=scan.indices[close], rays=rays)


def prior_size(filters: FilterSettings, arena: ArenaSettings) -> int:
    """Number of particles of the prior over the whole arena: enough for its mass, and at least `prior_particles` per m^2.

    The default is `least_particles` for each of the 16 agents of team 1 in its 40 x 40 m, the paper's densest team.
    """
    return round(max(filters.particles_per_target * filters.prior_density, filters.prior_particles) * arena.width * arena.height)


@lru_cache(maxsize=2)
def prior(seed: int, count: int, settings: FilterSettings, arena: ArenaSettings) -> Particles:
    """The uniform PHD of density `prior_density` per m^2 with which all agents start, as `count` particles; a pure memo."""
    mass = settings.prior_density * arena.width * arena.height
    if count == 0 or mass == 0.0:
        return NO_PARTICLES
    ids = _numbered(random_key(seed, "prior"), count)
    x = uniform(scramble(ids, 1)) * arena.width
    y = uniform(scramble(ids, 2)) * arena.height
    states = np.column_stack([x, y, _directions(scramble(ids, 3)) * settings.speed])
    return canonical(unlabelled(states.astype(WIRE_TYPE).astype(float), np.full(count, mass / count), ids))


@lru_cache(maxsize=2)
def _places(seed: int, count: int, settings: FilterSettings, arena: ArenaSettings) -> np.ndarray:
    """x and y (2, N) of the prior, m, each in a row of memory, which is searched faster; a pure memo."""
    return prior(seed, count, settings, arena).states[:, :2].T.copy()


def prior_around(
    seed: int, count: int, settings: FilterSettings, arena: ArenaSettings, box: tuple[float, float, float, float]
) -> Particles:
    """The particles of the prior in all squares of side `SQUARE` that touch a rectangle: west, south, east, north in m."""
    x, y = _places(seed, count, settings, arena)
    west, south = (side // SQUARE * SQUARE for side in box[:2])
    east, north = ((side // SQUARE + 1.0) * SQUARE for side in box[2:])
    return select(prior(seed, count, settings, arena), (x >= west) & (x < east) & (y >= south) & (y < north))


@lru_cache(maxsize=8)
def background_births(step: Step) -> Particles:
    """New particles of a tick over the whole arena, a pure function of (seed, tick) and a memo: all agents of a process need it.

    Their mass is the `inflow`. The first `starting_on_border` of them start on the border with headings inward (cosine law), the
    others anywhere.
    """
    settings, birth, arena = step.config.filter, step.config.birth, step.config.arena
    mass, count = inflow(step.config.run.dt, settings, arena), birth.background_particles
    if not birth.background or mass <= 0.0:
        return NO_PARTICLES
    width, height = arena.width, arena.height
    ids = _numbered(random_key(settings.seed, "background", step.tick), count)
    on_border = np.arange(count) < starting_on_border(settings, birth)
    along = uniform(scramble(ids, 1)) * (2.0 * (width + height))
    sideways = 2.0 * uniform(scramble(ids, 2)) - 1.0  # the sine of a cosine-law heading is uniform
    inward = np.sqrt(1.0 - sideways * sideways)
    side = np.searchsorted([width, width + height, 2.0 * width + height], along, side="right")
    rest = along - np.array([0.0, width, width + height, 2.0 * width + height])[side]
    border = np.array([(1.0, 0.0, 0.0, 1.0), (0.0, 1.0, -1.0, 0.0), (-1.0, 0.0, 0.0, -1.0), (0.0, -1.0, 1.0, 0.0)])[side]  # tangent, inward
    corner = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])[side]
    anywhere = np.column_stack([along / (2.0 * (width + height)) * width, uniform(scramble(ids, 4)) * height])
    places = np.where(on_border[:, None], corner + border[:, :2] * rest[:, None], anywhere)
    headings = border[:, :2] * sideways[:, None] + border[:, 2:] * inward[:, None]
    headings = np.where(on_border[:, None], headings, _directions(scramble(ids, 3)))
    return unlabelled(np.column_stack([places, headings * settings.speed]), np.full(count, mass / count), ids)


def inflow(dt: float, settings: FilterSettings, arena: ArenaSettings) -> float:
    """Expected new targets in `dt` s at the stationary density `prior_density`.

    Targets cross the border inwards at density x speed x perimeter / pi per second. No target crosses a reflecting border: there births
    replace deaths, and unobserved ground keeps the mass of the prior.
    """
    if settings.border == "reflect":
        return settings.prior_density * arena.width * arena.height * (1.0 - survival_probability(dt, settings))
    return settings.prior_density * settings.speed * 2.0 * (arena.width + arena.height) / math.pi * dt


def survival_probability(dt: float, settings: FilterSettings) -> float:
    """Probability that a target of mean lifetime `lifetime` s lives another dt s."""
    return math.exp(-dt / settings.lifetime) if settings.lifetime > 0.0 else 1.0


def starting_on_border(settings: FilterSettings, birth: BirthSettings) -> int:
    """The number of background births that start on the border."""
    return 0 if settings.border == "reflect" else round(birth.border_share * birth.background_particles)


def _numbered(salt: int, count: int) -> np.ndarray:
    """The ids (count,) of the particles 0, 1, ... under the key `salt`."""
    return scramble(np.arange(count, dtype=np.uint64), salt)


def _directions(bits: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 2) in one of 4096 directions."""
    return DIRECTIONS[(bits >> np.uint64(52)).astype(np.int64)]


def birth_density(predicted: Particles, scan: Scan, explained: np.ndarray, birth: BirthSettings) -> np.ndarray:
    """Density of unrepresented targets at each detection, per m^2: (M,); 0 without measurement births.

    It is the predicted mass within `radius`, less the explained part of the detections there, by the area; clipped to
    [`least_density`, `most_density`]. `explained` (M,) is the part of each detection that the PHD explains, in targets.
    """
    if not birth.measurement:
        return np.zeros(len(scan.detections))
    if model_of(measurement_of(scan.sensor))[0] == BEARING:  # the place along the beam is not known
        return np.full(len(scan.detections), least_density(scan.clutter_density, birth))
    masses = mass_within(scan.detections, predicted.states, predicted.weights, birth.radius)
    known = mass_within(scan.detections, scan.detections, explained, birth.radius)
    local = (masses - known) / (math.pi * birth.radius * birth.radius)
    return np.minimum(np.maximum(local, least_density(scan.clutter_density, birth)), birth.most_density)


def least_density(clutter_density: float, birth: BirthSettings) -> float:
    """The lower limit of a birth density, per m^2: above 0 without clutter, and at most half of `most_density` with much clutter."""
    return min(max(birth.least_density, min(birth.least_share * clutter_density, 0.5 * birth.most_density)), birth.most_density)


def measurement_births(scan: Scan, per_particle: np.ndarray, labels: np.ndarray, step: Step) -> Particles:
    """New particles around each detection, of weight `per_particle` (M,) and with the labels (M,) of the detections.

    Ids and offsets from the detection are pure functions of (seed, sensor, detection number, tick, number of the particle).
    """
    settings, noise, count = step.config.filter, step.config.detection.noise, step.config.birth.measurement_particles
    numbers = np.repeat(scan.indices * np.uint64(count), count) + np.tile(np.arange(count, dtype=np.uint64), len(scan.indices))
    ids = scramble(numbers, random_key(settings.seed, "birth", step.tick, scan.salt))
    places = np.repeat(scan.detections, count, axis=0)
    if scan.rays is not None:
        scan_noise = noise_of(model_of(measurement_of(scan.sensor)), noise, kernel_variance(settings), scan.pose_noise)
        places = birth_places(ids, scan.pose, places, np.repeat(scan.rays, count, axis=0), scan.sensor.reach, scan_noise)
    else:
        x, y = places[:, 0] + normal(scramble(ids, 1)) * noise, places[:, 1] + normal(scramble(ids, 2)) * noise
        places = np.column_stack([x, y])
    places, velocities = close_by(places, step.config.arena), _directions(scramble(ids, 3)) * settings.speed
    return Particles(np.column_stack([places, velocities]), np.repeat(per_particle, count), ids, np.repeat(labels, count))


def close_by(places: np.ndarray, arena: ArenaSettings) -> np.ndarray:
    """The places (N, 2), each axis no farther outside of the arena than it is long: a false measurement may bear particles anywhere."""
    size = np.array([arena.width, arena.height])
    return np.clip(places, -size, 2.0 * size)


def founded_labels(scan: Scan, step: Step) -> np.ndarray:
    """The labels (M,) that the detections of a scan found, each from the id of the first of its births."""
    first = scan.indices * np.uint64(step.config.birth.measurement_particles)
    return birth_labels(scramble(first, random_key(step.config.filter.seed, "birth", step.tick, scan.salt)), step.tick)
