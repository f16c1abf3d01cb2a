"""The liveliness tokens that are up: a node gets one event when a token appears and one when it vanishes."""

import logging
from collections.abc import Iterable, Sequence

from protocol.keys import Token, matches, parse_token, token_key
from protocol.node import Alive, Gone

MOST_NAMES = 4096  # shown to a node: a session holds no more links, and anybody may declare tokens. As many more names wait
MOST_INCARNATIONS = 8  # of one role and name: a restart leaves its token behind for one lease at most
ROLES = frozenset(("agent", "world", "body", "recorder", "monitor", "operator"))  # tokens of others are passed over
ALONE_SECONDS = 10.0  # after which a process that sees no token logs a warning
NO_EVENTS = ()

log = logging.getLogger(__name__)


class Tokens:
    """The tokens that a session has seen, without the own one and without those that nobody follows any more.

    The node is shown the tokens of `MOST_NAMES` names. Later names wait, for anybody can make up names. A waiting name that speaks is
    shown in place of the earliest name that has said nothing since its token came.
    """

    def __init__(self, own: Token, followed: Iterable[str]) -> None:
        """`followed`: the expressions of the tokens that are followed from the beginning."""
        self._own = own
        self._followed = set(followed)
        self._up: dict[str, dict[Token, None]] = {}  # by name, shown or waiting; of each name the earliest first
        self._silent: dict[str, None] = {}  # shown names that have said nothing since their token came, the earliest first
        self._waiting: dict[str, None] = {}  # the earliest first
        self._suspected: set[Token] = set()  # seen by an earlier session, not yet by this one

    def see(self, key: str, up: bool) -> list[Alive | Gone]:
        """The events for a token that has appeared or vanished; empty: no news."""
        token = parse_token(key)
        if token is None or token == self._own or token.role not in ROLES or not any(matches(each, key) for each in self._followed):
            return []
        self._suspected.discard(token)
        if (token in self._up.get(token.name, ())) == up:
            return []
        return self._add(token) if up else self._remove(token)

    def _add(self, token: Token) -> list[Alive | Gone]:
        """Add a token. Of too many incarnations of its role and name the smallest goes: of two live ones the larger counts."""
        name = token.name
        if name not in self._up:
            (self._waiting if self._is_full() else self._silent)[name] = None
            self._up[name] = {}
            if len(self._waiting) > MOST_NAMES:
                self._remove_all(self._up[next(iter(self._waiting))])
        alike = [other for other in self._up[name] if other.role == token.role]
        smallest = min(alike, default=token)
        if len(alike) >= MOST_INCARNATIONS and token < smallest:
            return []
        gone = self._remove(smallest) if len(alike) >= MOST_INCARNATIONS else []
        self._up[name][token] = None
        return [] if name in self._waiting else [*gone, _alive(token)]

    def _remove(self, token: Token) -> list[Alive | Gone]:
        """Remove a token that is up; the event, if it was shown."""
        name, tokens = token.name, self._up[token.name]
        shown = name not in self._waiting
        self._suspected.discard(token)
        del tokens[token]
        if not tokens:
            del self._up[name]
            self._silent.pop(name, None)
            self._waiting.pop(name, None)
        return [_gone(token)] if shown else []

    def _remove_all(self, tokens: Iterable[Token]) -> list[Alive | Gone]:
        return [event for token in sorted(tokens) for event in self._remove(token)]

    def _is_full(self) -> bool:
        """Whether the node is shown as many names as it may."""
        return len(self._up) - len(self._waiting) >= MOST_NAMES

    def hear(self, name: str) -> Sequence[Alive | Gone]:
        """Note a message of this name: its tokens stay shown. The events, if it has waited until now."""
        self._silent.pop(name, None)
        if name not in self._waiting or (self._is_full() and not self._silent):
            return NO_EVENTS
        events: list[Alive | Gone] = []
        if self._is_full():
            earliest = next(iter(self._silent))
            del self._silent[earliest]
            self._waiting[earliest] = None
            events += map(_gone, self._up[earliest])
        del self._waiting[name]
        return [*events, *map(_alive, self._up[name])]

    def follow(self, expression: str) -> None:
        """Tell of the tokens in the expression from now on."""
        self._followed.add(expression)

    def forget(self, expression: str) -> None:
        """Forget the tokens of a subscription that has ended; a later one reports them again."""
        self._followed.discard(expression)
        self._remove_all(token for token in self._all() if matches(expression, token_key(*token)))

    def suspect_all(self) -> None:
        """Note that the session was closed: its tokens must be seen again by the next session."""
        self._suspected = set(self._all())

    def take_lost(self) -> list[Alive | Gone]:
        """The events for the tokens that the new session has not seen again."""
        return self._remove_all(self._suspected)

    def _all(self) -> Iterable[Token]:
        return (token for tokens in self._up.values() for token in tokens)

    def warn_if_alone(self, seeds: Iterable[str]) -> None:
        """Log what to check when no token is up: a session that every peer refuses opens all the same."""
        if not self._up and seeds:
            where = ", ".join(seeds)
            log.warning("nobody has appeared in %g s: does anybody listen at %s, in run %s?", ALONE_SECONDS, where, self._own.run)
            log.warning("with certificates: of the same authority, not run out, and of names that the others admit (network.admit)?")


def _alive(token: Token) -> Alive:
    return Alive(token.role, token.name, token.incarnation)


def _gone(token: Token) -> Gone:
    return Gone(token.role, token.name, token.incarnation)
