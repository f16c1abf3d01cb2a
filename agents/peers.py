"""One other agent as it is known: its incarnation, its token, the sensor that it announced, and what it can say with that."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import msgspec

from agents.capacity import SensorFacts, sensor_facts
from agents.config import AgentConfig
from agents.words import learn
from protocol.keys import order
from protocol.messages import Beacon, Gossip, Hello
from protocol.sensing import SensorModel, WedgeSensor
from protocol.settings import BadSetting, sensor_of

_SLACK = 1.0 + 1e-9


class Outfit(NamedTuple):
    """The sensor that a peer announced."""

    sensor: SensorModel
    facts: SensorFacts


@dataclass(slots=True)
class Peer:
    """What is known of another agent."""

    name: str
    incarnation: int
    token: bool = False  # its liveliness token is up
    outfit: Outfit | None = None
    gone_at: int | None = None  # the newest tick of which it may have spoken before its token went; a later gossip revives it
    missed: int = 0  # rounds without a word in a row
    beacon: Beacon | None = None  # the newest
    rank: tuple[int, str] = (0, "")  # in the order of names

    def __post_init__(self) -> None:
        self.rank = order(self.name)


def outfit_of(word: Hello | Beacon, config: AgentConfig) -> Outfit | None:
    """The sensor that somebody announces; None when nobody knows its class."""
    if word.sensor is not None:
        return _of_wedge(word.sensor)
    try:
        sensor = sensor_of(config, word.sensor_class)
    except BadSetting:
        return None
    return Outfit(sensor, sensor_facts(sensor))


@lru_cache(maxsize=1024)
def _of_wedge(sensor: WedgeSensor) -> Outfit:
    """One outfit for all in a process who announce the same."""
    return Outfit(sensor, sensor_facts(sensor))


def plausible(gossip: Gossip, outfit: Outfit) -> bool:
    """Whether a gossip stays within what its sender's sensor can do: U <= D, and the COD within reach."""
    most = outfit.facts.capability * _SLACK
    apart = math.dist(gossip.cod, gossip.pose[:2])
    return gossip.unused <= most and math.pi * gossip.power_radius**2 <= most and apart <= outfit.sensor.reach * _SLACK


def understood(gossip: Gossip, outfit: Outfit, config: AgentConfig) -> Gossip | None:
    """A gossip with what its sender's sensor makes of it noted, once in a process; None if that sensor cannot say it.

    In virtual time one message has many listeners: who takes the sender for another sensor than they do reads a copy of his own.
    """
    memo, sensor = gossip.memo, outfit.sensor
    noted = memo.get("sensor")
    if noted is not None and noted is not sensor and noted != sensor:
        gossip = msgspec.structs.replace(gossip)
        memo = gossip.memo
    if "believed" not in memo:
        believed = memo["believed"] = sensor if plausible(gossip, outfit) else None
        memo["mark"] = (gossip.sender, gossip.incarnation, sensor) if believed is not None else None
        learn(gossip, sensor, config)
    return gossip if memo["believed"] is not None else None


Mark = tuple[str, int, SensorModel]  # who says a gossip: name, incarnation, and the sensor that it was `understood` with


def marks_of(peers: Iterable[Peer]) -> list[Mark]:
    """What is expected of peers whose sensors are known."""
    return [(peer.name, peer.incarnation, peer.outfit.sensor) for peer in peers if peer.outfit]


def are_from(marks: list[Mark], tick: int, gossips: list[Gossip]) -> bool:
    """Whether these are the gossips of `tick` with these marks, all of them, in this order and nothing else."""
    return [gossip.memo.get("mark") for gossip in gossips] == marks and {gossip.tick for gossip in gossips} == {tick}
