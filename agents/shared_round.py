"""What all agents that hold the same table of gossips compute alike: the cells, the claims, and the update of every region.

A table keeps it, once it has been computed for all. The first agent that asks computes its own region alone, because in a process of
its own it is the only one; the second request for the same table object shows that several agents share a process, and is answered
with all regions in one call. The bits are the same either way.
"""

from typing import NamedTuple

import numpy as np

from agents.backend import Backend
from agents.coverage.cells import Cell
from agents.gossip.table import GossipTable
from agents.tracking.claims import NO_CLAIM, Claim
from agents.tracking.step import Step
from agents.tracking.tracker import AnyTracker, RegionInput, Update

ASKED = "asked"  # one agent has asked for the table, or several certainly will


class SharedRound(NamedTuple):
    """The regions of all whose gossips the table holds, in its order, and their updates."""

    step: Step
    tracker: AnyTracker
    cells: list[Cell]
    regions: list[RegionInput]
    updates: list[Update]


def shared_round(table: GossipTable, backend: Backend, tracker: AnyTracker, step: Step, arena: np.ndarray) -> SharedRound | None:
    """What the table keeps for these settings; None: this is the first agent that asks, or tables are not shared."""
    if step.config.timing.interest != "all" or table.listening:
        return None
    known, table.shared = table.shared, table.shared or ASKED
    if isinstance(known, SharedRound) and known.step.config is step.config and known.step.tick == step.tick and known.tracker == tracker:
        return known
    if known is not None:
        table.shared = _computed(table, backend, tracker, step, arena)
    return table.shared if known is not None else None


def _computed(table: GossipTable, backend: Backend, tracker: AnyTracker, step: Step, arena: np.ndarray) -> SharedRound:
    cells = backend.cut_cells(range(len(table.names)), table.points, table.radii, arena)
    regions = [
        RegionInput(gossip.sender, row, announced_sensor.sensor, gossip.pose, cell.polygon, claim_of(cell, table.names, table.generators))
        for row, (gossip, announced_sensor, cell) in enumerate(zip(table.gossips, table.sensors, cells))
    ]
    return SharedRound(step, tracker, cells, regions, [*tracker.update(table, table, regions, step)])


def claim_of(cell: Cell, names: tuple[str, ...], generators: np.ndarray) -> Claim:
    """A cell as generators, the own one first; the names are in order, so the generator of the smaller index comes first."""
    if not cell.bounds:
        return NO_CLAIM
    bounds = np.array(cell.bounds)
    return Claim(tuple([names[index] for index in cell.bounds]), generators[bounds], bounds < cell.bounds[0])
