"""From arrivals to the events of a node: tokens are noted, bytes decoded, senders of garbage excluded.

Pure bookkeeping without sockets. Both drivers use `in_batches`. The live driver also owns a `Reception`.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

from protocol.arrival_queue import Arrival
from protocol.codec import decode_all
from protocol.fields import Malformed
from protocol.liveliness_tokens import Tokens
from protocol.message import Message
from protocol.node import Batch, Event, Received, Rejected
from protocol.sender_limits import Quarantine


class Decoded(NamedTuple):
    """A checked message and its bytes on the wire."""

    message: Message
    payload: bytes


def read_all(arrived: Sequence[tuple[str, bytes]]) -> list[Decoded | Rejected]:
    """For each key and payload the decoded message, or the event that they are rejected; decoded together, which costs less."""
    return [
        Rejected(key.rpartition("/")[2], message.reason, key, payload) if isinstance(message, Malformed) else Decoded(message, payload)
        for (key, payload), message in zip(arrived, decode_all(arrived))
    ]


def in_batches(arrived: Iterable[Decoded | Event]) -> Iterator[Event]:
    """The events in the order of arrival; consecutive messages of one kind are one `Received`."""
    for kind, run in groupby(arrived, _kind):
        if kind is None:
            yield from run  # type: ignore[misc]  # these are events already
        else:
            messages, payloads = zip(*run)
            yield Received(Batch(messages, payloads))


def event_of(arrived: Decoded | Event) -> Event:
    """The event of one arrival."""
    return Received(Batch((arrived.message,), (arrived.payload,))) if isinstance(arrived, Decoded) else arrived


def _kind(arrived: Decoded | Event) -> type[Message] | None:
    """The type of a decoded message; None for an event."""
    return type(arrived.message) if isinstance(arrived, Decoded) else None


class Reception:
    """Reads the arrivals of one node. It keeps the driver's `counts` of received, rejected and quarantined messages."""

    def __init__(self, tokens: Tokens, counts: Counter[str]) -> None:
        self._tokens = tokens
        self._counts = counts
        self._quarantine = Quarantine()

    def events(self, arrivals: list[Arrival], now: float) -> Iterator[Event]:
        """The events in the order of arrival. Messages of a source in quarantine are discarded unread.

        A token is reported once when it appears and once when it vanishes, the own token never. `now` is the driver's, s.
        """
        return in_batches(self._read(arrivals, now))

    def _read(self, arrivals: list[Arrival], now: float) -> Iterator[Decoded | Event]:
        is_quarantined = self._quarantine.is_quarantined
        anybody = self._quarantine.is_any_quarantined(now)
        shut = [anybody and arrival.token is None and is_quarantined(arrival.source or arrival.key, now) for arrival in arrivals]
        unread = [(key, payload) for (key, payload, _, token), out in zip(arrivals, shut) if token is None and not out]
        items = iter(read_all(unread))
        for arrival, out in zip(arrivals, shut):
            if arrival.token is not None:
                yield from self._tokens.see(arrival.key, bool(arrival.token))
                continue
            item = None if out else next(items)
            if isinstance(item, Decoded):
                self._counts["received"] += 1
                yield from self._tokens.hear(item.message.sender)
                yield item
            elif item is None or is_quarantined(arrival.source or arrival.key, now):
                self._counts["quarantined"] += 1
                yield Rejected(arrival.key.rpartition("/")[2], "quarantine", arrival.key, arrival.payload)
            else:  # too much of it puts its source in quarantine
                self._counts["rejected"] += 1
                self._quarantine.offend(arrival.source or arrival.key, now)
                yield item
