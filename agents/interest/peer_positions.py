"""Where peers are, as far as they have gossips so themselves: for an agent that hears its neighbours only and chooses whom to hear."""

from agents.config import AgentConfig
from agents.interest.position_table import PositionTable, beacon_row, position_row
from agents.interest.tiles import Rectangle
from agents.membership.peer import Peer
from protocol.messages import Beacon, Gossip


class PeerPositions(PositionTable):
    """The places of peers, by their beacons and gossips."""

    def __init__(self, config: AgentConfig) -> None:
        super().__init__()
        self._diagram, self._silent = config.partition.kind, config.timing.silent_rounds
        self._pending: dict[str, Gossip] = {}  # in rounds that are over, the newest of each, not noted yet
        self.needed: Rectangle | None = None  # outside of this nobody matters before the next choice

    def note(self, peer: Peer, beacon: Beacon) -> None:
        """Note where a peer is, if it is anywhere."""
        if self._counts(peer):
            self.put(peer.name, beacon.tick, beacon_row(beacon, self._diagram))

    def note_all(self, beacons: list[Beacon], peers: dict[str, Peer]) -> list[Beacon]:
        """Note where those are who are well known, and ask for nothing; the beacons of the others."""
        others, silent = [], self._silent
        noted: list[tuple[str, int, bytes]] = []
        for beacon in beacons:
            peer = peers.get(beacon.sender)
            if (
                peer is None
                or beacon.asks
                or peer.beacon is None
                or peer.left_at is not None
                or peer.missed >= silent
                or peer.incarnation != beacon.incarnation
                or beacon.tick < peer.beacon.tick
            ):
                others.append(beacon)
            else:
                peer.beacon = beacon
                noted.append((beacon.sender, beacon.tick, beacon_row(beacon, self._diagram)))
        self.put_all(noted)
        return others

    def matters(self, beacon: Beacon) -> bool:
        """Whether somebody who says this could make a difference before the next choice: it is made for where nobody is unknown."""
        x, y = beacon.position
        return self.needed is None or self.needed.holds(Rectangle(x, y, x, y))

    def close(self, gossips: dict[str, Gossip]) -> None:
        """A round is over in which this was gossips; it is noted once somebody asks where all are, which is not so after every round."""
        self._pending.update(gossips)

    def catch_up(self, peers: dict[str, Peer], *, steady: bool = False) -> None:
        """Note what was gossips in the rounds that are over. `steady`: all count who gossips something."""
        gossips, self._pending = self._pending, {}
        found = []
        for name, gossip in gossips.items():
            peer = peers.get(name)
            if peer is not None and peer.announced is not None and (steady or self._counts(peer)):
                reach = peer.announced.sensor.reach
                found.append((name, gossip.tick, position_row(gossip.pose[:2], reach, gossip.cod, gossip.power_radius, self._diagram)))
        self.put_all(found)

    def _counts(self, peer: Peer) -> bool:
        """Whether a peer is somewhere: it has not gone, and has not been silent for long."""
        return peer.left_at is None and peer.announced is not None and peer.missed < self._silent
