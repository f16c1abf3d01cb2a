"""The Node: a participant without clock, socket or global random numbers.

A driver (`live` or `virtual`) hands it one event at a time with its own monotonic time `now` in s, carries out the returned
effects in order, and calls again with `Timer` when `deadline()` has passed. A message is the commonest effect: it is published
under its key.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from protocol.messages import Message
from protocol.once import once


@dataclass(frozen=True, slots=True)
class Started:
    """The driver is ready; the node's own liveliness token is declared."""


class Batch:
    """Messages of one kind that arrived together, in the order of arrival. It is never changed; what is derived from it is computed once.

    In virtual time all listeners of the same messages share one batch. A sender that listens to its own kind finds its message in it.
    """

    def __init__(self, messages: Sequence[Message], payloads: Sequence[bytes] = ()) -> None:
        """`payloads`: what was on the wire, for recorders; empty where nothing was."""
        self.messages: tuple[Any, ...] = tuple(messages)  # all of `kind`
        self.payloads = tuple(payloads) or (b"",) * len(self.messages)

    def __len__(self) -> int:
        return len(self.messages)

    @property
    def kind(self) -> type[Message]:
        """The common type of the messages."""
        kind: type[Message] = type(self.messages[0])
        return kind

    @once
    def senders(self) -> tuple[str, ...]:
        """The sender of each message."""
        return tuple([message.sender for message in self.messages])


@dataclass(frozen=True, slots=True)
class Received:
    """Messages have arrived of which keys, senders and contents have been checked."""

    batch: Batch


def received(*messages: Message, payloads: Sequence[bytes] = ()) -> Received:
    """The event that these messages of one kind have arrived together."""
    return Received(Batch(messages, payloads))


def messages_of(event: object) -> tuple[Any, ...]:
    """The messages of a `Received`; none of any other event."""
    return event.batch.messages if isinstance(event, Received) else ()


@dataclass(frozen=True, slots=True)
class Rejected:
    """Bytes that were no valid message; `sender` is the name in the key, `reason` one word for the counters.

    `key` and `payload` are what was on the wire, for recorders.
    """

    sender: str
    reason: str
    key: str = field(default="", compare=False)
    payload: bytes = field(default=b"", compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Alive:
    """A liveliness token appeared."""

    role: str
    name: str
    incarnation: int


@dataclass(frozen=True, slots=True)
class Gone:
    """A liveliness token vanished."""

    role: str
    name: str
    incarnation: int


@dataclass(frozen=True, slots=True)
class Timer:
    """The node's deadline has passed."""


Event = Started | Received | Rejected | Alive | Gone | Timer


@dataclass(frozen=True, slots=True)
class Subscribe:
    """From now on deliver messages whose key lies in `expression`; or `Alive` and `Gone` of the tokens that lie in it (`keys.tokens_of`),
    first of all those that are there. Only a node that does not see all tokens anyway asks for some."""

    expression: str


@dataclass(frozen=True, slots=True)
class Unsubscribe:
    """Undo one earlier `Subscribe` of the same expression."""

    expression: str


@dataclass(frozen=True, slots=True)
class Stop:
    """Leave the run: 0 when done, 3 when fenced off by a younger incarnation."""

    code: int
    reason: str


@dataclass(frozen=True, slots=True)
class Reopen:
    """Leave the network and join it anew: others hear somebody whom this node does not."""

    reason: str


@dataclass(frozen=True, slots=True)
class Warn:
    """Something that the user should know; it goes to the log."""

    text: str


Effect = Message | Subscribe | Unsubscribe | Stop | Reopen | Warn
NO_EFFECTS: list[Effect] = []  # this very object as an answer: nothing is to be done, and the deadline is what it was; never to be changed


class Node(Protocol):
    """What a driver drives. A node inherits from this class, and with it the defaults of what a driver may ask."""

    run: str  # name of the run, the second part of every key
    role: str  # agent, world, recorder or monitor
    name: str  # unique in the run
    incarnation: int  # grows with every restart under the same name
    patient: str = ""  # part of the keys of messages that may wait until `awaiting` of them have come; empty: none may
    newest_only: str = ""  # part of the keys of messages of which a driver hands over the newest alone when several wait
    sees_all_tokens: bool = True  # False: the driver shows only the liveliness tokens to which the node subscribes

    @property
    def awaiting(self) -> int:
        """How many patient messages shall wake the node."""
        return 1

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to do, in order."""

    def deadline(self) -> float | None:
        """When to be called with `Timer` at the latest, in the time of `now`; None: not at all."""
