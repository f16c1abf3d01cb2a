"""The positions of peers, as they state them in beacons and gossips, for an agent that hears neighbours only."""

from agents.config import AgentConfig
from agents.interest.position_table import PositionTable, beacon_row, gossip_row
from agents.interest.tiles import Rectangle
from agents.membership.peer import Peer
from protocol.messages import Beacon, Gossip


class PeerPositions(PositionTable):
    """The positions of peers, by their beacons and gossips."""

    def __init__(self, config: AgentConfig) -> None:
        super().__init__()
        self.silence_limit = config.ticks_of_silence  # rounds; the peer table keeps it equal to its own
        self._diagram = config.partition.kind
        self._pending: dict[str, Gossip] = {}  # the newest gossip of each peer in closed rounds, not noted yet
        self.needed: Rectangle | None = None  # outside of this no new peer matters before the next selection

    def note(self, peer: Peer, beacon: Beacon) -> None:
        """Note the position in a beacon, if the peer is live."""
        if self._has_position(peer):
            self.put(peer.name, beacon.tick, beacon_row(beacon, self._diagram))

    def note_all(self, beacons: list[Beacon], peers: dict[str, Peer]) -> list[Beacon]:
        """Note the beacons that change nothing but the position of a live, known peer; return the other beacons."""
        others, limit = [], self.silence_limit
        for beacon in beacons:
            peer = peers.get(beacon.sender)
            if (
                peer is None
                or peer.beacon is None
                or peer.announced is None
                or peer.left_at is not None
                or peer.missed >= limit
                or peer.incarnation != beacon.incarnation
                or beacon.tick < peer.beacon.tick
            ):
                others.append(beacon)
            else:
                peer.beacon = beacon
                self.put(beacon.sender, beacon.tick, beacon_row(beacon, self._diagram))
        return others

    def matters(self, beacon: Beacon) -> bool:
        """Whether a new peer with this beacon could change the selection before the next one is due."""
        x, y = beacon.position
        return self.needed is None or self.needed.contains(Rectangle(x, y, x, y))

    def close(self, gossips: dict[str, Gossip]) -> None:
        """Keep the gossips of a closed round. Their positions are noted by `catch_up`, which not every round needs."""
        self._pending.update(gossips)

    def catch_up(self, peers: dict[str, Peer], *, all_live: bool = False) -> None:
        """Note the positions in the gossips of closed rounds. `all_live`: all their senders are live."""
        gossips, self._pending = self._pending, {}
        for name, gossip in gossips.items():
            peer = peers.get(name)
            if peer is not None and peer.announced is not None and (all_live or self._has_position(peer)):
                self.put(name, gossip.tick, gossip_row(gossip, peer.announced, self._diagram))

    def _has_position(self, peer: Peer) -> bool:
        """Whether a peer has a position: it has not gone, its sensor is known, and it has not been silent for long."""
        return peer.left_at is None and peer.announced is not None and peer.missed < self.silence_limit
