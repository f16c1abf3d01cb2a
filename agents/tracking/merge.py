"""Copies of the particles of other agents: the copies after a round, and their merge with received particles or components.

Rules. A received particle replaces a copy with the same id. Copies remain only with mass, inside the arena and within the horizon.
Compiled twin of `remote_copies`: agents/compiled/copy_kernels.py.
"""

import math

import numpy as np

from agents.tracking import claims
from agents.tracking.claims import Claim
from agents.tracking.particles import Particles, T, canonical, join, select
from agents.tracking.phd import predict
from agents.tracking.step import Step
from protocol import geometry


def remote_copies(near: Particles, density: Particles, polygon: np.ndarray, claim: Claim, horizon: float, step: Step) -> Particles:
    """The copies after a round, all of positive weight: particles `near` the cell, then those of the `density` one step before.

    Of the corrected particles `near` the cell, those in the arena and outside the claim are copies. Of the density, moved
    by one step, those farther than the halo and within `horizon` m of the cell are copies. `polygon` (V, 2) is the cell, m.
    """
    arena, states = step.config.arena, near.states
    others = select(near, ~claims.owned(states, claim, arena) & claims.in_arena(states, arena))
    moved = predict(density, step)
    away = geometry.distances(polygon, moved.states)
    apart, within = away > step.config.filter.halo, (away <= horizon) | (horizon == math.inf)
    copies = join([others, select(moved, apart & within)])
    return select(copies, copies.weights > 0.0)


def merge(received: T, kept: np.ndarray, copies: T, free: np.ndarray) -> T:
    """The `kept` received rows and the `free` copies in canonical order; a received row replaces a copy with the same id."""
    return canonical(join([select(received, kept), select(copies, free)]))
