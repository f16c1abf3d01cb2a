"""Where peers are, as far as they have said so themselves: for an agent that hears its neighbours only and chooses whom to hear."""

from agents.calm import CalmRound
from agents.config import AgentConfig
from agents.peers import Peer
from agents.places import Places, Word, position, spot
from agents.tiles import Rectangle
from protocol.messages import Beacon, Gossip


class Whereabouts(Places):
    """The places of peers, by their beacons and gossips."""

    def __init__(self, config: AgentConfig) -> None:
        super().__init__()
        self._config, self._silent = config, config.timing.silent_rounds
        self._said: dict[str, Gossip] = {}  # in rounds that are over, the newest of each, not noted yet
        self._together: CalmRound | None = None  # the last of those that were read together, not noted yet
        self.needed: Rectangle | None = None  # outside of this nobody matters before the next choice

    def see(self, peer: Peer, word: Word) -> None:
        """Note where a peer is, if it is anywhere."""
        if self._counts(peer):
            self.put(peer.name, word.tick, self._spot(word))

    def see_all(self, beacons: list[Beacon], peers: dict[str, Peer]) -> list[Beacon]:
        """Note where those are who are well known, and ask for nothing; the beacons of the others."""
        others, silent = [], self._silent
        seen: list[tuple[str, int, bytes]] = []
        for beacon in beacons:
            peer = peers.get(beacon.sender)
            if (
                peer is None
                or beacon.asks
                or peer.beacon is None
                or peer.gone_at is not None
                or peer.missed >= silent
                or peer.incarnation != beacon.incarnation
                or beacon.tick < peer.beacon.tick
            ):
                others.append(beacon)
            else:
                peer.beacon = beacon
                seen.append((beacon.sender, beacon.tick, beacon.memo.get("spot") or spot(beacon, self._config)))
        self.put_all(seen)
        return others

    def matters(self, beacon: Beacon) -> bool:
        """Whether somebody who says this could make a difference before the next choice: it is made for where nobody is unknown."""
        x, y = position(beacon)
        return self.needed is None or self.needed.holds(Rectangle(x, y, x, y))

    def close(self, said: dict[str, Gossip] | CalmRound, peers: dict[str, Peer]) -> None:
        """A round is over in which this was said; it is noted once somebody asks where all are, which is not so after every round."""
        if not isinstance(said, CalmRound):
            self._said.update(said)
            return
        if self._together is not None and self._together.roll is not said.roll:
            self.catch_up(peers)
        self._together = said

    def catch_up(self, peers: dict[str, Peer], *, steady: bool = False) -> None:
        """Note what was said in the rounds that are over. `steady`: all count who said something."""
        said, together, self._said, self._together = self._said, self._together, {}, None
        if said:
            self._put_those([(name, word.tick, word.memo.get("spot") or self._spot(word)) for name, word in said.items()], peers, steady)
        if together is not None:
            self._put_those([(name, together.tick, packed) for name, packed in together.spots().items()], peers, steady)

    def _put_those(self, words: list[tuple[str, int, bytes]], peers: dict[str, Peer], steady: bool) -> None:
        self.put_all(words if steady else [word for word in words if word[0] in peers and self._counts(peers[word[0]])])

    def _spot(self, word: Word) -> bytes:
        return word.memo.get("spot") or spot(word, self._config)

    def _counts(self, peer: Peer) -> bool:
        """Whether a peer is somewhere: it has not gone, and has not been silent for long."""
        return peer.gone_at is None and peer.outfit is not None and peer.missed < self._silent
