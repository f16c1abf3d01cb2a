"""The arithmetic of a round: the same functions in plain numpy or compiled, bit for bit the same, chosen when an agent is made."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agents import cells, claims, phd
from agents.births import background_births, near_part
from agents.cells import Cell
from agents.claims import Claim
from agents.extraction import estimate_targets
from agents.interest import Choice, wanted
from agents.particles import Particles, canonical, join, select, total
from agents.step import Step
from agents.words import Words, particles_of
from protocol import geometry
from protocol.sensing import Pose, SensorModel
from protocol.settings import ArenaSettings


class Task(NamedTuple):
    """What a round knows once its cell is cut."""

    owner: str
    sensor: SensorModel
    pose: Pose
    told: Words | Particles  # everything that counts, one tick before
    words: Words  # the scans
    births: Particles  # of the background
    polygon: np.ndarray  # the own cell
    claim: Claim
    step: Step


class Refreshed(NamedTuple):
    """What a round makes of the particles around the own cell."""

    updated: Particles  # within the halo of the cell, after all scans
    own: Particles  # of those in the cell
    kept: Particles  # drawn from the own ones
    mass: float  # in the cell, expected targets
    east: float  # the mass-weighted sums of x and y in the cell, m (17)
    north: float
    load: float  # the integrals of v and of p_d v over the footprint (10), expected targets
    detected: float
    targets: np.ndarray  # estimates in the cell (M, 2), m


class Parts(NamedTuple):
    """The cells and the claims of all who speak, in the order of names."""

    cells: list[Cell]
    claims: list[Claim]


class Arithmetic(NamedTuple):
    """One implementation of everything that a round computes per particle or per corner."""

    cut: Callable[..., Cell]
    cut_all: Callable[..., list[Cell]]
    distances: Callable[..., np.ndarray]
    owned: Callable[..., np.ndarray]
    unclaimed: Callable[..., np.ndarray]
    undisputed: Callable[..., np.ndarray]
    outlying: Callable[..., Particles]
    unite: Callable[[Particles, np.ndarray, Particles, np.ndarray], Particles]
    births: Callable[[Step], Particles]
    predict: Callable[[Particles, Step], Particles]
    gather: Callable[..., tuple[Particles, Particles]]
    update: Callable[[Particles, Words, np.ndarray, Step], Particles]
    take: Callable[[Particles, Claim, ArenaSettings], Particles]
    resample: Callable[[Particles, str, Step], Particles]
    estimate_targets: Callable[..., np.ndarray]
    moments: Callable[[Particles], tuple[float, float, float]]
    in_view: Callable[[Particles, SensorModel, Pose], tuple[float, float]]
    refresh: Callable[[Task], Refreshed]  # all the steps from `gather` on
    refresh_all: Callable[[Words, Particles, Parts, Step], list[Refreshed]]  # of all whose words these are
    wanted: Callable[..., Choice]


def births(step: Step) -> Particles:
    """The new particles of the background (`births.background_births`)."""
    config = step.config
    return background_births(config.filter.seed, step.tick, config.run.dt, config.filter, config.birth, config.arena)


def predict(particles: Particles, step: Step) -> Particles:
    """The particles one step on (`phd.predict`)."""
    config = step.config
    return phd.predict(particles, step.tick, config.filter.seed, config.run.dt, config.filter, config.arena)


def outlying(near: Particles, told: Particles, polygon: np.ndarray, claim: Claim, horizon: float, step: Step) -> Particles:
    """Copies after a round: of the particles corrected around a cell those in the arena that are not claimed; and, one step on, those
    told that are farther from the cell than its halo, and no farther than `horizon` m. Those without mass are left out."""
    arena, states = step.config.arena, near.states
    others = select(near, ~claims.owned(states, claim, arena) & claims.in_arena(states, arena))
    moved = predict(told, step)
    away = geometry.distances(polygon, moved.states)
    apart, within = away > step.config.filter.halo, (away <= horizon) | (horizon == math.inf)
    copies = join([others, select(moved, apart & within)])
    return select(copies, copies.weights > 0.0)


def unite(told: Particles, kept: np.ndarray, copies: Particles, free: np.ndarray) -> Particles:
    """Of what is told and of copies those that are chosen, in canonical order; of an id that occurs twice what was told."""
    return canonical(join([select(told, kept), select(copies, free)]))


def gather(
    particles: Particles, births: Particles, polygon: np.ndarray, eye: tuple[float, float], reach: float, step: Step
) -> tuple[Particles, Particles]:
    """Particles one step on, in canonical order, each id once: those within the halo of a polygon, with the births that lie there
    behind them; and of the others those within `reach` m of the point `eye`."""
    moved, halo = predict(canonical(particles), step), step.config.filter.halo
    close = geometry.distances(polygon, moved.states) <= halo
    born = select(births, geometry.distances(polygon, births.states) <= halo)
    dx, dy = moved.states[:, 0] - eye[0], moved.states[:, 1] - eye[1]
    return join([select(moved, close), born]), select(moved, ~close & (dx * dx + dy * dy <= reach * reach))


def update(particles: Particles, words: Words, polygon: np.ndarray, step: Step) -> Particles:
    """The PHD around a cell after all scans that reach it, of which the detections within the halo of the cell matter (`phd.update`)."""
    config, close = step.config, []
    for scan in words.scans():
        apart = geometry.distances(polygon, np.array([scan.pose]))[0]
        if apart <= config.filter.halo + scan.sensor.reach:
            close.append(near_part(scan, geometry.distances(polygon, scan.detections) <= config.filter.halo))
    return phd.update(particles, close, step.tick, config.filter.seed, config.detection.noise, config.filter, config.birth)


def take(particles: Particles, claim: Claim, arena: ArenaSettings) -> Particles:
    """The particles in a claimed cell, in canonical order."""
    return canonical(select(particles, claims.owned(particles.states, claim, arena)))


def resample(particles: Particles, owner: str, step: Step) -> Particles:
    """Equally weighted particles of the same mass (`phd.resample`)."""
    return phd.resample(particles, owner, step.tick, step.config.filter.seed, step.config.filter)


def moments(particles: Particles) -> tuple[float, float, float]:
    """Mass (expected targets), and the mass-weighted sums of x and y in m (17)."""
    weights, states = particles.weights, particles.states
    return total(weights), total(weights * states[:, 0]), total(weights * states[:, 1])


def in_view(particles: Particles, sensor: SensorModel, pose: Pose) -> tuple[float, float]:
    """The integrals of v and of p_d v over the footprint (10), expected targets."""
    probability = sensor.probability(particles.states[:, :2], pose)
    seen = np.where(probability > 0.0, particles.weights, 0.0)
    return total(seen), total(seen * probability)


def in_steps(arithmetic: Arithmetic, task: Task) -> Refreshed:
    """What an owner makes of its part of the PHD, step by step: predict, correct with all scans, take what is in the cell, draw."""
    step, claim, told = task.step, task.claim, particles_of(task.told)
    near, seen = arithmetic.gather(told, task.births, task.polygon, task.pose[:2], task.sensor.reach, step)
    updated = arithmetic.update(near, task.words, task.polygon, step)
    own = arithmetic.take(updated, claim, step.config.arena)
    mass, east, north = arithmetic.moments(own)
    near_load, near_detected = arithmetic.in_view(updated, task.sensor, task.pose)
    far_load, far_detected = arithmetic.in_view(seen, task.sensor, task.pose)
    kept = arithmetic.resample(own, task.owner, step)
    targets = np.empty((0, 2))
    if claim.names:
        targets = arithmetic.estimate_targets(updated, step.config.extraction)
        targets = targets[arithmetic.owned(targets, claim, step.config.arena)]
    return Refreshed(updated, own, kept, mass, east, north, near_load + far_load, near_detected + far_detected, targets)


def refresh(task: Task) -> Refreshed:
    """The plain steps one after the other."""
    return in_steps(PLAIN, task)


def one_by_one(refresh: Callable[[Task], Refreshed], words: Words, births: Particles, parts: Parts, step: Step) -> list[Refreshed]:
    """What each of those who speak makes of its part of the PHD, when nothing counts but what they say."""
    return [
        refresh(Task(gossip.sender, announced.sensor, gossip.pose, words, words, births, cell.polygon, claim, step))
        for gossip, announced, cell, claim in zip(words.gossips, words.sensors, parts.cells, parts.claims)
    ]


def refresh_all(words: Words, births: Particles, parts: Parts, step: Step) -> list[Refreshed]:
    """Each `refresh` one after the other."""
    return one_by_one(refresh, words, births, parts, step)


PLAIN = Arithmetic(
    cut=cells.cut,
    cut_all=cells.cut_all,
    distances=geometry.distances,
    owned=claims.owned,
    unclaimed=claims.unclaimed,
    undisputed=claims.undisputed,
    outlying=outlying,
    unite=unite,
    births=births,
    predict=predict,
    gather=gather,
    update=update,
    take=take,
    resample=resample,
    estimate_targets=estimate_targets,
    moments=moments,
    in_view=in_view,
    refresh=refresh,
    refresh_all=refresh_all,
    wanted=wanted,
)
