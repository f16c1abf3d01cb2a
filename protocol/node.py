"""The Node: a participant without clock, socket or global random numbers.

A driver (`live` or `virtual`) hands it one event at a time with its own monotonic time `now` in s. The driver carries out the returned
effects in order, and hands over a `Timer` after a `deadline()`, which may have moved meanwhile. The commonest effect is a message: it is
published under its key.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from protocol.cached_attribute import cached_attribute
from protocol.message import Message


@dataclass(frozen=True, slots=True)
class Started:
    """The driver is ready; the node's own liveliness token is declared."""


class Batch:
    """Messages of one kind that arrived together, in the order of arrival. A batch is immutable; derived values are computed once.

    In virtual time all listeners of the same messages share one batch. A sender that listens to its own kind may find its message in it.
    """

    def __init__(self, messages: Sequence[Message], payloads: Sequence[bytes] = ()) -> None:
        """`payloads`: the bytes on the wire, for recorders; empty for messages without any."""
        self.messages: tuple[Any, ...] = tuple(messages)  # all of `kind`
        self.payloads = tuple(payloads) or (b"",) * len(self.messages)

    def __len__(self) -> int:
        return len(self.messages)

    @property
    def kind(self) -> type[Message]:
        """The common type of the messages."""
        kind: type[Message] = type(self.messages[0])
        return kind

    @cached_attribute
    def senders(self) -> tuple[str, ...]:
        """The sender of each message."""
        return tuple([message.sender for message in self.messages])


@dataclass(frozen=True, slots=True)
class Received:
    """A batch of messages has arrived; keys, senders and contents are checked."""

    batch: Batch


def received(*messages: Message, payloads: Sequence[bytes] = ()) -> Received:
    """The event of these messages, all of one kind, as one batch."""
    return Received(Batch(messages, payloads))


def messages_of(event: object) -> tuple[Any, ...]:
    """The messages of a `Received`; none of any other event."""
    return event.batch.messages if isinstance(event, Received) else ()


@dataclass(frozen=True, slots=True)
class Rejected:
    """Bytes that are no valid message; `sender` is the last name in the key, `reason` one word for the counters.

    `key` and `payload` are those on the wire, for recorders.
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
    """A deadline of the node has passed, but an event in between may have moved it: the node looks at `now` itself."""


Event = Started | Received | Rejected | Alive | Gone | Timer


@dataclass(frozen=True, slots=True)
class Subscribe:
    """Deliver the messages with keys in `expression` from now on.

    For an expression of tokens (`keys.tokens_of`) deliver `Alive` and `Gone`, at first `Alive` for every token that is up. Only a node
    without `sees_all_tokens` subscribes to tokens.
    """

    expression: str


@dataclass(frozen=True, slots=True)
class Unsubscribe:
    """Undo one earlier `Subscribe` of the same expression."""

    expression: str


@dataclass(frozen=True, slots=True)
class Stop:
    """Leave the run with an exit code: 0 when done, 3 when a younger incarnation of the same name is alive."""

    code: int
    reason: str


@dataclass(frozen=True, slots=True)
class Reopen:
    """Leave the network and join it again: this node's session is half open.

    A driver may leave it out. In a simulation no session is ever half open, and with link faults made on purpose silence proves nothing.
    """

    reason: str


@dataclass(frozen=True, slots=True)
class Warn:
    """A warning to the user; it goes to the log."""

    text: str


Effect = Message | Subscribe | Unsubscribe | Stop | Reopen | Warn
NO_EFFECTS: list[Effect] = []  # this object as an answer: no effects, and an unchanged deadline; never modified


class Node(Protocol):
    """What a driver drives. A node inherits from this class, and thereby the default of each optional member."""

    run: str  # name of the run, the second part of every key
    role: str  # agent, world, body, recorder, monitor or operator
    name: str  # unique in the run
    incarnation: int  # grows with every restart under the same name
    coalesced_keys: str = ""  # part of the keys of messages of which `wake_up_count` wake the node together; empty: none
    sees_all_tokens: bool = True  # False: the driver shows only the liveliness tokens to which the node subscribes

    @property
    def most_observations(self) -> int:
        """How many observations may wait, those of each session by themselves; older ones are dropped. 0: all may wait."""
        return 0

    @property
    def wake_up_count(self) -> int:
        """The number of coalesced messages that wake the node."""
        return 1

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return the effects, in order."""

    def deadline(self) -> float | None:
        """The time of the next `Timer` event at the latest, in the time of `now`; None: none."""
