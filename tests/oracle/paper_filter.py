"""The particle PHD filter of sections II-C and IV with dice of its own: motion, births, misses, clutter, iterated corrector, redraw.

It is central: one PHD of the whole arena, corrected with the scans of all sensors. Settings are those that a run has recorded, as a
plain dictionary. What the paper leaves open is read as docs/evidence/paper.md says; so is the one rule of our own, that of a miss.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import norm

from tests.oracle.wedges import Pose, Wedge, sees

Settings = dict[str, Any]


class Phd(NamedTuple):
    """Particles: states (N, 4) of x, y, vx, vy in m and m/s; weights (N,) in expected targets."""

    states: np.ndarray
    weights: np.ndarray

    def mass(self, where: np.ndarray | None = None) -> float:
        """Expected targets, in all or where a mask (N,) says."""
        return math.fsum(self.weights if where is None else self.weights[where])

    def __add__(self, other: "Phd") -> "Phd":  # type: ignore[override]
        return Phd(np.vstack([self.states, other.states]), np.concatenate([self.weights, other.weights]))


NOTHING = Phd(np.empty((0, 4)), np.empty(0))


class Scan(NamedTuple):
    """What one sensor returned."""

    name: str
    wedge: Wedge
    pose: Pose
    detections: np.ndarray  # (M, 2), m
    clutter_density: float  # kappa, per m^2: what is expected per scan, uniform in the footprint


def public_order(scans: list[Scan]) -> list[Scan]:
    """The order of the scans of a tick in the corrector (docs/evidence/paper.md): by ascending p_d, then shorter names, then bytes."""
    return sorted(scans, key=lambda scan: (scan.wedge.prob, len(scan.name), scan.name.encode()))


def birth_density(predicted: Phd, scan: Scan, evidence: np.ndarray, birth: Settings) -> np.ndarray:
    """Density b of targets not yet represented at each detection, per m^2, within bounds; (M,).

    It is that of the predicted PHD nearby, less one target for each detection nearby as far as the PHD accounts for it: `evidence` (M,)
    is the PHD's density of detections, which competes with kappa alone.
    """
    kappa, most, reach = scan.clutter_density, birth["most_density"], birth["radius"]
    accounted = np.divide(evidence, kappa + evidence, out=np.zeros_like(evidence), where=evidence > 0.0)
    mutual = np.hypot(*(scan.detections[:, None] - scan.detections[None]).transpose(2, 0, 1)) <= reach
    targets = predicted.weights @ (_apart(predicted, scan.detections) <= reach) - accounted @ mutual
    least = max(birth["least_density"], min(birth["least_share"] * kappa, most / 2.0))
    return np.clip(targets / (math.pi * reach**2), least, None).clip(None, most)


def missed(phd: Phd, seen: np.ndarray, claimed: np.ndarray, scan: Scan, born: np.ndarray, motion: Settings) -> np.ndarray:
    """The mass (N,) that each particle keeps if its target was not detected.

    Of the mass M in view in the 5 x 5 squares of a third of the vicinity around a particle, r = M - (what detections are accounted for
    there, `claimed` by particles and `born`) is left. A Bernoulli target that is there with r and is missed with q is there afterwards with
    r q / (1 - r + r q), and that is shared out among the particles as their mass was. The probability r of no more than `certainty` counts.
    """
    side, view = motion["vicinity"] / 3.0, seen > 0.0
    squares, index = np.unique(np.floor(np.vstack([phd.states[:, :2], scan.detections]) / side), axis=0, return_inverse=True)
    columns, rows = squares.T
    around = (np.abs(columns[:, None] - columns) <= 2.0) & (np.abs(rows[:, None] - rows) <= 2.0)
    own, number = index.ravel()[: len(seen)], len(squares)
    mass = (around @ np.bincount(own[view], phd.weights[view], number))[own]
    left = np.clip(mass - (around @ np.bincount(index.ravel(), np.concatenate([claimed, born]), number))[own], 0.0, None)
    miss, sure = 1.0 - seen, np.minimum(left, motion["certainty"])
    kept = np.divide(left, mass, out=np.zeros(len(mass)), where=mass > 0.0) * miss / (1.0 - sure + sure * miss)
    return phd.weights * np.where(view, kept, 1.0)


def predict(phd: Phd, settings: Settings, dice: np.random.Generator) -> Phd:
    """One step on: constant speed, noisy heading, noisy position, survival; what leaves an open arena is gone."""
    motion, dt = settings["filter"], settings["run"]["dt"]
    heading = np.arctan2(phd.states[:, 3], phd.states[:, 2]) + motion["heading_noise"] * math.sqrt(dt) * dice.normal(size=len(phd.weights))
    velocity = motion["speed"] * np.column_stack([np.cos(heading), np.sin(heading)])
    place = phd.states[:, :2] + dt * velocity + motion["position_noise"] * dice.normal(size=(len(phd.weights), 2))
    sides = np.array([settings["arena"]["width"], settings["arena"]["height"]])
    if motion["border"] == "reflect":
        velocity = np.where((place < 0.0) | (place > sides), -velocity, velocity)
        place = np.where(place < 0.0, -place, np.where(place > sides, 2.0 * sides - place, place))
    weights = np.where(((place >= 0.0) & (place <= sides)).all(axis=1), _survival(settings) * phd.weights, 0.0)
    return Phd(np.hstack([place, velocity]), weights)


def prior(count: int, settings: Settings, dice: np.random.Generator) -> Phd:
    """The uniform PHD before the first tick."""
    width, height = settings["arena"]["width"], settings["arena"]["height"]
    mass = settings["filter"]["prior_density"] * width * height
    places = dice.uniform(size=(count, 2)) * [width, height]
    return Phd(np.hstack([places, _any_way(count, settings, dice)]), np.full(count, mass / count))


def background(settings: Settings, dice: np.random.Generator) -> Phd:
    """What enters in one step: density x speed x perimeter / pi per second, most of it on the border, inward by the cosine law.

    Nothing enters a closed arena, and there as many are born anywhere as die.
    """
    width, height = settings["arena"]["width"], settings["arena"]["height"]
    motion, birth = settings["filter"], settings["birth"]
    if not birth["background"]:
        return NOTHING
    count = birth["background_particles"]
    mass = motion["prior_density"] * motion["speed"] * 2.0 * (width + height) / math.pi * settings["run"]["dt"]
    closed = motion["border"] == "reflect"
    if closed:
        mass = motion["prior_density"] * width * height * (1.0 - _survival(settings))
    on_border = np.arange(count) < (0 if closed else round(birth["border_share"] * count))
    side = dice.choice(4, size=count, p=np.array([width, height, width, height]) / (2.0 * (width + height)))
    share, inward = dice.uniform(size=count), np.array([0.5, 1.0, 1.5, 2.0])[side] * math.pi
    x = np.select([side % 2 == 0, side == 1], [share * width, width], 0.0)
    y = np.select([side % 2 == 1, side == 2], [share * height, height], 0.0)
    heading = inward + np.arcsin(dice.uniform(-1.0, 1.0, size=count))
    entering = np.column_stack([x, y, motion["speed"] * np.cos(heading), motion["speed"] * np.sin(heading)])
    anywhere = np.hstack([dice.uniform(size=(count, 2)) * [width, height], _any_way(count, settings, dice)])
    return Phd(np.where(on_border[:, None], entering, anywhere), np.full(count, mass / count))


def correct(predicted: Phd, scans: list[Scan], settings: Settings, dice: np.random.Generator) -> Phd:
    """The PHD after all scans of a tick, one after the other: what is `missed` + sum over z of w p_d g / (kappa + p_d b + sum of w p_d g).

    g is a Gaussian cut at `filter.gate` standard deviations, those of the noise and of the place that a particle stands for; the share
    p_d b of a detection becomes new particles around it.
    """
    motion, noise, copies = settings["filter"], settings["detection"]["noise"], settings["birth"]["measurement_particles"]
    sigma = math.hypot(noise, motion["roughening"] * motion["position_noise"] / motion["particles_per_target"] ** (1.0 / 6.0))
    phd = predicted
    for scan in public_order(scans):
        seen = scan.wedge.prob * sees(scan.wedge, scan.pose, phd.states[:, :2])
        apart = _apart(phd, scan.detections)
        likelihood = np.where(apart <= motion["gate"] * sigma, (norm.pdf(apart / sigma) / sigma) * (norm.pdf(0.0) / sigma), 0.0)
        shares = (phd.weights * seen)[:, None] * likelihood
        fresh = np.zeros(len(scan.detections))
        if settings["birth"]["measurement"]:
            density = birth_density(predicted, scan, shares.sum(axis=0), settings["birth"])
            fresh = scan.wedge.prob * sees(scan.wedge, scan.pose, scan.detections) * density
        explained = scan.clutter_density + fresh + shares.sum(axis=0)
        explained[explained == 0.0] = 1.0
        claimed = (shares / explained).sum(axis=1)
        phd = Phd(phd.states, missed(phd, seen, claimed, scan, fresh / explained, motion) + claimed)
        if settings["birth"]["measurement"]:
            count = copies * len(fresh)
            places = np.repeat(scan.detections, copies, axis=0) + noise * dice.normal(size=(count, 2))
            phd += Phd(np.hstack([places, _any_way(count, settings, dice)]), np.repeat(fresh / explained / copies, copies))
    return phd


def within(phd: Phd, settings: Settings) -> Phd:
    """The part in the arena: a detection near the border may have given birth to particles beyond it, which are in nobody's cell."""
    places, sides = phd.states[:, :2], [settings["arena"]["width"], settings["arena"]["height"]]
    inside = ((places >= 0.0) & (places <= sides)).all(axis=1)
    return Phd(phd.states[inside], phd.weights[inside])


