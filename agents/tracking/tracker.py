"""The interface between a round and a tracker. `round.context_of` chooses the tracker; a gossip has fields for the targets of each.

Data types: a `RegionInput` is an owner with its cell; a `TrackerState` is the belief between two rounds; an `Update` is the result for
one cell; an `OwnedState` goes into the next gossip.

Rules. A round knows agents, cells and claims; the tracker alone knows how targets are represented. A `Tracker` is a set
of functions that give new values and keep their arguments; `belief.ParticlePhd` is one. Copies of others are computed when first needed.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, TypedDict, TypeVar

import numpy as np

from agents.config import FilterSettings
from agents.gossip.table import GossipTable
from agents.tracking.claims import Claim
from agents.tracking.extraction import TargetEstimates
from agents.tracking.particles import Particles
from agents.tracking.step import Step
from protocol.sensing import Pose, SensorModel


class RegionInput(NamedTuple):
    """An owner with its cell; it updates the region around the cell."""

    owner: str
    row: int  # of its gossip in the table of the round
    sensor: SensorModel
    pose: Pose
    polygon: np.ndarray  # the cell (V, 2), m
    claim: Claim  # the same as generators


class Diagram(NamedTuple):
    """The knowledge of an agent about the diagram that its cell was cut from."""

    hash: int  # agents with equal hashes cut the same diagram
    generator_names: frozenset[str]  # the agents with a generator in it
    known_names: frozenset[str] | None  # the agents known in that round; None if the agent receives all gossips
    horizon: float  # m from its cell: it keeps no copies farther away


class Update(Protocol):
    """The result of a round for the region of one owner."""

    @property
    def updated(self) -> Particles:
        """The density around the cell as weighted points, in no order."""

    @property
    def own(self) -> Particles:
        """The density in the cell as weighted points, for control laws that use it."""

    @property
    def mass(self) -> float:
        """Expected targets in the cell."""

    @property
    def moment_x(self) -> float:
        """The integral of x over the density in the cell, m (17)."""

    @property
    def moment_y(self) -> float:
        """The integral of y over the density in the cell, m (17)."""

    @property
    def load(self) -> float:
        """The integral of the density over the footprint (10), expected targets."""

    @property
    def detected(self) -> float:
        """The integral of p_d times the density over the footprint (10), expected targets."""

    @property
    def estimates(self) -> TargetEstimates:
        """Estimates in the cell, with identities."""


class OwnedState(NamedTuple):
    """The state that one agent owns after a round, as its next gossip states it."""

    owner: str
    claim: Claim
    particles: Particles
    diagram_hash: int  # of the diagram that its cell was cut from


class GossipFields(TypedDict, total=False):
    """The fields of a gossip that state an owned state (protocol/messages.py); what a tracker has no use for is missing."""

    weight: float
    states_bytes: bytes
    ids_bytes: bytes
    labels_bytes: bytes
    label_numbers_bytes: bytes
    particles: bytes  # states and ids in few bytes, if `filter.compact`
    components_bytes: bytes


class TrackerState(Protocol):
    """The belief that an agent holds between two rounds."""

    stamp: int  # the tick of its last round, or of the last prediction
    mine: Any  # the owned state, stated in the next gossip: owner, claim and hash of the diagram, and what the tracker says of its targets
    generator_names: frozenset[str]  # see `Diagram`
    known_names: frozenset[str] | None  # see `Diagram`

    @property
    def claim_tick(self) -> int:
        """The tick of the round in which the claim was cut."""


def unknown_senders(belief: TrackerState, table: GossipTable) -> frozenset[str]:
    """The senders in a table that the agent did not know in its last round: they have cut other diagrams, whatever hash they state."""
    return frozenset() if belief.known_names is None else table.name_set - belief.known_names - {belief.mine.owner}


def claims_tile_arena(belief: TrackerState, table: GossipTable) -> bool:
    """Whether all agents of the diagram of the belief state claims of it: then what they own is the whole density.

    All newcomers share the hash of an empty diagram, 0. It claims nothing, so that their copies count.
    """
    agreed = belief.mine.diagram_hash != 0 and table.claimed == (belief.claim_tick, belief.mine.diagram_hash)
    return agreed and bool(belief.generator_names) and belief.generator_names <= table.name_set and not unknown_senders(belief, table)


B = TypeVar("B", bound=TrackerState)
R = TypeVar("R")
U = TypeVar("U", bound=Update)


class Tracker(Protocol[B, R, U]):
    """The functions of a tracker: pure functions of beliefs, gossips and regions."""

    def start(self, name: str, step: Step, box: tuple[float, float, float, float] | None = None) -> B:
        """The belief before the first round: the prior, and nothing owned; of the surroundings of a rectangle alone, if one is given.

        A rectangle is west, south, east and north, m.
        """

    def gossip_fields(self, mine: Any, settings: FilterSettings) -> GossipFields:
        """What a gossip carries of an owned state."""

    def weighted_points(self, density: R | GossipTable) -> Particles:
        """The density that counts as weighted points, for control laws that search."""

    def catch_up(self, belief: B, step: Step) -> B:
        """The belief at the tick before `step.tick`, without a claim if that round was missed. `update` predicts the rest."""

    def keep_claim(self, belief: B, step: Step, alone: U | None = None) -> B:
        """The belief at the tick before `step.tick`, of an agent that skipped rounds: it keeps its claim.

        `alone`: its own update of that tick, if there was one; what that left in the cell is owned.
        """

    def merge(self, belief: B, table: GossipTable, step: Step) -> R | GossipTable:
        """The density that counts at the tick before, given the gossips of this tick; the table itself if nothing else counts."""

    def update(self, density: R | GossipTable, table: GossipTable, regions: Sequence[RegionInput], step: Step) -> Sequence[U]:
        """For each owner the density around its cell one step later, corrected with the scans of the table, with moments and estimates."""

    def nearby(self, update: U) -> R:
        """The density around the cell after an update."""

    def belief_after(self, density: R | GossipTable, region: RegionInput, update: U, diagram: Diagram, step: Step) -> B:
        """The belief after the round: the owned state for the next gossip, and the copies of the others."""


AnyTracker = Tracker[Any, Any, Any]
