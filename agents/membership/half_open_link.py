"""Signs of a session that has stayed split, where neighbours alone are claims: they name whom I do not know, or go on without me.

Two Zenoh peers can be left with half a session (`protocol.failure_detector`), and who hears its neighbours only is told by no Hello whom
the others hear. Their claims tell it: they name who bounds their cells, and where. Whoever stands where I listen to all beacons, is named
by a neighbour all the time, and has not said a word to me for two beacons' periods, is there; then my session is to be opened anew.
"""

from collections.abc import Callable, Collection, Iterable
from typing import NamedTuple

from protocol.failure_detector import FIRST_REST, LONGEST_REST, NEVER, PATIENCE
from protocol.messages import Gossip

Place = tuple[float, float]  # x, y, m


class Since(NamedTuple):
    """When something began."""

    tick: int
    now: float


class HalfOpenLinkDetector:
    """Who is spoken of, and since when."""

    def __init__(self, name: str, timeout: int) -> None:
        """`timeout`: ticks for which somebody must be named; it takes `PATIENCE` s of `now` as well, for in lockstep ticks fly."""
        self._name, self._timeout = name, timeout
        self._named: dict[str, Since] = {}
        self._rest, self._not_before = FIRST_REST, NEVER

    def find_unheard(
        self, gossips: Iterable[Gossip], known: Collection[str], is_covered: Callable[[Place], bool], tick: int, now: float
    ) -> str:
        """Of whom I should have claims by now, after the round `tick`; empty: nobody.

        `known`: whom I do know; `is_covered`: whether I hear the beacons of whoever has his generator at a place.
        """
        claims, own = list(gossips), {self._name}
        unknown = set().union(*[gossip.claim_names for gossip in claims]).difference(known, own)  # as a rule there is nobody
        named = {
            name: self._named.get(name, Since(tick, now))
            for gossip in claims
            for name in unknown.intersection(gossip.claim_names)
            if is_covered(_place(gossip, name))
        }
        self._named = named
        late = [name for name, since in named.items() if tick - since.tick >= self._timeout and now - since.now >= PATIENCE]
        if not late or now < self._not_before:
            return ""
        self._named = {}
        self._not_before, self._rest = now + self._rest, min(2.0 * self._rest, LONGEST_REST)
        return min(late)


class LagDetector:
    """Whether the others go on while I am told of no new tick: the sign of a session that is split from the world's alone.

    Whoever hears all is told by their Hellos that they hear the world (`protocol.failure_detector`); who does not sees it by their ticks.
    """

    def __init__(self) -> None:
        self._since = Since(-1, NEVER)
        self._rest, self._not_before = FIRST_REST, NEVER

    def is_behind(self, tick: int, now: float) -> bool:
        """Somebody speaks of a tick that is more than one ahead of mine, `tick`; whether my session is to be opened anew."""
        if tick != self._since.tick or now < self._since.now:
            self._since = Since(tick, now)
        if now - self._since.now < PATIENCE or now < self._not_before:
            return False
        self._not_before, self._rest = now + self._rest, min(2.0 * self._rest, LONGEST_REST)
        return True


def _place(gossip: Gossip, name: str) -> Place:
    """Where a claim says that somebody's generator was."""
    x, y, _ = gossip.claim[gossip.claim_names.index(name)].tolist()
    return x, y
