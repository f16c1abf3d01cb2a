"""One other agent as it is known: its incarnation, its token, the sensor that it announced, and what it can say with that."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import msgspec

from agents.calm import Expected
from agents.capacity import SensorFacts, sensor_facts
from agents.config import AgentConfig
from agents.words import eye_of, learn
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
    differs: tuple[str, ...] = ()  # refused: its settings are others than mine in these sections

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


def expected_of(peers: Iterable[Peer], clutter: float) -> list[Expected]:
    """What a calm round expects of peers whose sensors are known; clutter per scan."""
    outfits = [(peer, peer.outfit) for peer in peers if peer.outfit]
    return [
        Expected(peer.name, peer.incarnation, eye_of(peer.name, sensor, clutter), facts.capability, sensor.reach)
        for peer, (sensor, facts) in outfits
    ]


def steady(peers: Iterable[Peer], local: bool) -> bool:
    """Whether every gossip of these will be taken that is well-formed and of the next tick; local: tokens are seen of some alone."""
    return all(peer.gone_at is None and not peer.missed and peer.outfit is not None and (peer.token or local) for peer in peers)


def plausible(gossip: Gossip, outfit: Outfit) -> bool:
    """Whether a gossip stays within what its sender's sensor can do: U <= D, and the COD within reach."""
    most = outfit.facts.capability * _SLACK
    apart = math.dist(gossip.cod, gossip.pose[:2])
    return gossip.unused <= most and math.pi * gossip.power_radius**2 <= most and apart <= outfit.sensor.reach * _SLACK


Mark = tuple[str, int, SensorModel]  # who says a gossip: name, incarnation, and the sensor that it was `understood` with

_MARKS: dict[str, Mark] = {}  # the last that was asked for, by name
_MOST_MARKS = 20000


def mark_of(name: str, incarnation: int, sensor: SensorModel) -> Mark:
    """The mark of somebody: the same object as before where that is equal, so that rounds are compared at once."""
    known, mark = _MARKS.get(name), (name, incarnation, sensor)
    if known == mark:
        return known
    if len(_MARKS) >= _MOST_MARKS:
        _MARKS.clear()
    _MARKS[name] = mark
    return mark


def marks_of(peers: Iterable[Peer]) -> list[Mark]:
    """What is expected of peers whose sensors are known."""
    return [mark_of(peer.name, peer.incarnation, peer.outfit.sensor) for peer in peers if peer.outfit]


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
        memo["mark"] = mark_of(gossip.sender, gossip.incarnation, sensor) if believed is not None else None
        learn(gossip, sensor, config)
    return gossip if memo["believed"] is not None else None
