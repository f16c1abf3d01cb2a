"""What arrives from other threads: a bounded queue in front of the event loop, and the quarantine of senders of garbage.

Pure bookkeeping without sockets; `live` owns one of each.
"""

import threading
from collections import deque
from dataclasses import dataclass

MOST_ENTRIES = 4096
MOST_BYTES = 16 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class Arrival:
    """A payload under a key, from a Zenoh session (`source`, empty if it does not say); a token has no payload but a state."""

    key: str
    payload: bytes = b""
    source: str = ""
    token: bool | None = None  # True: the liveliness token appeared, False: it vanished


class Inbox:
    """A queue that any thread fills and the event loop empties; when it overflows, the newest per key stays."""

    def __init__(self, most_entries: int = MOST_ENTRIES, most_bytes: int = MOST_BYTES) -> None:
        self.dropped = 0  # messages that gave way to newer ones
        self._lock = threading.Lock()
        self._queue: deque[Arrival] = deque()
        self._bytes = 0
        self._most_entries = most_entries
        self._most_bytes = most_bytes
        self._called = False  # the loop has been asked to come and has not come yet

    def __len__(self) -> int:
        return len(self._queue)

    def add(self, arrival: Arrival) -> bool:
        """Append; True when the event loop must be called, which is at most once until it comes."""
        with self._lock:
            self._queue.append(arrival)
            self._bytes += len(arrival.payload)
            if len(self._queue) > self._most_entries or self._bytes > self._most_bytes:
                self._thin_out()
            called, self._called = self._called, True
            return not called

    def take(self, most: int) -> list[Arrival]:
        """The oldest entries, `most` at most; an empty list hands the duty to call back to `add`."""
        with self._lock:
            batch = [self._queue.popleft() for _ in range(min(most, len(self._queue)))]
            self._bytes -= sum(len(arrival.payload) for arrival in batch)
            self._called = bool(batch)
            return batch

    def _thin_out(self) -> None:
        """Keep the newest per key; if that frees less than half, also give up the older half of the messages, never a token."""
        newest: dict[str, Arrival] = {}
        for arrival in self._queue:
            newest.pop(arrival.key, None)
            newest[arrival.key] = arrival
        kept = list(newest.values())
        if 2 * len(kept) > self._most_entries or 2 * sum(len(a.payload) for a in kept) > self._most_bytes:
            half = len(kept) // 2
            kept = [a for a in kept[:half] if a.token is not None] + kept[half:]
        self.dropped += len(self._queue) - len(kept)
        self._queue = deque(kept)
        self._bytes = sum(len(arrival.payload) for arrival in kept)


class Quarantine:
    """Who sent too much garbage: `most` bad messages within `window` s shut a source out for `window` s."""

    MOST_SOURCES = 1024

    def __init__(self, most: int = 20, window: float = 10.0) -> None:
        self._most = most
        self._window = window
        self._offences: dict[str, deque[float]] = {}
        self._until: dict[str, float] = {}

    def holds(self, source: str, now: float) -> bool:
        """Whether messages of the source are to be thrown away unread."""
        if source not in self._until:
            return False
        if now < self._until[source]:
            return True
        del self._until[source]
        return False

    def offend(self, source: str, now: float) -> None:
        """Note one bad message; the oldest sources are forgotten beyond a fixed number."""
        times = self._offences.pop(source, None) or deque(maxlen=self._most)
        times.append(now)
        if len(times) == self._most and now - times[0] <= self._window:
            self._until[source] = now + self._window
            times = deque(maxlen=self._most)
        self._offences[source] = times
        for table in (self._offences, self._until):
            while len(table) > self.MOST_SOURCES:
                del table[next(iter(table))]  # type: ignore[attr-defined]
