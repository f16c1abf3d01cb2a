"""The backend: the functions of a round that exist twice, in plain numpy and compiled, with equal bits.

An agent gets one backend when it is made. `PLAIN` is the reference; `agents.compiled.backend.FAST` holds the compiled functions.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agents.coverage import cells, search_plan
from agents.coverage.cells import Cell
from agents.interest.selection import Selection, select_peers
from agents.tracking import claims, regions
from agents.tracking.births import background_births
from agents.tracking.particles import Particles
from agents.tracking.step import Step
from agents.tracking.tracker import RegionUpdate


class Backend(NamedTuple):
    """The functions that have a compiled twin."""

    cut_cells: Callable[..., list[Cell]]
    background_births: Callable[[Step], Particles]
    update_regions: Callable[..., list[RegionUpdate]]
    resolve_conflicts: Callable[..., np.ndarray]
    orphaned: Callable[..., np.ndarray]
    remote_copies: Callable[..., Particles]
    select_peers: Callable[..., Selection]
    decide: Callable[..., search_plan.Decision]


PLAIN = Backend(
    cut_cells=cells.cut_cells,
    background_births=background_births,
    update_regions=regions.update_regions,
    resolve_conflicts=claims.resolve_conflicts,
    orphaned=claims.orphaned,
    remote_copies=regions.remote_copies,
    select_peers=select_peers,
    decide=search_plan.decide,
)
