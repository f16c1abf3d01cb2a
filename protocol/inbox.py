"""The queue between Zenoh's threads and the event loop, what faulty links delay before it, the rate limit per key, and the quarantine of
senders of garbage.

Pure bookkeeping without sockets, for the live driver.
"""

import math
import threading
from collections import Counter, deque
from heapq import heappop, heappush
from typing import Any, NamedTuple

from protocol.link_faults import LiveLink

MOST_ENTRIES = 4096
MOST_BYTES = 16 * 1024 * 1024
OBSERVATION = "/observation/"  # part of the keys of observations


class Arrival(NamedTuple):
    """A payload under a key; a token has no payload but a state."""

    key: str
    payload: bytes = b""
    origin: Any = ""  # Zenoh's source info, or the name of the session; empty or None: unknown
    token: bool | None = None  # True: the liveliness token appeared, False: it vanished

    @property
    def source(self) -> str:
        """The name of the Zenoh session that sent it; empty if unknown."""
        return session_of(self.origin)


def session_of(origin: Any) -> str:
    """The name of the session of an `Arrival`. Asking Zenoh for it costs a third of taking a message, so that is done late."""
    return origin if isinstance(origin, str) else str(origin.source_id.zid) if origin else ""


class RateLimiter:
    """The rate limit per key: `most` messages a second.

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


class Inbox:
    """A queue that any thread fills and the event loop empties.

    On overflow only the newest message per key and session stays, and if those are too many, only the newer half of them. Of each token
    the newest state stays: tokens alone are not bounded.

    `coalesced_keys` is a part of keys. Messages with it wait until as many have come as `finish_pass` says: one wake-up costs less.
    """

    def __init__(self, most_entries: int = MOST_ENTRIES, most_bytes: int = MOST_BYTES, coalesced_keys: str = "") -> None:
        self.dropped = 0  # messages dropped in favour of newer ones
        self._coalesced_keys = coalesced_keys
        self._waiting = 0  # coalesced messages in the queue
        self._wake_at = 1  # coalesced messages at which the loop is called
        self._lock = threading.Lock()
        self._queue: deque[Arrival] = deque()
        self._bytes = 0
        self._most_entries = most_entries
        self._most_bytes = most_bytes
        self._called = False  # the loop has been called and has not finished its pass yet

    def __len__(self) -> int:
        return len(self._queue)

    def add(self, arrival: Arrival) -> bool:
        """Append an arrival; True when the event loop must be called: at most once until it has finished a pass."""
        with self._lock:
            self._queue.append(arrival)
            self._bytes += len(arrival.payload)
            coalesced = self.is_coalesced(arrival)
            self._waiting += coalesced
            if len(self._queue) > self._most_entries or self._bytes > self._most_bytes:
                self._thin_out()
            if self._called or (coalesced and self._waiting < self._wake_at):
                return False
            self._called = True
            return True

    def take(self, most: int, most_observations: int = 0) -> list[Arrival]:
        """The oldest entries, at most `most`. If there were any, no `add` calls the loop until `finish_pass`.

        `most_observations`: see `Node`.
        """
        with self._lock:
            if len(self._queue) <= most:
                batch, self._bytes, self._waiting = list(self._queue), 0, 0
                self._queue.clear()
            else:
                batch = [self._queue.popleft() for _ in range(most)]
                self._bytes -= sum([len(arrival.payload) for arrival in batch])
                self._waiting -= sum(map(self.is_coalesced, batch))
            self._called = bool(batch)
            return self._without_old(batch, most_observations) if most_observations else batch

    def finish_pass(self, wake_up_count: int) -> bool:
        """End a pass of the loop; `wake_up_count` coalesced messages call it again. True when the queue already calls for it."""
        with self._lock:
            self._wake_at = wake_up_count
            self._called = len(self._queue) > self._waiting or self._waiting >= max(wake_up_count, 1)
            return self._called

    def is_coalesced(self, arrival: Arrival) -> bool:
        """Whether an arrival can wait for others of its kind."""
        return self._coalesced_keys != "" and arrival.token is None and self._coalesced_keys in arrival.key

    def _without_old(self, batch: list[Arrival], most: int) -> list[Arrival]:
        """The batch without the observations of which `most` newer ones of the key and session are in the batch or in the queue."""
        if not any(OBSERVATION in arrival.key for arrival in batch):
            return batch
        newer = Counter((arrival.key, arrival.source) for arrival in (*batch, *self._queue) if OBSERVATION in arrival.key)
        kept = []
        for arrival in batch:
            if OBSERVATION in arrival.key:
                newer[arrival.key, arrival.source] -= 1
                if newer[arrival.key, arrival.source] >= most:
                    continue
            kept.append(arrival)
        self.dropped += len(batch) - len(kept)
        return kept

    def _thin_out(self) -> None:
        """Keep the newest per key and session. If that frees less than half, drop the older half of the messages too, never a token."""
        newest: dict[tuple[str, str], Arrival] = {}
        for arrival in self._queue:
            newest.pop((arrival.key, arrival.source), None)
            newest[arrival.key, arrival.source] = arrival
        kept = list(newest.values())
        if 2 * len(kept) > self._most_entries or 2 * sum(len(a.payload) for a in kept) > self._most_bytes:
            half = len(kept) // 2
            kept = [a for a in kept[:half] if a.token is not None] + kept[half:]
        self.dropped += len(self._queue) - len(kept)
        self._queue = deque(kept)
        self._bytes = sum(len(arrival.payload) for arrival in kept)
        self._waiting = sum(map(self.is_coalesced, kept))


class DelayQueue:
    """What arrives over the links of one process, until its delay is over: then it enters the inbox, in the order in which it is due.

    What is due at one time enters in the order of arrival. Any thread may call it.
    """

    def __init__(self, link: LiveLink, inbox: Inbox) -> None:
        self._link, self._inbox = link, inbox
        self._lock = threading.Lock()
        self._held: list[tuple[float, int, Arrival]] = []  # a heap: due at, s; number of the copy
        self._number = 0
        self._called_for = math.inf  # s: no later than that the event loop calls `release`

    def add(self, arrival: Arrival, now: float) -> bool:
        """Take what arrives at `now` s. True: the event loop must be called, for the inbox or to set a timer to what is due sooner.

        A token is no message of a sender, so it is neither lost nor delayed.
        """
        with self._lock:
            for delay, payload in self._link.incoming(arrival.key, arrival.payload, now):
                self._number += 1
                heappush(self._held, (now + delay, self._number, arrival._replace(payload=payload)))
            is_called, due = self._enter(now), self._due()
            is_sooner = due < self._called_for
            self._called_for = min(due, self._called_for)
            return is_called or is_sooner

    def release(self, now: float) -> float:
        """Let what is due at `now` s into the inbox; the time in s at which the next one is due, infinite without any."""
        with self._lock:
            self._enter(now)
            self._called_for = self._due()
            return self._called_for

    def _enter(self, now: float) -> bool:
        """Whether the inbox calls for the event loop after what is due has entered."""
        is_called = False
        while self._due() <= now:
            is_called |= self._inbox.add(heappop(self._held)[2])
        return is_called

    def _due(self) -> float:
        return self._held[0][0] if self._held else math.inf


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
