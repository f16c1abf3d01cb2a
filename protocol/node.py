"""The Node: a participant without clock, socket or global random numbers.

A driver (`live` or `virtual`) hands it one event at a time with its own monotonic time `now` in s, carries out the returned
effects in order, and calls again with `Timer` when `deadline()` has passed. A message is the commonest effect: it is published
under its key.
"""

from dataclasses import dataclass, field
from typing import Any, Protocol

import msgspec

from protocol.messages import Message


@dataclass(frozen=True, slots=True)
class Started:
    """The driver is ready; the node's own liveliness token is declared."""


class Received(msgspec.Struct, frozen=True):
    """A message of which key, sender and contents have been checked. `size` is its length on the wire in bytes, 0 if unknown.

    `payload` is what was on the wire, for recorders.
    """

    message: Message
    size: int = 0
    payload: bytes = b""


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
QUIET: list[Effect] = []  # this very object as an answer: nothing is to be done, and the deadline is what it was; never to be changed


@dataclass(eq=False, slots=True)
class Batch:
    """Messages that went to the same listeners, one right after the other in one instant, and who said each."""

    senders: list[object]
    events: list[Received]
    memo: dict[str, Any] = field(default_factory=dict)  # a place for what listeners derive from it, so that it is derived once

    def without(self, sender: object) -> list[Received]:
        """What somebody else has said."""
        return [event for other, event in zip(self.senders, self.events) if other is not sender]


class Node(Protocol):
    """What a driver drives."""

    @property
    def run(self) -> str:
        """Name of the run, the second part of every key."""

    @property
    def role(self) -> str:
        """agent, world, recorder or monitor."""

    @property
    def name(self) -> str:
        """Unique in the run."""

    @property
    def incarnation(self) -> int:
        """Grows with every restart under the same name."""

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to do, in order."""

    def deadline(self) -> float | None:
        """When to be called with `Timer` at the latest, in the time of `now`; None: not at all."""