def redraw(phd: Phd, count: int, dice: np.random.Generator) -> Phd:
    """`count` particles of equal weight and the same mass, each drawn about as often as its weight says."""
    bounds = np.cumsum(phd.weights)
    marks = (np.arange(count) + dice.uniform()) * (bounds[-1] / count)
    return Phd(phd.states[np.searchsorted(bounds, marks).clip(max=len(bounds) - 1)], np.full(count, bounds[-1] / count))


class PaperFilter:
    """The filter over a whole run."""

    def __init__(self, settings: Settings, seed: int) -> None:
        self.settings, self.dice = settings, np.random.default_rng(seed)
        self._per_target = settings["filter"]["particles_per_target"]
        mass = settings["filter"]["prior_density"] * settings["arena"]["width"] * settings["arena"]["height"]
        self.phd = prior(max(1, round(self._per_target * mass)), settings, self.dice)

    def step(self, scans: list[Scan]) -> Phd:
        """The PHD after the next tick."""
        predicted = predict(self.phd, self.settings, self.dice) + background(self.settings, self.dice)
        phd = within(correct(predicted, scans, self.settings, self.dice), self.settings)
        self.phd = redraw(phd, max(1, round(self._per_target * phd.mass())), self.dice)
        return phd


def _survival(settings: Settings) -> float:
    """Of one step."""
    lifetime = settings["filter"]["lifetime"]
    return math.exp(-settings["run"]["dt"] / lifetime) if lifetime > 0.0 else 1.0


def _any_way(count: int, settings: Settings, dice: np.random.Generator) -> np.ndarray:
    """Velocities (N, 2) in any direction."""
    heading = dice.uniform(0.0, 2.0 * math.pi, size=count)
    return settings["filter"]["speed"] * np.column_stack([np.cos(heading), np.sin(heading)])


def _apart(phd: Phd, points: np.ndarray) -> np.ndarray:
    """Distances (N, M) of the particles from points (M, 2), m."""
    return np.hypot(phd.states[:, :1] - points[:, 0], phd.states[:, 1:2] - points[:, 1])
