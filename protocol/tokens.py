"""Which liveliness tokens are up, so that a node is told of each once when it appears and once when it vanishes."""

from protocol.keys import Token, matches, parse_token, token_key
from protocol.node import Alive, Gone


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
