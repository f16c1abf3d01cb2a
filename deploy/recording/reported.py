"""What a run reported and what was true, tick by tick, for the formats of other tools.

Data types: a `ReportedTarget` is one estimate of one agent. Its label is the identity that the swarm gives it, or None where estimates bear
none; every export takes the label where there is one.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from agents.tracking.labels import NO_LABEL
from deploy.recording.moments import messages
from deploy.recording.recording import Recording
from deploy.scenario import in_team_order
from deploy.scoring.tracks import UniqueLabels
from protocol.observer_messages import Estimate, Truth


class ReportedTarget(NamedTuple):
    """One estimated target."""

    x: float  # m
    y: float
    agent: str
    number: int  # in the estimate of that agent, from 0
    label: int | None


class ReportedTick(NamedTuple):
    """A tick: the truth, and all estimates of it."""

    truth: Truth
    targets: tuple[ReportedTarget, ...]


def reported_ticks(recording: Recording) -> Iterator[ReportedTick]:
    """Every tick with the estimates that belong to it, in the order of ticks; a tick without its truth is left out."""
    truths: dict[int, Truth] = {}
    estimates: dict[int, dict[str, Estimate]] = {}
    for message in messages(recording):
        if isinstance(message, Truth):
            truths.setdefault(message.tick, message)
        elif isinstance(message, Estimate):
            targets_alone = msgspec.structs.replace(message, cell_bytes=b"", neighbours=(), counters={})
            estimates.setdefault(message.tick, {})[message.sender] = targets_alone
    names = UniqueLabels()
    for tick in sorted(truths):
        found = estimates.get(tick, {})
        yield ReportedTick(truths[tick], tuple(_reported_by([found[name] for name in in_team_order(recording.scenario, found)], names)))


def _reported_by(estimates: Sequence[Estimate], names: UniqueLabels) -> Iterator[ReportedTarget]:
    """The targets in the estimates of a tick. Of one label one target has it, and others get labels that derive from it."""
    labels = [label for estimate in estimates for label in estimate.labels.tolist()]
    existence = [value for estimate in estimates for value in estimate.details[:, 5].tolist()]
    places = np.concatenate([np.empty((0, 2)), *(estimate.targets for estimate in estimates)])
    whose = [(estimate.sender, number) for estimate in estimates for number in range(len(estimate.targets))]
    for (agent, number), label, given, (x, y) in zip(whose, labels, names.of(labels, existence, places).tolist(), places.tolist()):
        yield ReportedTarget(x, y, agent, number, given if label != NO_LABEL else None)
