"""What a run reported and what was true, tick by tick, for the formats of other tools.

Data types: a `ReportedTarget` is one estimate of one agent. Its label is the identity that the swarm gives it, or None where estimates bear
none; every export takes the label where there is one.
"""

from collections.abc import Iterator
from typing import NamedTuple

from deploy.recording.moments import messages
from deploy.recording.recording import Recording
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


def reported_by(estimate: Estimate) -> Iterator[ReportedTarget]:
    """The targets in an estimate."""
    for number, ((x, y), label) in enumerate(zip(estimate.targets.tolist(), estimate.labels.tolist())):
        yield ReportedTarget(x, y, estimate.sender, number, label or None)


def reported_ticks(recording: Recording) -> Iterator[ReportedTick]:
    """Every tick with the estimates that belong to it, in the order of ticks; a tick without its truth is left out."""
    truths: dict[int, Truth] = {}
    targets: dict[int, dict[str, tuple[ReportedTarget, ...]]] = {}
    for message in messages(recording):
        if isinstance(message, Truth):
            truths.setdefault(message.tick, message)
        elif isinstance(message, Estimate):
            targets.setdefault(message.tick, {})[message.sender] = tuple(reported_by(message))
    for tick in sorted(truths):
        found = targets.get(tick, {})
        yield ReportedTick(truths[tick], tuple(target for name in sorted(found) for target in found[name]))
