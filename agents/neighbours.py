"""Who else is there: peers, what they announced, what they said last, and whose word a round waits for.

A *peer* is a live agent. Its liveliness token is a suspicion: when the token goes the peer stops being a generator at once, and
its next gossip of the same incarnation brings it back. A peer that falls silent with its token up stays a generator, where it was
last heard, for `silent_rounds` rounds.
"""

import hashlib
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agents.capacity import SensorFacts, sensor_facts
from agents.config import AgentConfig
from agents.words import learn
from protocol.keys import order
from protocol.messages import Beacon, Gossip, Hello
from protocol.sensing import SensorModel
from protocol.settings import BadSetting, sensor_of

MOST_TICKS = 16  # for which gossips wait; the newest count
_SLACK = 1.0 + 1e-9


class Outfit(NamedTuple):
    """The sensor that a peer announced."""

    sensor: SensorModel
    facts: SensorFacts


@dataclass
class Peer:
    """What is known of another agent."""

    name: str
    incarnation: int
    token: bool = False  # its liveliness token is up
    outfit: Outfit | None = None
    gone_at: int | None = None  # the tick in which its token went; a later gossip revives it
    missed: int = 0  # rounds without a word in a row
    beacon: Beacon | None = None  # the newest


class Far(NamedTuple):
    """Generators of those who are not listened to, where they were last: names, points (N, 2) m, radii (N,) m."""

    names: tuple[str, ...]
    points: np.ndarray
    radii: np.ndarray


NOBODY = Far((), np.empty((0, 2)), np.empty(0))


