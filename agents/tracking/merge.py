"""Merge: the first step of a round, which joins what all owners state with the copies that no fresh claim covers.

Rules, of particles and of components. Two claims overlap when their diagrams differ: within `timing.overlap` m of the border the targets of
both count, and deeper inside the smaller power distance wins. Agents with the same diagram have claims that tile the arena. An unknown
agent has cut another diagram, even if it states the same hash. A received target replaces a copy with the same id.
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from agents.backend import Backend
from agents.gossip.table import GossipTable
from agents.tracking.claims import end_to_end
from agents.tracking.gaussians import Mixture
from agents.tracking.particles import Particles, canonical, join, select
from agents.tracking.step import Step
from agents.tracking.tracker import OwnedState
from protocol.messages import Gossip

TargetSet = TypeVar("TargetSet", Particles, Mixture)


def merge(
    mine: OwnedState,
    copies: TargetSet,
    table: GossipTable,
    unknown: frozenset[str],
    step: Step,
    backend: Backend,
    owned_by_sender: Callable[[Gossip], OwnedState],
) -> TargetSet:
    """The targets that count one tick before `step`, in canonical order: what this agent owns, what others state, and the orphaned copies.

    `table` holds all gossips of the tick, the own one included, and `unknown` the senders in it that this agent did not know before.
    """
    owned, last = [mine], step.tick - 1
    owned += [owned_by_sender(gossip) for gossip in table.gossips if gossip.claim_tick == last and gossip.sender != mine.owner]
    received, claims = join([each.targets for each in owned]), end_to_end([each.claim for each in owned])
    # the complement of the hash that an unknown sender states is the hash of no other diagram
    hashes = [~each.diagram_hash if each.owner in unknown else each.diagram_hash for each in owned]
    sizes = [len(each.targets.ids) for each in owned]
    kept = backend.resolve_conflicts(received.states, sizes, claims, hashes, step.config.timing.overlap)
    return united(received, kept, copies, backend.orphaned(copies.states, claims, step.config.arena))


def united(received: TargetSet, kept: np.ndarray, copies: TargetSet, free: np.ndarray) -> TargetSet:
    """The `kept` received rows and the `free` copies in canonical order; a received row replaces a copy with the same id."""
    return canonical(join([select(received, kept), select(copies, free)]))
