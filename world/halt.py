"""The operator's halt, as whoever moves bodies keeps it."""

from collections.abc import Callable

from protocol.messages import Halt


class Hold:
    """Whether bodies are to stand, by the latest order; `on_order` is called with every order that counts."""

    def __init__(self) -> None:
        self.holds = False
        self.on_order: Callable[[Halt], object] = lambda halt: None
        self._newest = -1

    def take(self, halt: Halt) -> bool:
        """Take an order; whether bodies are to stand now. An order that is older than the one at hand changes nothing."""
        if halt.incarnation > self._newest:
            self._newest, self.holds = halt.incarnation, halt.held
            self.on_order(halt)
        return self.holds
