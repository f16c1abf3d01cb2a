"""Detectors of a half-open session, for agents that hear neighbours only.

Two Zenoh peers can be left with half a session (`protocol.session_watchdog`). In a swarm that hears everybody, Hellos show it: they list
the peers that their senders hear. An agent that hears neighbours only gets no such Hellos, but it gets claims. A claim names the peers
that bound a cell, and their generators.

A peer is unheard if neighbours name it for two periods of beacons, its generator lies where this agent receives all beacons, and none has
come from it. Then the session is to be opened anew.
"""

from collections.abc import Callable, Collection, Iterable
from typing import NamedTuple

from protocol.messages import Gossip
from protocol.session_watchdog import NEVER, AlarmRest, patience_of

Place = tuple[float, float]  # x, y, m


class Beginning(NamedTuple):
    """When something began: the tick, and `now` in s."""

    tick: int
    now: float


class HalfOpenLinkDetector:
    """The unheard peers that the claims of neighbours name, and since when."""

    def __init__(self, name: str, timeout: int, lease: float) -> None:
        """`timeout`: ticks for which a peer must be named. `patience_of(lease)` s of `now` must pass as well: lockstep ticks are short."""
        self._name, self._timeout, self._patience = name, timeout, patience_of(lease)
        self._named: dict[str, Beginning] = {}
        self._rest = AlarmRest()

    def find_unheard(
        self, gossips: Iterable[Gossip], known: Collection[str], is_covered: Callable[[Place], bool], tick: int, now: float
    ) -> str:
        """The name of a peer that should have been heard by the end of the round `tick`; empty: there is none.

        `known`: the names of known peers; `is_covered`: whether the beacons of an agent with its generator at a place reach this agent.
        """
        heard, own = list(gossips), {self._name}
        unknown = set().union(*[gossip.claim_names for gossip in heard]).difference(known, own)  # as a rule it is empty
        named = {
            name: self._named.get(name, Beginning(tick, now))
            for gossip in heard
            for name in unknown.intersection(gossip.claim_names)
            if is_covered(_place(gossip, name))
        }
        self._named = named
        late = [name for name, since in named.items() if tick - since.tick >= self._timeout and now - since.now >= self._patience]
        if not late or not self._rest.is_over(now):
            return ""
        self._named = {}
        self._rest.begin(now)
        return min(late)


class WorldLinkDetector:
    """Whether the neighbours' ticks advance while no new tick reaches this agent: the session with the world alone is half open.

    In a swarm that hears everybody, Hellos show this (`protocol.session_watchdog`).
    """

    def __init__(self, lease: float) -> None:
        """`lease`: s for which a link may be silent."""
        self._since, self._patience = Beginning(-1, NEVER), patience_of(lease)
        self._rest = AlarmRest()

    def should_reopen(self, tick: int, now: float) -> bool:
        """Note that a gossip is more than one tick ahead of the own `tick`; whether the session is to be opened anew."""
        if tick != self._since.tick or now < self._since.now:
            self._since = Beginning(tick, now)
        if now - self._since.now < self._patience or not self._rest.is_over(now):
            return False
        self._rest.begin(now)
        return True


def _place(gossip: Gossip, name: str) -> Place:
    """The generator of a peer as a claim states it, m."""
    x, y, _ = gossip.claim[gossip.claim_names.index(name)].tolist()
    return x, y
