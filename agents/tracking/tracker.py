"""The interface between a round and a tracker. `round.context_of` chooses the tracker; a gossip has fields for the targets of each.

Data types: a `RegionInput` is an owner with its cell; a `RegionUpdate` is the result for it; a `Belief` is held between two rounds; its
`OwnedState` goes into the next gossip. The density, the owned targets and the copies in them are of the tracker's own types.

Rules. A round knows agents, cells and claims; the tracker alone knows how targets are represented. A `Tracker` is a set
of functions that give new values; `belief.ParticlePhd` is one. Copies of others are computed when first needed, and kept in the belief
that they belong to.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from agents.config import AgentConfig, FilterSettings
from agents.gossip.table import GossipTable
from agents.tracking.claims import NO_CLAIM, Claim
from agents.tracking.extraction import TargetEstimates
from agents.tracking.particles import Particles
from agents.tracking.step import Step
from protocol.sensing import Pose, SensorModel

# ticks over which copies are moved at most. What has moved for so long may be anywhere. Nothing is born on the way, so that more ticks
# would only empty the arena
MOST_MISSED = 256


class RegionInput(NamedTuple):
    """An owner with its cell; it updates the region around the cell."""

    owner: str
    row: int  # of its gossip in the table of the round
    sensor: SensorModel
    pose: Pose
    polygon: np.ndarray  # the cell (V, 2), m
    claim: Claim  # the same as generators


class KnownDiagram(NamedTuple):
    """The knowledge of an agent about the diagram that its cell was cut from."""

    hash: int  # agents with equal hashes cut the same diagram
    generator_names: frozenset[str]  # the agents with a generator in it
    known_names: frozenset[str] | None  # the agents known in that round; None if the agent receives all gossips
    copy_distance: float  # m from its cell: it keeps no copies farther away


class RegionUpdate(NamedTuple):
    """The result of a round for one owner: the density around its cell as the tracker represents it, with moments and estimates."""

    updated: Any  # around the cell, after all scans, in no order
    own: Any  # in the cell
    resampled: Any  # in the cell, for the next gossip: drawn from `own`, or `own` itself
    mass: float  # in the cell, expected targets
    moment_x: float  # the integrals of x and y over the density in the cell, m (17)
    moment_y: float
    load: float  # the integrals of v and of p_d v over the footprint (10), expected targets
    detected: float
    estimates: TargetEstimates  # in the cell, with identities


class OwnedState(NamedTuple):
    """The state that one agent owns after a round, as its next gossip states it."""

    owner: str
    claim: Claim
    targets: Any  # as the tracker represents them
    diagram_hash: int  # of the diagram that its cell was cut from


@dataclass
class Belief:
    """The belief of an agent after the round of a tick: its owned state, and copies of what the others own."""

    tick: int  # of its last round, or of the last prediction
    mine: OwnedState
    copies: Any  # as the tracker represents them
    generator_names: frozenset[str] = frozenset()  # the agents with a generator in the diagram of `mine`
    known_names: frozenset[str] | None = None  # the agents known in that round; None if the agent receives all gossips
    kept_since: int | None = None  # the claim was cut in this round and kept over skipped ones; None: it was cut at `tick`

    @property
    def claim_tick(self) -> int:
        """The tick of the round in which the claim was cut."""
        return self.tick if self.kept_since is None else self.kept_since


def missed_steps(belief: Belief, step: Step) -> tuple[Step, ...]:
    """The steps between the tick of a belief and `step`, of too many the last `MOST_MISSED`."""
    return tuple([step._replace(tick=tick) for tick in range(max(belief.tick + 1, step.tick - MOST_MISSED), step.tick)])


def belief_without_claim(owner: str, tick: int, nothing: Any, copies: Any) -> Belief:
    """The belief of an agent that claims and owns `nothing`: all targets are copies."""
    return Belief(tick, OwnedState(owner, NO_CLAIM, nothing, 0), copies)


def unknown_senders(belief: Belief, table: GossipTable) -> frozenset[str]:
    """The senders in a table that the agent did not know in its last round: they have cut other diagrams, whatever hash they state."""
    return frozenset() if belief.known_names is None else table.name_set - belief.known_names - {belief.mine.owner}


def claims_tile_arena(belief: Belief, table: GossipTable) -> bool:
    """Whether all agents of the diagram of the belief state claims of it: then what they own is the whole density.

    Before its first round an agent has cut no diagram, and its hash is 0: it claims nothing, so that its copies count.
    """
    agreed = belief.mine.diagram_hash != 0 and table.common_diagram == (belief.claim_tick, belief.mine.diagram_hash)
    return agreed and bool(belief.generator_names) and belief.generator_names <= table.name_set and not unknown_senders(belief, table)


class Tracker(Protocol):
    """The functions of a tracker: pure functions of beliefs, gossips and regions.

    A density is of the tracker's own type, or a table of gossips: then what these state counts, and nothing else.
    """

    def start(self, name: str, config: AgentConfig, box: tuple[float, float, float, float] | None = None) -> Belief:
        """The belief before the first round: the prior, and nothing owned; of the surroundings of a rectangle alone, if one is given.

        A rectangle is west, south, east and north, m.
        """

    def gossip_fields(self, mine: OwnedState, settings: FilterSettings) -> dict[str, Any]:
        """The fields of a gossip that state an owned state (protocol/messages.py), without those that the tracker has no use for."""

    def weighted_points(self, density: Any) -> Particles:
        """The density that counts as weighted points, for control laws that search."""

    def catch_up(self, belief: Belief, step: Step) -> Belief:
        """The belief at the tick before `step.tick`, without a claim if that round was missed. `update` predicts the rest.

        Copies move by the `missed_steps`.
        """

    def keep_claim(self, belief: Belief, step: Step, alone: RegionUpdate | None = None) -> Belief:
        """The belief at the tick before `step.tick`, of an agent that skipped rounds: it keeps its claim.

        `alone`: its own update of that tick, if there was one; what that left in the cell is owned.
        """

    def merge(self, belief: Belief, table: GossipTable, step: Step) -> Any:
        """The density that counts at the tick before, given the gossips of this tick; the table itself if nothing else counts."""

    def update(self, density: Any, table: GossipTable, regions: Sequence[RegionInput], step: Step) -> Sequence[RegionUpdate]:
        """For each owner the density around its cell one step later, corrected with the scans of the table, with moments and estimates."""

    def belief_after(self, density: Any, region: RegionInput, update: RegionUpdate, diagram: KnownDiagram, step: Step) -> Belief:
        """The belief after the round: the owned state for the next gossip, and the copies of the others."""
