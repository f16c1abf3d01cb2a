"""What all agents with the same table of gossips compute alike: the cells, the claims and the update of every region.

The first agent that asks computes its own region alone: in a process of its own it is the only one. A second request for the same table
object shows that several agents share a process. Then all regions are computed in one call, and the table keeps them. In the next tick the
first request computes them. The bits are the same either way.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from agents.backend import Backend
from agents.gossip.table import GossipTable
from agents.tracking.claims import claim_of
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput, RegionUpdate, Tracker

_BATCHED: deque[Step] = deque(maxlen=1)  # of the last batched round: the next one will be asked for as often
ASKED = "asked"  # one agent has asked for the table


class BatchedRound(NamedTuple):
    """The regions of all senders in a table, in its order, and their updates."""

    step: Step
    tracker: Tracker
    regions: list[RegionInput]
    updates: list[RegionUpdate]


def batched_round(table: GossipTable, backend: Backend, tracker: Tracker, step: Step, arena: np.ndarray) -> BatchedRound | None:
    """All regions of a table in one call, on the second request, or on the first one if the round of the tick before was batched.

    None for another first request, where agents hear neighbours only, and while a sender listens.
    """
    if step.config.timing.interest != "all" or table.listening:
        return None
    known, table.batched = table.batched, table.batched or ASKED
    if isinstance(known, BatchedRound) and known.step.config is step.config and known.step.tick == step.tick and known.tracker == tracker:
        return known
    if known is None and not (_BATCHED and _BATCHED[0].config is step.config and _BATCHED[0].tick == step.tick - 1):
        return None
    _BATCHED.append(step)
    table.batched = _computed(table, backend, tracker, step, arena)
    return table.batched


def _computed(table: GossipTable, backend: Backend, tracker: Tracker, step: Step, arena: np.ndarray) -> BatchedRound:
    """All regions of a table and their updates."""
    cells = backend.cut_cells(range(len(table.names)), table.generators, arena)
    regions = [
        RegionInput(gossip.sender, row, announced.sensor, gossip.pose, cell.polygon, claim_of(cell, table.names, table.generators))
        for row, (gossip, announced, cell) in enumerate(zip(table.gossips, table.sensors, cells))
    ]
    return BatchedRound(step, tracker, regions, [*tracker.update(table, table, regions, step)])
