"""One other agent as it is known: its incarnation, its token, the sensor that it announced, and what it can say with that."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from agents.capacity import SensorFacts, sensor_facts
from agents.config import AgentConfig
from protocol.keys import order
from protocol.messages import Beacon, Gossip, Hello
from protocol.sensing import SensorModel
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
    try:
        sensor = word.sensor or sensor_of(config, word.sensor_class)
    except BadSetting:
        return None
    return Outfit(sensor, sensor_facts(sensor))


def plausible(gossip: Gossip, outfit: Outfit) -> bool:
    """Whether a gossip stays within what its sender's sensor can do: U <= D, and the COD within reach."""
    most = outfit.facts.capability * _SLACK
    apart = math.dist(gossip.cod, gossip.pose[:2])
    return gossip.unused <= most and math.pi * gossip.power_radius**2 <= most and apart <= outfit.sensor.reach * _SLACK
