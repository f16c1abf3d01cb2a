"""Which liveliness tokens are up, so that a node is told of each once when it appears and once when it vanishes."""

import logging
from collections.abc import Iterable

from protocol.keys import Token, matches, parse_token, token_key
from protocol.node import Alive, Gone

ALONE_SECONDS = 10.0  # after which a process that has met nobody says where to look

log = logging.getLogger(__name__)


class Tokens:
    """The tokens that a session has seen, the own one excepted."""

    def __init__(self, own: Token) -> None:
        self._own = own
        self._up: set[Token] = set()
        self._doubtful: set[Token] = set()  # seen by an earlier session, not yet by this one

    def see(self, key: str, up: bool) -> Alive | Gone | None:
        """What to tell the node when a token has appeared or vanished; None: nothing new."""
        token = parse_token(key)
        if token is None or token == self._own:
            return None
        self._doubtful.discard(token)
        if (token in self._up) == up:
            return None
        if up:
            self._up.add(token)
            return Alive(token.role, token.name, token.incarnation)
        self._up.remove(token)
        return Gone(token.role, token.name, token.incarnation)

    def forget(self, expression: str) -> None:
        """Nobody asks for these any more; whoever asks again is told again."""
        self._up = {token for token in self._up if not matches(expression, token_key(*token))}
        self._doubtful &= self._up

    def doubt(self) -> None:
        """The session has been closed: what it saw is to be seen again."""
        self._doubtful = set(self._up)

    def lost(self) -> list[Gone]:
        """What to tell the node of the tokens that have not been seen again."""
        lost, self._doubtful = sorted(self._doubtful), set()
        self._up -= set(lost)
        return [Gone(token.role, token.name, token.incarnation) for token in lost]

    def warn_if_alone(self, seeds: Iterable[str]) -> None:
        """Say what to look at when nobody has appeared: a session that is refused opens all the same."""
        if not self._up and seeds:
            where = ", ".join(seeds)
            log.warning("nobody has appeared in %g s: does anybody listen at %s, in run %s?", ALONE_SECONDS, where, self._own.run)
            log.warning("with certificates: of the same authority, not run out, and of names that the others admit (network.admit)?")
