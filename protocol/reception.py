"""From what has arrived to the events of a node: tokens are noted, bytes decoded, senders of garbage shut out.

Pure bookkeeping without sockets; `live` owns one.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from itertools import groupby

from protocol.codec import decode_all
from protocol.fields import Malformed
from protocol.inbox import Arrival, Quarantine
from protocol.node import Event, Received, Rejected
from protocol.tokens import Tokens

Whole = tuple[tuple[str, ...], tuple[bytes, ...]]  # keys and payloads


class Reception:
    """Reads what comes to one node; `counts` are the driver's, of which received, rejected and quarantined are kept here."""

    def __init__(self, tokens: Tokens, counts: Counter[str]) -> None:
        self._tokens = tokens
        self._counts = counts
        self._quarantine = Quarantine()

    def parts(self, arrivals: list[Arrival], waits: Callable[[Arrival], bool], now: float) -> Iterator[tuple[list[Arrival], Whole | None]]:
        """The arrivals in parts, in their order: what `waits` apart from the rest, and of that the keys and payloads if it may be read
        together, because nobody's messages have to be thrown away. `now` is the driver's, s."""
        for alike, group in groupby(arrivals, waits):
            part = list(group)
            keys, payloads, _, _ = zip(*part)
            yield part, (keys, payloads) if alike and not self._quarantine.holds_any(now) else None

    def events(self, arrivals: list[Arrival], now: float) -> Iterator[Event]:
        """The events in the order of arrival; what comes from a source that is shut out is thrown away unread.

        A token is reported once when it appears and once when it vanishes, the own one never. `now` is the driver's, s.
        """
        holds = self._quarantine.holds
        anybody = self._quarantine.holds_any(now)
        shut = [anybody and arrival.token is None and holds(arrival.source or arrival.key, now) for arrival in arrivals]
        unread = [(key, payload) for (key, payload, _, token), out in zip(arrivals, shut) if token is None and not out]
        messages = iter(decode_all(unread))
        for arrival, out in zip(arrivals, shut):
            if arrival.token is not None:
                seen = self._tokens.see(arrival.key, bool(arrival.token))
                if seen is not None:
                    yield seen
                continue
            message = None if out else next(messages)
            if message is None or isinstance(message, Malformed):
                yield self._refuse(arrival, message, now)
            else:
                self._counts["received"] += 1
                yield Received(message, len(arrival.payload), arrival.payload)

    def _refuse(self, arrival: Arrival, error: Malformed | None, now: float) -> Rejected:
        """Count what was no message, or was not read; who sends too much of it is shut out."""
        source = arrival.source or arrival.key
        if error is None or self._quarantine.holds(source, now):
            self._counts["quarantined"] += 1
            reason = "quarantine"
        else:
            self._counts["rejected"] += 1
            self._quarantine.offend(source, now)
            reason = error.reason
        return Rejected(arrival.key.rpartition("/")[2], reason, arrival.key, arrival.payload)
