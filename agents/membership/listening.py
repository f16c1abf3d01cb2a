"""How long a newcomer listens before it takes a cell.

Data type: a `Listening`, true while the agent listens. It ends with a complete round, after `timing.listening_rounds` incomplete ones, or
after twice `timing.silent_rounds` in which nobody was heard, counted in all: then the agent is alone.
"""

from agents.config import TimingSettings


class Listening:
    """The rounds in which one agent listens."""

    def __init__(self, timing: TimingSettings) -> None:
        self._timing = timing
        self._rounds = 0  # left, in which somebody is heard
        self._silent = 0  # left, in which nobody is

    def __bool__(self) -> bool:
        """Whether the agent listens, and has no cell."""
        return self._rounds > 0

    def start(self, *, is_late: bool) -> None:
        """The first observation has come. An agent that is there from the first tick on need not listen."""
        self._rounds = self._timing.listening_rounds if is_late else 0
        self._silent = 2 * self._timing.silent_rounds

    def count(self, fresh: int, missing: int) -> None:
        """A round has ended with so many fresh gossips, and so many missing ones."""
        if fresh:
            self._rounds = max(0, self._rounds - 1) if missing else 0
            return
        self._silent -= 1
        if self._silent <= 0:
            self._rounds = 0
