"""Peers without a body: an agent whose body has gone is blind and stands still, so it owns no cell, though its token is up."""

from agents.membership.peer_table import PeerTable


class BodyTokens:
    """The bodies of peers, where every body is a process of its own. Without such bodies no event comes here."""

    def __init__(self, peers: PeerTable) -> None:
        self._peers = peers
        self._newest: dict[str, int] = {}  # name -> youngest incarnation of its body that is there
        self._bodiless: dict[str, int] = {}  # name -> incarnation of the agent that counts as gone

    def appear(self, name: str, incarnation: int) -> None:
        """A body has come: its agent counts as alive again."""
        self._newest[name] = max(incarnation, self._newest.get(name, 0))
        agent = self._bodiless.pop(name, None)
        if agent is not None:
            self._peers.alive(name, agent)

    def leave(self, name: str, incarnation: int, tick: int, *, suspected: bool) -> bool:
        """A body has gone: its agent counts as gone from the round `tick` on; whether it does now. `suspected`: as in `PeerTable.gone`."""
        if incarnation < self._newest.get(name, 0):
            return False
        self._newest.pop(name, None)
        peer = self._peers.peers.get(name)
        if peer is None or not peer.token:
            return False
        self._bodiless[name] = peer.incarnation
        return self._peers.gone(name, peer.incarnation, tick, suspected=suspected)

    def agent_left(self, name: str, incarnation: int) -> None:
        """An agent itself has gone: it does not come back with its body."""
        if self._bodiless.get(name) == incarnation:
            del self._bodiless[name]

    def agent_replaced(self, name: str, incarnation: int) -> None:
        """An agent has come; if it is the successor of one without a body, its own token counts."""
        if name in self._bodiless and self._bodiless[name] < incarnation:
            del self._bodiless[name]
