"""The newest tick that a watcher of a run knows of, by which it stops to wait for messages of older ones."""

from collections import deque


class NewestTick:
    """The newest tick heard of, at least `seconds` ago.

    A watcher that was starved reads what it has missed sender by sender. Then one sender may be far ahead though nothing is lost.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._newest = self._known = -1
        self._heard: deque[tuple[float, int]] = deque()  # when, s, and which tick, oldest first

    def hear(self, tick: int, now: float) -> None:
        """Note a tick that a message states."""
        if tick > self._newest:
            self._newest = tick
            self._heard.append((now, tick))

    def at(self, now: float) -> int:
        """The newest tick that was heard of so long before `now`; -1: none."""
        while self._heard and self._heard[0][0] <= now - self._seconds:
            self._known = self._heard.popleft()[1]
        return self._known
