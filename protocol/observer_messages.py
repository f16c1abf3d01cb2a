"""The messages to observers, which no agent reads: estimates of the agents, and the truth of the world.

Arrays are raw little-endian bytes on the wire, as in `protocol.messages`. All lengths in m, times in s, angles in rad.
"""

import msgspec
import numpy as np

from protocol.cached_attribute import cached_attribute
from protocol.fields import (
    CELL,
    DETAILS,
    IDS,
    LABELS,
    LARGEST_LABEL,
    POSES,
    TARGETS,
    U8,
    Malformed,
    array_field,
    check_rows,
)
from protocol.message import (
    Area,
    Magnitude,
    Message,
    Natural,
    PaceNumber,
    RowsOf8Bytes,
    RowsOf16Bytes,
    RowsOf24Bytes,
    StatedPose,
    Tick,
    Time,
    Vector,
)


class Estimate(Message, frozen=True, kw_only=True, dict=True, tag="estimate"):
    """From an agent to watchers: its estimate for `tick`, at a slower pace without the scans of its peers, and its counters."""

    tick: Tick
    pose: StatedPose
    cod: Vector
    power_radius: Magnitude
    unused: Area
    load: Magnitude = 0.0  # expected targets in the footprint
    mass: Magnitude = 0.0  # expected targets in the cell
    cell_bytes: RowsOf16Bytes = msgspec.field(name="cell", default=b"")  # (V, 2) float64, counter-clockwise
    targets_bytes: RowsOf16Bytes = msgspec.field(name="targets", default=b"")  # (M, 2) float64
    details_bytes: RowsOf24Bytes = msgspec.field(name="details", default=b"")  # (M, 6) float32: vx, vy, covariance xx, xy, yy, existence
    labels_bytes: RowsOf8Bytes = msgspec.field(name="labels", default=b"")  # (M,) uint64: identities; 0: none
    diagram_hash: Natural = 0  # hash of the generators from which the cell was cut
    neighbours: tuple[str, ...] = ()  # the agents that bound the cell
    counters: dict[str, int] = {}  # rounds, late, missing, skipped, rejected.<reason>, heard, ...
    round_seconds: Time = 0.0  # from the opening of the last shared round to its end, waiting included; 0 in virtual time
    pace: PaceNumber = 1  # the sender shares with its peers the ticks that this number divides

    cell = array_field("cell_bytes", CELL)  # (V, 2) float64
    targets = array_field("targets_bytes", TARGETS)  # (M, 2) float64

    def targets_at(self, tick: int, dt: float) -> np.ndarray:
        """(M, 2) m: the targets at another tick, for a watcher that has heard nothing newer. Each moves on by its velocity; `dt` in s."""
        if tick == self.tick:
            return self.targets
        return self.targets + self.details[:, :2] * ((tick - self.tick) * dt)

    @cached_attribute
    def details(self) -> np.ndarray:
        """(M, 6) float32: velocity vx, vy in m/s, covariance xx, xy, yy of the position in m^2, existence; zeros if not stated."""
        return DETAILS.read(self.details_bytes) if self.details_bytes else np.zeros((len(self.targets), DETAILS.columns))

    @cached_attribute
    def labels(self) -> np.ndarray:
        """(M,) uint64; 0: none, or not stated."""
        return LABELS.read(self.labels_bytes) if self.labels_bytes else np.zeros(len(self.targets), U8)

    def check(self) -> None:
        check_rows(CELL, self.cell_bytes)
        targets = check_rows(TARGETS, self.targets_bytes)
        if self.details_bytes or self.labels_bytes:
            details, labels = check_rows(DETAILS, self.details_bytes), LABELS.count(self.labels_bytes)
            if (details or targets) != targets or (labels or targets) != targets:
                raise Malformed("shape", f"details, labels: {details} and {labels} rows for {targets} targets")
            if labels and int(self.labels.max()) > LARGEST_LABEL:
                raise Malformed("range", f"labels: should be at most {LARGEST_LABEL}")


class Truth(Message, frozen=True, kw_only=True, dict=True, tag="truth"):
    """From the world to watchers, never to agents: the true state of everything at `tick`."""

    tick: Tick
    time: Time
    targets_bytes: RowsOf16Bytes = msgspec.field(name="targets", default=b"")  # (T, 2) float64
    ids_bytes: RowsOf8Bytes = msgspec.field(name="ids", default=b"")  # (T,) uint64
    bodies: tuple[str, ...] = ()  # every body, in team order
    poses_bytes: RowsOf24Bytes = msgspec.field(name="poses", default=b"")  # (B, 3) float64
    in_view: int = 0  # targets inside the field of view of some live agent's body
    alive: tuple[str, ...] = ()  # the agents with a token that the world sees

    targets = array_field("targets_bytes", TARGETS)  # (T, 2) float64
    ids = array_field("ids_bytes", IDS)  # (T,) uint64
    poses = array_field("poses_bytes", POSES)  # (B, 3) float64

    def check(self) -> None:
        targets, poses = check_rows(TARGETS, self.targets_bytes), check_rows(POSES, self.poses_bytes)
        if IDS.count(self.ids_bytes) != targets or poses != len(self.bodies):
            raise Malformed("shape", "one id per target, one pose per body")
