"""One other agent as it is known: its incarnation, its token, the sensor that it announced, and what it can say with that."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from agents.config import AgentConfig
from agents.gossip.table import AnnouncedSensor, announced_sensor
from protocol.keys import order
from protocol.messages import Beacon, Gossip, Hello
from protocol.node import Batch
from protocol.settings import BadSetting, sensor_of

TOLERANCE = 1.0 + 1e-9  # by which a gossip may exceed what its sender's sensor can do: rounding of another implementation


@dataclass(slots=True)
class Peer:
    """What is known of another agent."""

    name: str
    incarnation: int
    token: bool = False  # its liveliness token is up
    announced: AnnouncedSensor | None = None
    left_at: int | None = None  # the newest tick of which it may have spoken before its token went; a later gossip revives it
    missed: int = 0  # rounds without a word in a row
    beacon: Beacon | None = None  # the newest
    rank: tuple[int, str] = (0, "")  # in the order of names
    differs: tuple[str, ...] = ()  # refused: its settings are others than mine in these fields

    def __post_init__(self) -> None:
        self.rank = order(self.name)


def announced_by(word: Hello | Beacon, config: AgentConfig) -> AnnouncedSensor | None:
    """The sensor that a message announces; None when its class is unknown here."""
    try:
        sensor = sensor_of(config, word.sensor_class) if word.sensor is None else word.sensor
    except BadSetting:
        return None
    return announced_sensor(word.sender, sensor, config.detection.clutter)


def steady(peers: Iterable[Peer], local: bool) -> bool:
    """Whether every gossip of these will be taken that is well-formed and of the next tick; local: tokens are seen of some alone."""
    return all(peer.left_at is None and not peer.missed and peer.announced is not None and (peer.token or local) for peer in peers)


def plausible(gossip: Gossip, announced: AnnouncedSensor) -> bool:
    """Whether a gossip stays within what its sender's sensor can do: U <= D, and the COD within reach."""
    most = announced.facts.capability * TOLERANCE
    apart = math.dist(gossip.cod, gossip.pose[:2])
    return gossip.unused <= most and math.pi * gossip.power_radius**2 <= most and apart <= announced.sensor.reach * TOLERANCE


_JUDGED: deque[tuple[Batch, list[AnnouncedSensor | None], list[bool]]] = deque(maxlen=2)


def all_plausible(batch: Batch, carried: list[AnnouncedSensor | None]) -> list[bool]:
    """`plausible` of each gossip of a batch; False where the sensor is unknown.

    A pure memo of the last two answers: in virtual time all listeners ask the same of one batch.
    """
    for known, sensors, found in _JUDGED:
        if known is batch and sensors == carried:
            return found
    found = [announced is not None and plausible(gossip, announced) for gossip, announced in zip(batch.messages, carried)]
    _JUDGED.append((batch, carried, found))
    return found
