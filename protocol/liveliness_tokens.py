"""The liveliness tokens that are up: a node gets one event when a token appears and one when it vanishes."""

import logging
from collections.abc import Iterable

from protocol.keys import Token, matches, parse_token, token_key
from protocol.node import Alive, Gone

MOST_TOKENS = 4096  # kept: a session holds no more links, and anybody may declare tokens
ALONE_SECONDS = 10.0  # after which a process that sees no token logs a warning

log = logging.getLogger(__name__)


class Tokens:
    """The tokens that a session has seen, without the own one and without those that nobody follows any more.

    Of too many tokens those of the earliest name that has said nothing since are dropped: anybody can make up names.
    """

    def __init__(self, own: Token, followed: Iterable[str]) -> None:
        """`followed`: the expressions of the tokens that are followed from the beginning."""
        self._own = own
        self._followed = set(followed)
        self._up: set[Token] = set()
        self._unheard: dict[str, list[Token]] = {}  # name -> tokens after which it has said nothing, the earliest name first
        self._doubtful: set[Token] = set()  # seen by an earlier session, not yet by this one

    def see(self, key: str, up: bool) -> list[Alive | Gone]:
        """The events for a token that has appeared or vanished; empty: no news."""
        token = parse_token(key)
        if token is None or token == self._own or not any(matches(expression, key) for expression in self._followed):
            return []
        self._doubtful.discard(token)
        if (token in self._up) == up:
            return []
        if not up:
            self._remove(token)
            return [_gone(token)]
        dropped = [*next(iter(self._unheard.values()), [])] if len(self._up) >= MOST_TOKENS else []
        for other in dropped:
            self._remove(other)
        if len(self._up) >= MOST_TOKENS:
            return []
        self._up.add(token)
        self._unheard.setdefault(token.name, []).append(token)
        return [*map(_gone, dropped), Alive(token.role, token.name, token.incarnation)]

    def hear(self, name: str) -> None:
        """Note a message of this name: its tokens are kept."""
        self._unheard.pop(name, None)

    def _remove(self, token: Token) -> None:
        self._up.discard(token)
        self._doubtful.discard(token)
        tokens = self._unheard.get(token.name, [])
        if token in tokens:
            tokens.remove(token)
            if not tokens:
                del self._unheard[token.name]

    def follow(self, expression: str) -> None:
        """Tell of the tokens in the expression from now on."""
        self._followed.add(expression)

    def forget(self, expression: str) -> None:
        """Forget the tokens of a subscription that has ended; a later one reports them again."""
        self._followed.discard(expression)
        for token in [token for token in self._up if matches(expression, token_key(*token))]:
            self._remove(token)

    def doubt(self) -> None:
        """Note that the session was closed: its tokens must be seen again by the next session."""
        self._doubtful = set(self._up)

    def take_lost(self) -> list[Gone]:
        """The events for the tokens that the new session has not seen again."""
        lost = sorted(self._doubtful)
        for token in lost:
            self._remove(token)
        return [*map(_gone, lost)]

    def warn_if_alone(self, seeds: Iterable[str]) -> None:
        """Log what to check when no token is up: a session that every peer refuses opens all the same."""
        if not self._up and seeds:
            where = ", ".join(seeds)
            log.warning("nobody has appeared in %g s: does anybody listen at %s, in run %s?", ALONE_SECONDS, where, self._own.run)
            log.warning("with certificates: of the same authority, not run out, and of names that the others admit (network.admit)?")


def _gone(token: Token) -> Gone:
    return Gone(token.role, token.name, token.incarnation)
