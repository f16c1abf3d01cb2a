"""What a round asks of a tracker, so that another one is a matter of its own files.

A round knows agents, cells and claims. What is held of the targets is the tracker's: a `TrackerState` between two rounds, what the others
said in one, an `Update` around each cell. All of them are values. A tracker is a set of pure functions of them; `belief.ParticlePhd` is
one.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from agents.gossip.table import GossipTable
from agents.tracking.claims import Claim
from agents.tracking.particles import Particles
from agents.tracking.step import Step
from protocol.sensing import Pose, SensorModel


class RegionInput(NamedTuple):
    """An owner with its cell: the region around the cell is what it updates."""

    owner: str
    row: int  # of its gossip in the table of the round
    sensor: SensorModel
    pose: Pose
    polygon: np.ndarray  # the cell (V, 2), m
    claim: Claim  # the same as generators


class Diagram(NamedTuple):
    """What an agent knew of the diagram that its cell was cut from."""

    view: int  # agents with equal views cut the same diagram
    everyone: frozenset[str]  # whose generators made it
    acquainted: frozenset[str] | None  # which others it knew, if it hears only a part of all
    horizon: float  # m from its cell: it keeps nothing of what is farther away


class Update(Protocol):
    """What an owner makes of its region in a round."""

    @property
    def own(self) -> Particles:
        """The density in the cell as weighted points, for control laws that look at it."""

    @property
    def mass(self) -> float:
        """Expected targets in the cell."""

    @property
    def east(self) -> float:
        """The integral of x over the density in the cell, m (17)."""

    @property
    def north(self) -> float:
        """The integral of y over it, m."""

    @property
    def load(self) -> float:
        """The integral of the density over the footprint (10), expected targets."""

    @property
    def detected(self) -> float:
        """The integral of p_d times the density over the footprint, expected targets."""

    @property
    def targets(self) -> np.ndarray:
        """Estimates in the cell (M, 2), m."""


class OwnedState(NamedTuple):
    """What one agent owned after a round, as its next gossip says it."""

    owner: str
    claim: Claim
    particles: Particles
    view: int  # of the diagram that its cell was cut from


class TrackerState(Protocol):
    """What an agent holds between two rounds."""

    stamp: int  # the tick of the round after which it holds
    mine: OwnedState  # what goes into the next gossip
    everyone: frozenset[str]  # see `Diagram`


B = TypeVar("B", bound=TrackerState)
R = TypeVar("R")
U = TypeVar("U", bound=Update)


class Tracker(Protocol[B, R, U]):
    """The functions of a tracker."""

    def predict(self, belief: B, step: Step) -> B:
        """The belief at the tick before `step.tick`, for an agent that missed rounds: nothing in it is claimed any more."""

    def merge(self, belief: B, table: GossipTable, step: Step) -> R | GossipTable:
        """Everything at the tick before that counts, given the gossips of this one; the table itself if nothing else counts."""

    def update(self, received: R | GossipTable, table: GossipTable, regions: Sequence[RegionInput], step: Step) -> Sequence[U]:
        """Of each owner the density around its cell one step on, corrected with the scans of the table, with moments and estimates."""

    def share(self, received: R | GossipTable, region: RegionInput, update: U, diagram: Diagram, step: Step) -> B:
        """The belief after the round: what is owned, and goes into the next gossip, and what is kept of the others."""


AnyTracker = Tracker[Any, Any, Any]
