"""The liveliness tokens that are up: a node gets one event when a token appears and one when it vanishes."""

import logging
from collections.abc import Iterable

from protocol.keys import Token, matches, parse_token, token_key
from protocol.node import Alive, Gone

MOST_TOKENS = 4096  # kept: a session holds no more links, and anybody may declare tokens
ALONE_SECONDS = 10.0  # after which a process that sees no token logs a warning

log = logging.getLogger(__name__)


class Tokens:
    """The tokens that a session has seen, without the own one and without those that nobody follows any more."""

    def __init__(self, own: Token, followed: Iterable[str]) -> None:
        """`followed`: the expressions of the tokens that are followed from the beginning."""
        self._own = own
        self._followed = set(followed)
        self._up: set[Token] = set()
        self._doubtful: set[Token] = set()  # seen by an earlier session, not yet by this one

    def see(self, key: str, up: bool) -> Alive | Gone | None:
        """The event for a token that has appeared or vanished; None: no news."""
        token = parse_token(key)
        if token is None or token == self._own or not any(matches(expression, key) for expression in self._followed):
            return None
        self._doubtful.discard(token)
        if (token in self._up) == up or (up and len(self._up) >= MOST_TOKENS):
            return None
        if up:
            self._up.add(token)
            return Alive(token.role, token.name, token.incarnation)
        self._up.remove(token)
        return Gone(token.role, token.name, token.incarnation)

    def follow(self, expression: str) -> None:
        """Tell of the tokens in the expression from now on."""
        self._followed.add(expression)

    def forget(self, expression: str) -> None:
        """Forget the tokens of a subscription that has ended; a later one reports them again."""
        self._followed.discard(expression)
        self._up = {token for token in self._up if not matches(expression, token_key(*token))}
        self._doubtful &= self._up

    def doubt(self) -> None:
        """Note that the session was closed: its tokens must be seen again by the next session."""
        self._doubtful = set(self._up)

    def take_lost(self) -> list[Gone]:
        """The events for the tokens that the new session has not seen again."""
        lost, self._doubtful = sorted(self._doubtful), set()
        self._up -= set(lost)
        return [Gone(token.role, token.name, token.incarnation) for token in lost]

    def warn_if_alone(self, seeds: Iterable[str]) -> None:
        """Log what to check when no token is up: a session that every peer refuses opens all the same."""
        if not self._up and seeds:
            where = ", ".join(seeds)
            log.warning("nobody has appeared in %g s: does anybody listen at %s, in run %s?", ALONE_SECONDS, where, self._own.run)
            log.warning("with certificates: of the same authority, not run out, and of names that the others admit (network.admit)?")
