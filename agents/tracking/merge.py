"""Copies of what others own: which of them an agent keeps after a round, and how they join what is received in the next one."""

import math

import numpy as np

from agents.tracking import claims
from agents.tracking.claims import Claim
from agents.tracking.particles import Particles, canonical, join, select
from agents.tracking.regions import predict
from agents.tracking.step import Step
from protocol import geometry


def remote_copies(near: Particles, received: Particles, polygon: np.ndarray, claim: Claim, horizon: float, step: Step) -> Particles:
    """Copies after a round: of the particles corrected around a cell those in the arena that are not claimed; and, one step on, those
    received that are farther from the cell than its halo, and no farther than `horizon` m. Those without mass are left out."""
    arena, states = step.config.arena, near.states
    others = select(near, ~claims.owned(states, claim, arena) & claims.in_arena(states, arena))
    moved = predict(received, step)
    away = geometry.distances(polygon, moved.states)
    apart, within = away > step.config.filter.halo, (away <= horizon) | (horizon == math.inf)
    copies = join([others, select(moved, apart & within)])
    return select(copies, copies.weights > 0.0)


def merge(received: Particles, kept: np.ndarray, copies: Particles, free: np.ndarray) -> Particles:
    """Of what is received and of copies those that are chosen, in canonical order; of an id that occurs twice what was received."""
    return canonical(join([select(received, kept), select(copies, free)]))
