"""One other agent as it is known: its incarnation, its token, its announced sensor, and what a gossip of it may state."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import msgspec

from agents.config import AgentConfig
from agents.gossip.table import AnnouncedSensor, announced_sensor
from protocol.keys import order
from protocol.messages import Beacon, Gossip, Hello
from protocol.settings import ArenaSettings, BadSetting, sensor_of


@dataclass(slots=True)
class Peer:
    """What is known of another agent."""

    name: str
    incarnation: int
    token: bool = False  # its liveliness token is up
    announced: AnnouncedSensor | None = None
    refused_until: int | None = None  # its token has vanished: a gossip of a later tick revives the peer; None: it is there
    silent_rounds: int = 0  # in a row, without a gossip of it
    suspected: bool = False  # its token vanished while this agent was late itself
    beacon: Beacon | None = None  # the newest one
    rank: tuple[int, str] = (0, "")  # sorts peers in the order of names
    differs: tuple[str, ...] = ()  # the peer is refused: these settings differ from the own ones
    unusable: str = ""  # why the sensor of its last refused Hello cannot be used here

    def __post_init__(self) -> None:
        self.rank = order(self.name)

    @property
    def is_gone(self) -> bool:
        """Whether its token has vanished, and no later gossip has revived it."""
        return self.refused_until is not None

    def note_life(self, tick: int, least_silence: int, *, is_wrong: bool) -> bool:
        """Note a message of `tick`, which lifts a suspicion; whether the peer is back: it was gone, or silent for `least_silence` rounds.

        A tick that `is_wrong`, as it lies far ahead, ends no silence and brings nobody back.
        """
        self.suspected, was_gone = False, self.refused_until is not None and tick > self.refused_until
        if is_wrong or not (was_gone or self.silent_rounds >= least_silence):
            return False
        self.refused_until, self.silent_rounds = None if was_gone else self.refused_until, 0
        return True


def with_peer(peers: dict[str, Peer], peer: Peer) -> dict[str, Peer]:
    """These peers, which are in the order of names, with another one or its new record."""
    found = {**peers, peer.name: peer}
    if peer.name in peers or not peers or peers[next(reversed(peers))].rank < peer.rank:
        return found
    return dict(sorted(found.items(), key=lambda item: item[1].rank))


def announced_by(message: Hello | Beacon, config: AgentConfig) -> AnnouncedSensor:
    """The sensor that a message announces. Raises BadSetting when its class is unknown here, or cannot be used with these settings."""
    sensor = sensor_of(config, message.sensor_class) if message.sensor is None else message.sensor
    if reason := config.why_not(sensor):
        raise BadSetting(reason)
    return announced_sensor(message.sender, sensor, config.detection.clutter)


def same_sensor(one: Beacon, other: Beacon) -> bool:
    """Whether two beacons announce the same sensor."""
    return one.sensor_class == other.sensor_class and one.sensor == other.sensor


def all_acceptable(peers: Iterable[Peer], neighbours_only: bool) -> bool:
    """Whether every well-formed gossip of the next tick by these peers will be accepted. With `neighbours_only` not all tokens are seen."""
    return all(
        not peer.is_gone and not peer.silent_rounds and peer.announced is not None and (peer.token or neighbours_only) for peer in peers
    )


def plausible(gossip: Gossip, announced: AnnouncedSensor, arena: ArenaSettings) -> bool:
    """Whether a gossip stays within what its sender's sensor can do.

    U and the discs of its power radius and of its claim are at most D, the COD is within reach, and the goal in the arena.
    """
    if gossip.goal is not None and not arena.holds(*gossip.goal):
        return False
    area, distance = gossip.extent
    return area <= announced.most_area and distance <= announced.most_distance


def with_newer_generator(gossip: Gossip, tick: int, generator: Sequence[float], partition_kind: str) -> Gossip:
    """A gossip with the generator x, y and radius in m of its sender at another tick, when it had a cell; the sensor moves with it."""
    (x, y, heading), (east, north), radius = gossip.pose, gossip.cod, gossip.power_radius
    (from_x, from_y), (to_x, to_y, stated) = gossip.pose[:2] if partition_kind == "voronoi" else gossip.cod, generator
    pose, cod = (x + to_x - from_x, y + to_y - from_y, heading), (east + to_x - from_x, north + to_y - from_y)
    if partition_kind == "voronoi":
        pose = to_x, to_y, heading
    else:
        cod = to_x, to_y
    radius = stated if partition_kind == "power" else radius
    return msgspec.structs.replace(gossip, tick=tick, pose=pose, cod=cod, power_radius=radius, listening=False)
