"""Who else is there: peers, what they announced, what they said last, and whose word a round waits for.

A *peer* is a live agent. Its liveliness token is a suspicion: when the token goes the peer stops being a generator at once, and
the first gossip of the same incarnation that it cannot have said before brings it back. A peer that falls silent with its token up
stays a generator, where it was last heard, for `silent_rounds` rounds.
"""

from bisect import bisect_left
from collections.abc import KeysView, Sequence
from itertools import compress, islice
from operator import attrgetter

import numpy as np

from agents.calm import CalmRound, Reader, Roll
from agents.config import AgentConfig
from agents.interest import Choice
from agents.peers import Mark, Peer, expected_of, marks_of, outfit_of, steady, understood
from agents.places import EAST, NOBODY, RADIUS, Far
from agents.said import Said, Whole
from agents.unison import Part, Together, Unison
from agents.whereabouts import Whereabouts
from protocol.agreement import disagreement
from protocol.keys import order
from protocol.messages import Beacon, Gossip, Hello

Heard = dict[str, Gossip] | Whole  # the gossips of a tick by living peers, by name
LOCAL_VIEW = 1  # of all who have heard everybody whom they must hear: their cells are those of one diagram


class Neighbours:
    """The peers of one agent."""

    def __init__(self, config: AgentConfig, name: str, incarnation: int = 1) -> None:
        self.local = config.timing.interest == "neighbours"  # peers are known by their beacons, and I listen to those I choose
        self.peers: dict[str, Peer] = {}  # in the order of names, unless local
        self.circle: dict[str, Peer] = {}  # those whose gossip I listen to, in the order of names; all, unless local
        self.far = NOBODY  # the others, if local
        self.places = Whereabouts(config)  # local: of those who are there, by the newest word of each
        self.certified = False  # local: nobody whom I do not know could own anything that matters to me
        self.acquainted, self._version = frozenset[str](), -1  # local: whose claims fit mine, and by which version of the places
        self.changed = False  # local: somebody has come or gone since the circle was chosen
        self._config, self._silent = config, config.timing.silent_rounds
        self._name, self._incarnation, self.settings = name, incarnation, config.agreed()
        self.said = Said()
        self._calm = False  # all in the circle are alive and missed no round, and nothing has changed since
        self._roll: Roll | None = None  # who is expected in calm rounds, made when it is needed
        self._marks: list[Mark] | None = None  # theirs, made when they are needed

    def alive(self, name: str, incarnation: int) -> None:
        """A token appeared."""
        peer = self._peer(name, incarnation, token=True)
        if peer:
            self.changed |= peer.gone_at is not None
            peer.token, peer.gone_at = True, None
            if peer.beacon is not None:
                self.places.see(peer, peer.beacon)

    def gone(self, name: str, incarnation: int, tick: int) -> None:
        """A token vanished in the round `tick`. The peer may have been a tick ahead, and its last words may still be on their way."""
        peer = self.peers.get(name)
        if peer and peer.incarnation == incarnation:
            peer.token, peer.gone_at, self._calm = False, tick + 1, False
            self.places.remove(name)
            self.changed = True

    def greet(self, hello: Hello) -> str | None:
        """A Hello arrived: remember the announced sensor. The reason for refusing it, if there is one.

        The newest counts: what was spoilt in one Hello is put right by the next.
        """
        peer = self._peer(hello.sender, hello.incarnation)
        if peer is None:
            return "incarnation"
        differs = disagreement(self.settings, hello.settings)
        if differs != peer.differs and peer.outfit is None:  # a peer that agreed is kept: one wrong bit must not silence it
            self._exclude(peer, differs)
        if differs:
            return "settings"
        if peer.outfit is None or (hello.sensor is not None and hello.sensor != peer.outfit.sensor):
            outfit = outfit_of(hello, self._config)
            if outfit is None:
                return "sensor"
            peer.outfit, self._roll, self._marks = outfit, None, None
        return None

    def _exclude(self, peer: Peer, differs: tuple[str, ...]) -> None:
        """Count a peer out whose settings differ in some sections, or in again if they do not."""
        peer.differs, self.changed = differs, True
        named = self.circle.keys() - {peer.name} if differs else self.circle.keys() | {peer.name}
        self.circle = {name: other for name, other in self.peers.items() if name in named}
        self._calm, self._roll, self._marks = False, None, None

    def knows(self, hello: Hello) -> bool:
        """Whether `greet` would learn nothing from it."""
        peer = self.peers.get(hello.sender)
        outfit = peer.outfit if peer is not None and peer.incarnation == hello.incarnation else None
        return outfit is not None and (hello.sensor is None or hello.sensor is outfit.sensor or hello.sensor == outfit.sensor)

    def hear_all(self, reader: Reader, keys: Sequence[str], payloads: Sequence[bytes]) -> KeysView[str] | None:
        """Gossips arrived; whose they were, if they could be read together. None: it is as if they had not come."""
        return self.said.read(self._roll or self.call_roll(reader), keys, payloads) if self._calm else None

    def hear(self, gossip: Gossip) -> str | None:
        """A gossip arrived; the reason for refusing it, if there is one."""
        if self._calm:  # all is as in the last round, when nothing was missing: the commonest case, made short
            said, peer = self.said.spell_out().get(gossip.tick), self.circle.get(gossip.sender)
            if said is not None and peer is not None and peer.incarnation == gossip.incarnation:
                believed = self._believed(gossip, peer)
                if believed is not None:
                    said[gossip.sender] = believed
                    return None
        return self._judge(gossip)

    def hear_calmly(self, gossips: list[Gossip], start: int, tick: int, awaited: set[str]) -> tuple[int, int]:
        """Hear gossips of a calm round `tick`, from that of index `start` on, until nobody is awaited any more or one is out of the
        ordinary: how many, and how many of them I had asked for. As if `hear` had taken one after the other."""
        if not self._calm:
            return 0, 0
        said, circle = self.said.spell_out().setdefault(tick, {}), self.circle
        taken, at = 0, start
        for gossip in islice(gossips, start, None):
            name = gossip.sender
            peer = circle.get(name)
            if peer is None:
                if not self.local or name == self._name:
                    break
            elif gossip.tick == tick and gossip.incarnation == peer.incarnation:
                outfit = peer.outfit  # asked here as well, for the sake of the calls that it saves
                known = outfit is not None and gossip.memo.get("believed") is outfit.sensor
                believed = gossip if known else self._believed(gossip, peer)
                if believed is None:
                    break
                said[name] = believed
                taken += 1
                awaited.discard(name)
            else:
                break
            at += 1
            if not awaited:
                break
        return at - start, taken

    def hear_together(self, unison: Unison, tick: int) -> bool:
        """Hear in one go what all say, I too, if it is just what a calm round `tick` should bring: whether it was. Else nothing came."""
        for gossip in unison.unmarked() if self._calm else ():
            if gossip.sender in self.circle:
                self._believed(gossip, self.circle[gossip.sender])
        return unison.tick == tick and self.are_all(unison) and self.said.take(Part(unison, self._name), tick)

    def are_all(self, speakers: Together) -> bool:
        """Whether all who are known and nothing is new about, and I, are those who speak."""
        place = speakers.place_of(self._name, self._incarnation)
        if not self._calm or self.local or place < 0 or len(speakers) != len(self.circle) + 1:
            return False
        self._marks = self._marks or marks_of(self.circle.values())
        return speakers.is_from(self._marks, place)

    def _judge(self, gossip: Gossip) -> str | None:
        name = gossip.sender
        peer = self.circle.get(name)
        if peer is None or peer.incarnation != gossip.incarnation:
            if self.local and name not in self.circle:
                return "unasked"
            peer = self._peer(name, gossip.incarnation)
            if peer is None:
                return "incarnation"
        if peer.outfit is None:
            return "settings" if peer.differs else "stranger"
        tick = gossip.tick
        last = self.said.last.get(name)
        if last is not None and tick <= last.tick:
            return "stale"
        if peer.gone_at is not None and tick <= peer.gone_at:
            return "dead"
        believed = self._believed(gossip, peer)
        if believed is None:
            return "bounds"
        self.said.note(believed)
        peer.missed = 0
        if peer.gone_at is not None:
            peer.gone_at, self.changed = None, True
        return None

    def _believed(self, gossip: Gossip, peer: Peer) -> Gossip | None:
        """The gossip, `understood`, if it stays within what its sender's sensor can do."""
        outfit = peer.outfit
        if outfit is None:
            return None
        return gossip if gossip.memo.get("believed") is outfit.sensor else understood(gossip, outfit, self._config)

    def fresh(self, tick: int) -> Heard:
        """The gossips of `tick` by living peers, in the order of names."""
        together = self._whole(tick)
        if together is not None:
            return together
        said = self.said.spell_out().get(tick, {})
        if self._calm and len(said) == len(self.circle):
            return {name: said[name] for name in self.circle}
        return {name: said[name] for name, peer in self.circle.items() if name in said and peer.gone_at is None}

    def missing(self, tick: int, *, newcomer: bool = False) -> set[str]:
        """The peers whose word for `tick` is still to come: alive, known to speak, and not silent for long.

        A newcomer waits for every live peer, since it has heard none of them yet.
        """
        together = self.said.together(tick) if self._calm else None
        if together is not None:
            return self.circle.keys() - together.names()
        said = self.said.spell_out().get(tick, {})
        if len(said) == len(self.circle):
            return set()
        if self._calm:
            return self.circle.keys() - said.keys()
        if self.local:  # a beacon was heard just now
            return {name for name, peer in self.circle.items() if peer.gone_at is None and peer.missed < self._silent and name not in said}
        silent, others = self._silent, [peer for name, peer in self.circle.items() if name not in said and peer.token]
        return {peer.name for peer in others if (peer.missed < silent if self.said.knows(peer.name) else newcomer or tick == 0)}

    def generators(self, tick: int, fresh: dict[str, Gossip]) -> dict[str, Gossip]:
        """The gossip from which each peer's generator in the diagram of `tick` is read: fresh, or the last of the lately silent."""
        found, oldest = {}, tick - self._silent
        for name, peer in self.circle.items():
            gossip = fresh.get(name) or self.said.newest(name, tick)
            if gossip is not None and gossip.tick >= oldest and not gossip.listening and peer.gone_at is None:
                found[name] = gossip
        return found

    def close(self, tick: int, *, newcomer: bool = False) -> int:
        """The round `tick` is over: put away what it used, count who was missing; how many were."""
        together = self._whole(tick)
        if together is not None:
            if isinstance(together, CalmRound) and self.local:
                self.places.close(together, self.peers)
            self.said.close_together()
            return 0
        missing = self.missing(tick, newcomer=newcomer)
        for name in missing:
            self.peers[name].missed += 1
            if self.peers[name].missed >= self._silent:
                self.places.remove(name)
        complete = len(self.said.spell_out().get(tick, ())) == len(self.circle)
        self._calm = complete and (self._calm or steady(self.circle.values(), self.local))
        for said in self.said.close(tick, len(self.circle)):
            if self.local:
                self.places.close(said, self.peers)
        return len(missing)

    def anyone_missed(self) -> bool:
        """Whether some peer was silent in the last round."""
        return not self._calm and any(peer.missed for peer in self.circle.values())

    def are_all_there(self) -> bool:
        """Whether the tokens of all others of the roster are up; local: only the world's greeting counts, so none is waited for."""
        return self.local or all(name in self.peers and self.peers[name].token for name in self._config.others(self._name))

    def strangers(self) -> bool:
        """Whether somebody alive has not said yet in a Hello what its sensor is."""
        return not self.local and any(peer.token and peer.outfit is None and not peer.differs for peer in self.peers.values())

    def see(self, beacon: Beacon) -> bool:
        """A beacon arrived: where a peer is. Whether that peer is new, or was gone or silent: then it may not know me either."""
        peer = known = self.peers.get(beacon.sender)
        if peer is None or peer.incarnation != beacon.incarnation:
            before = self.changed
            peer = self._peer(beacon.sender, beacon.incarnation)
            if known is None:
                self.changed = before or self.places.matters(beacon)
        if peer is None or (peer.beacon is not None and beacon.tick < peer.beacon.tick):
            return False
        if peer.outfit is None:
            peer.outfit = beacon.memo["outfit"] = beacon.memo.get("outfit") or outfit_of(beacon, self._config)
        back = peer.gone_at is not None and beacon.tick > peer.gone_at + 1  # a beacon says where somebody will be
        silent = peer.missed >= self._silent
        if back or silent:
            peer.gone_at, peer.missed, self.changed = None if back else peer.gone_at, 0, True
        peer.beacon = beacon
        self.places.see(peer, beacon)
        return back or silent or peer is not known

    def forget(self, since: int) -> bool:
        """Who has not said for long where he is is not there any more; `since` is a tick. Whether there was such a one."""
        self.places.catch_up(self.peers, steady=self._calm)
        before = len(self.peers)
        for name in self.places.forget(since):
            del self.peers[name]
        if len(self.peers) > len(self.places):
            self.peers = {name: peer for name, peer in self.peers.items() if name in self.places or (peer.gone_at or -1) >= since}
        forgot = len(self.peers) < before
        if forgot and not self.circle.keys() <= self.peers.keys():
            self._listen_to([peer for name, peer in self.circle.items() if name in self.peers], [])
        return forgot

    def choose(self, table: np.ndarray, choice: Choice) -> None:
        """From now on listen to the chosen of those N whose places stand in a table (N or more, 6)."""
        chosen, self.places.needed = choice
        places, before, number = self.places, self.far, len(self.places)
        if self._version != places.version:
            self.acquainted, self._version = places.everybody(), places.version
            names = tuple(places.names)
        else:
            names = before.everybody
        if names is not before.everybody or chosen.tobytes() != before.chosen.tobytes():
            wanted = set(compress(names, chosen.tolist()))
            if self.circle.keys() != wanted:
                kept = [peer for name, peer in self.circle.items() if name in wanted]
                added = [self.peers[name] for name in wanted - self.circle.keys()]
                self._listen_to(sorted([*kept, *added], key=attrgetter("rank")) if added else kept, added)
        self.changed, self.far = False, Far(table[:number].compress(~chosen, axis=0)[:, EAST : RADIUS + 1], names, chosen)

    def _listen_to(self, circle: list[Peer], added: list[Peer]) -> None:
        """Count these in, in the order of names, and nobody else; some are `added`."""
        before, self.circle = self.circle, {peer.name: peer for peer in circle}
        self._roll = self._marks = None
        if len(circle) < len(before) + len(added):
            self.said.drop(before.keys() - self.circle.keys())
        self._calm = steady(added if self._calm else circle, self.local)

    def _whole(self, tick: int) -> Whole | None:
        """What all peers have said of a tick if it came together and nothing has changed since."""
        together = self.said.together(tick) if self._calm else None
        return together if together is not None and len(together) == len(self.circle) else None

    def call_roll(self, reader: Reader) -> Roll:
        """Whom a calm round expects; their sensors are known."""
        expected = expected_of(self.circle.values(), self._config.detection.clutter)
        self._roll = Roll(self._config, reader, expected, bisect_left(list(self.circle), order(self._name), key=order))
        return self._roll

    def _peer(self, name: str, incarnation: int, *, token: bool = False) -> Peer | None:
        """The peer of that incarnation, made anew for a younger one; None for an older one.

        While a token is up only a token can say that a younger one is there: one wrong bit in a message must not silence a peer.
        """
        peer = self.peers.get(name)
        younger = peer is not None and incarnation > peer.incarnation and (token or not peer.token)
        guess = peer is not None and token and incarnation != peer.incarnation and not peer.token and peer.gone_at is None
        if peer is None or younger or guess:
            peer, known = Peer(name, incarnation), name in self.peers
            self.peers[name] = peer
            self.places.remove(name)
            if not self.local and not known:
                self.peers = {other: self.peers[other] for other in sorted(self.peers, key=order)}
            if not self.local or name in self.circle:
                self.circle = {other: known for other, known in self.peers.items() if other == name or other in self.circle}
            self.changed = True
            if not self.local or name in self.circle:
                self._calm, self._roll, self._marks = False, None, None
                self.said.forget(name)
        return peer if incarnation == peer.incarnation else None