class Neighbours:
    """The peers of one agent."""

    def __init__(self, config: AgentConfig, name: str, incarnation: int = 1) -> None:
        self.peers: dict[str, Peer] = {}  # in the order of names
        self.circle: dict[str, Peer] = {}  # those whose gossip I listen to, in the order of names; at first all
        self.chosen = False  # the circle has been chosen, those outside are not listened to
        self.far = NOBODY
        self._places: dict[str, Beacon | Gossip] = {}  # from which the circle was chosen
        self._asked: set[str] = set()  # who joins the circle after the first word
        self._answered: set[str] = set()
        self._config = config
        self._name, self._incarnation = name, incarnation
        self._membership = 0  # 0: to be computed
        self._said: dict[int, dict[str, Gossip]] = {}  # by tick and name, of rounds that are not closed yet
        self.last: dict[str, Gossip] = {}  # the newest of each peer in closed rounds
        self._calm = False  # all peers live and spoke in the last round, and nothing has changed since

    def alive(self, name: str, incarnation: int) -> None:
        """A token appeared."""
        peer = self._peer(name, incarnation, token=True)
        if peer:
            peer.token, peer.gone_at, self._calm = True, None, False
            self._membership = 0

    def gone(self, name: str, incarnation: int, tick: int) -> None:
        """A token vanished in the round `tick`."""
        peer = self.peers.get(name)
        if peer and peer.incarnation == incarnation:
            peer.token, peer.gone_at, self._calm = False, tick, False
            self._membership = 0

    def greet(self, hello: Hello) -> str | None:
        """A Hello arrived: remember the announced sensor. The reason for refusing it, if there is one.

        The newest counts: what was spoilt in one Hello is put right by the next.
        """
        peer = self._peer(hello.sender, hello.incarnation)
        if peer is None:
            return "incarnation"
        if peer.outfit is None or (hello.sensor is not None and hello.sensor != peer.outfit.sensor):
            try:
                sensor = hello.sensor or sensor_of(self._config, hello.sensor_class)
            except BadSetting:
                return "sensor"
            peer.outfit = Outfit(sensor, sensor_facts(sensor))
        return None

    def hear(self, gossip: Gossip) -> str | None:
        """A gossip arrived; the reason for refusing it, if there is one."""
        name = gossip.sender
        peer = self.circle.get(name)
        if peer is None or peer.incarnation != gossip.incarnation:
            peer = self._peer(name, gossip.incarnation)
            if peer is None:
                return "incarnation"
            if name not in self.circle:
                self._answered |= {name} & self._asked
                return "unasked"
        if peer.outfit is None:
            return "stranger"
        tick = gossip.tick
        last = self.last.get(name)
        if last is not None and tick <= last.tick:
            return "stale"
        if peer.gone_at is not None and tick <= peer.gone_at:
            return "dead"
        plausible = gossip.memo.get("plausible")
        if plausible is None:
            plausible = gossip.memo["plausible"] = _plausible(gossip, peer.outfit)
            learn(gossip, peer.outfit.sensor, self._config)
        if not plausible:
            return "bounds"
        said = self._said.get(tick)
        if said is None:
            said = self._said[tick] = {}
            if len(self._said) > MOST_TICKS:
                del self._said[min(self._said)]
        said[name] = gossip
        peer.missed = 0
        if peer.gone_at is not None:
            peer.gone_at, self._membership = None, 0
        return None

    def fresh(self, tick: int) -> dict[str, Gossip]:
        """The gossips of `tick` by living peers, in the order of names."""
        said = self._said.get(tick, {})
        if self._calm and len(said) == len(self.circle):
            return {name: said[name] for name in self.circle}
        return {name: said[name] for name, peer in self.circle.items() if name in said and peer.gone_at is None}

    def missing(self, tick: int, *, newcomer: bool = False) -> set[str]:
        """The peers whose word for `tick` is still to come: alive, known to speak, and not silent for long.

        A newcomer waits for every live peer, since it has heard none of them yet.
        """
        said = self._said.get(tick, {})
        if len(said) == len(self.circle):
            return set()
        if self._calm:
            return self.circle.keys() - said.keys()
        return {name for name, peer in self.circle.items() if name not in said and peer.token and self._speaks(peer, newcomer or tick == 0)}

    def generators(self, tick: int, fresh: dict[str, Gossip]) -> dict[str, Gossip]:
        """The gossip from which each peer's generator in the diagram of `tick` is read: fresh, or the last of the lately silent."""
        found, oldest = {}, tick - self._config.timing.silent_rounds
        for name, peer in self.circle.items():
            gossip = fresh.get(name) or self._newest(peer, tick)
            if gossip is not None and gossip.tick >= oldest and not gossip.listening and peer.gone_at is None:
                found[name] = gossip
        return found

    def close(self, tick: int, *, newcomer: bool = False) -> int:
        """The round `tick` is over: put away what it used, count who was missing; how many were."""
        missing = self.missing(tick, newcomer=newcomer)
        for name in missing:
            self.peers[name].missed += 1
        complete = len(self._said.get(tick, ())) == len(self.circle)
        self._calm = complete and (self._calm or all(peer.token for peer in self.circle.values()))
        for stamp in sorted([stamp for stamp in self._said if stamp <= tick]):
            said = self._said.pop(stamp)
            self.last = said if len(said) == len(self.peers) else {**self.last, **said}
        self._welcome()
        return len(missing)

    def anyone_missed(self) -> bool:
        """Whether some peer was silent in the last round."""
        return not self._calm and any(peer.missed for peer in self.circle.values())

    def strangers(self) -> bool:
        """Whether somebody alive has not said yet what its sensor is."""
        return any(peer.token and peer.outfit is None for peer in self.peers.values())

    def see(self, beacon: Beacon) -> None:
        """A beacon arrived: where a peer is."""
        peer = self._peer(beacon.sender, beacon.incarnation)
        if peer and (peer.beacon is None or beacon.tick > peer.beacon.tick):
            peer.beacon = beacon

    def whereabouts(self) -> dict[str, Beacon | Gossip]:
        """The newest word of where each living peer is, as far as there is one."""
        found: dict[str, Beacon | Gossip] = {}
        for name, peer in self.peers.items():
            said, beacon = self.last.get(name), peer.beacon
            newest = said if beacon is None or (said is not None and said.tick >= beacon.tick) else beacon
            if newest is not None and peer.outfit is not None and peer.gone_at is None:
                found[name] = newest
        return found

    def choose(self, names: set[str]) -> set[str]:
        """From now on listen to these peers and to those whose place is unknown; the names of both. Who is new joins the circle after
        its first word, for it takes a moment until that can be heard."""
        known = self.whereabouts()
        asked = names | {name for name, peer in self.peers.items() if name not in known and peer.gone_at is None}
        before = self.circle.keys() if self.chosen else asked
        self.chosen, self._calm = True, False
        self._asked, self._answered = asked - before, set()
        self.circle = {name: peer for name, peer in self.peers.items() if name in asked and name in before}
        self._places = known
        self.far = self._far()
        return asked

    def _far(self) -> Far:
        kind = self._config.partition.kind
        names = tuple([name for name in self._places if name not in self.circle])
        words = [self._places[name] for name in names]
        eyes = [word.position if isinstance(word, Beacon) else word.pose[:2] for word in words]
        points = eyes if kind == "voronoi" else [word.cod for word in words]
        radii = [word.power_radius if kind == "power" else 0.0 for word in words]
        return Far(names, np.array(points, dtype=float).reshape(-1, 2), np.array(radii, dtype=float))

    def _welcome(self) -> None:
        """Take those into the circle who have been asked and have answered."""
        if self._answered:
            wider = self.circle.keys() | self._answered
            self.circle = {name: peer for name, peer in self.peers.items() if name in wider}
            self._asked, self._answered, self._calm = self._asked - self._answered, set(), False
            self.far = self._far()

    @property
    def membership(self) -> int:
        """A hash of who is alive, equal for all who agree about it; never 0."""
        if self._membership == 0:
            there = [(peer.name, peer.incarnation) for peer in self.peers.values() if peer.gone_at is None]
            there.append((self._name, self._incarnation))
            text = repr(sorted(there)).encode()
            self._membership = int.from_bytes(hashlib.blake2b(text, digest_size=7).digest(), "little") | 1
        return self._membership

    def _newest(self, peer: Peer, tick: int) -> Gossip | None:
        """The newest gossip of a peer that is not younger than `tick`."""
        stamps = [stamp for stamp, said in self._said.items() if stamp <= tick and peer.name in said]
        return self._said[max(stamps)][peer.name] if stamps else self.last.get(peer.name)

    def _speaks(self, peer: Peer, never_heard_counts: bool) -> bool:
        if peer.name not in self.last and not any(peer.name in said for said in self._said.values()):
            return never_heard_counts
        return peer.missed < self._config.timing.silent_rounds

    def _peer(self, name: str, incarnation: int, *, token: bool = False) -> Peer | None:
        """The peer of that incarnation, made anew for a younger one; None for an older one.

        While a token is up only a token can say that a younger one is there: one wrong bit in a message must not silence a peer.
        """
        peer = self.peers.get(name)
        younger = peer is not None and incarnation > peer.incarnation and (token or not peer.token)
        guess = peer is not None and token and incarnation != peer.incarnation and not peer.token and peer.gone_at is None
        if peer is None or younger or guess:
            listening = not self.chosen or name in self.circle
            peer = Peer(name, incarnation)
            self.peers = {other: self.peers.get(other, peer) for other in sorted({*self.peers, name}, key=order)}
            self.peers[name] = peer
            if listening:
                self.circle = {other: known for other, known in self.peers.items() if other == name or other in self.circle}
            self._calm, self._membership = False, 0
            for said in (self.last, *self._said.values()):
                said.pop(name, None)
        return peer if incarnation == peer.incarnation else None


def _plausible(gossip: Gossip, outfit: Outfit) -> bool:
    """Whether a gossip stays within what its sender's sensor can do: U <= D, and the COD within reach."""
    most = outfit.facts.capability * _SLACK
    apart = math.dist(gossip.cod, gossip.pose[:2])
    return gossip.unused <= most and math.pi * gossip.power_radius**2 <= most and apart <= outfit.sensor.reach * _SLACK
