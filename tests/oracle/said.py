"""What was said in a recorded run, tick by tick."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from protocol.codec import decode
from protocol.messages import Command, Gossip, Observation
from protocol.observer_messages import Estimate, Truth
from tests.oracle.paper_filter import NOTHING, Phd, Scan
from tests.oracle.wedges import Wedge, wedge_of


@dataclass
class Tick:
    """The messages of one tick, by agent."""

    observations: dict[str, Observation] = field(default_factory=dict)
    gossips: dict[str, Gossip] = field(default_factory=dict)
    estimates: dict[str, Estimate] = field(default_factory=dict)
    commands: dict[str, Command] = field(default_factory=dict)
    truths: list[Truth] = field(default_factory=list)

    def scans(self, settings: dict[str, Any], wedges: dict[str, Wedge]) -> list[Scan]:
        """What the sensors returned."""
        clutter = settings["detection"]["clutter"]
        return [
            Scan(name, wedges[name], seen.pose, seen.detections.astype(float), clutter / wedges[name].area)
            for name, seen in self.observations.items()
        ]

    def particles(self) -> Phd:
        """All that the agents say they own, which is the PHD after the tick before."""
        phd = NOTHING
        for gossip in self.gossips.values():
            phd += Phd(gossip.states.astype(float), np.full(len(gossip.states), gossip.weight))
        return phd


def ticks_of(entries: Iterable[tuple[str, bytes]]) -> list[Tick]:
    """The ticks of a run from the keys and payloads that were recorded; the agents stand in the public order of names."""
    found: dict[int, Tick] = {}
    for key, payload in sorted(entries, key=lambda entry: (len(entry[0]), entry[0])):
        if key.split("/")[2] not in ("observation", "gossip", "estimate", "command", "truth"):
            continue
        message = decode(key, payload)
        assert isinstance(message, Observation | Gossip | Estimate | Command | Truth)
        tick = found.setdefault(message.tick, Tick())
        match message:
            case Observation():
                tick.observations[message.recipient] = message
            case Gossip():
                tick.gossips[message.sender] = message
            case Estimate():
                tick.estimates[message.sender] = message
            case Command():
                tick.commands[message.sender] = message
            case Truth():
                tick.truths.append(message)
    return [found[number] for number in sorted(found)]


def wedges_of(settings: dict[str, Any]) -> dict[str, Wedge]:
    """The sensor of every member."""
    return {name: wedge_of(settings, name) for name in settings["members"]}
