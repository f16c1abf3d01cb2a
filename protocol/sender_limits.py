"""Limits for what others send to a live node: the rate limit per key, and the quarantine of senders of garbage.

Pure bookkeeping without sockets.
"""

import math
import threading
from collections import deque
from typing import Any

from protocol.arrival_queue import session_of


class RateLimiter:
    """The rate limit per key, `most` messages a second, and beyond it per session.

    A key beyond the limit becomes suspect. Under a suspect key each session has a token bucket of its own: `most` messages at once, and
    as many a second in the long run.
    """

    MOST_KEYS = 4096

    def __init__(self, most: int) -> None:
        self._most = float(most)
        self._lock = threading.Lock()
        self._counts: dict[str, int] = {}  # messages in this second, by key
        self._second = 0.0  # end of this second
        self._suspect: dict[str, None] = {}  # keys
        self._left: dict[tuple[str, str], tuple[float, float]] = {}  # (key, session) -> messages left in its bucket, and when that was, s

    def admits(self, key: str, origin: Any, now: float) -> bool:
        """Count one message; True within the limit.

        Beyond a fixed number of keys in a second all others count as one suspect key. Of the suspect keys those quiet for longest are
        forgotten.
        """
        if now >= self._second:
            self._counts, self._second = {}, now + 1.0
        count = self._counts.get(key, 0) + 1
        if count > 1 or len(self._counts) < self.MOST_KEYS:
            self._counts[key] = count
            if count <= self._most and key not in self._suspect:
                return True
        else:
            key = ""
        with self._lock:
            self._suspect.pop(key, None)
            self._suspect[key] = None  # at the end
            return self._admits(key, session_of(origin), now)

    def _admits(self, key: str, source: str, now: float) -> bool:
        left, then = self._left.pop((key, source), (self._most, now))
        left = min(self._most, left + (now - then) * self._most)
        self._left[key, source] = (left - 1.0 if left >= 1.0 else left), now
        if len(self._left) > self.MOST_KEYS:
            del self._left[next(iter(self._left))]
        if len(self._suspect) > self.MOST_KEYS:
            del self._suspect[next(iter(self._suspect))]
        return left >= 1.0


class Quarantine:
    """The sources of too much garbage: `most` bad messages within `window` s exclude a source for `window` s."""

    MOST_SOURCES = 1024

    def __init__(self, most: int = 20, window: float = 10.0) -> None:
        self._most = most
        self._window = window
        self._offences: dict[str, deque[float]] = {}
        self._until: dict[str, float] = {}

    def is_quarantined(self, source: str, now: float) -> bool:
        """Whether messages of the source are discarded unread."""
        return now < self._until.get(source, -math.inf)

    def is_any_quarantined(self, now: float) -> bool:
        """Whether messages of any source are discarded unread."""
        if self._until:
            self._until = {source: until for source, until in self._until.items() if now < until}
        return bool(self._until)

    def offend(self, source: str, now: float) -> None:
        """Note one bad message. Beyond a fixed number the oldest sources are forgotten."""
        times = self._offences.pop(source, None) or deque(maxlen=self._most)
        times.append(now)
        if len(times) == self._most and now - times[0] <= self._window:
            self._until[source] = now + self._window
            times = deque(maxlen=self._most)
        self._offences[source] = times
        for table in (self._offences, self._until):
            while len(table) > self.MOST_SOURCES:
                del table[next(iter(table))]  # type: ignore[attr-defined]
