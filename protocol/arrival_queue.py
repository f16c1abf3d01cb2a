"""What arrives at a live node and waits for its event loop: the queue between Zenoh's threads and the loop, and the delays of faulty links.

Data types: an `Arrival` is a payload under a key, or a token. Pure bookkeeping without sockets.
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


class ArrivalQueue:
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
        observations = [arrival for arrival in batch if OBSERVATION in arrival.key]
        if not observations or len(observations) + len(self._queue) <= most:
            return batch
        waiting = [arrival for arrival in self._queue if OBSERVATION in arrival.key]
        newer = Counter([(arrival.key, arrival.source) for arrival in (*observations, *waiting)])
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

    def __init__(self, link: LiveLink, inbox: ArrivalQueue) -> None:
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
