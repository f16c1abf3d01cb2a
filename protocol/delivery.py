"""The endpoints of the virtual bus, and the messages on their way to them.

A `BusEndpoint` is a node and the state that the bus keeps for it. A `Delivery` is one message, as bytes, and its receivers. A
`MessageGroup` is a sequence of messages of one kind to the same receivers, put into a batch once for all of them. Gossips,
beacons, Hellos and estimates wait in the mailboxes of their receivers until the instant holds no other event (`VirtualBus`).
"""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from protocol.cached_attribute import cached_attribute
from protocol.keys import token_key
from protocol.message import Message
from protocol.messages import Beacon, Gossip, Hello, Observation
from protocol.node import Effect, Event, Node, Received
from protocol.observer_messages import Estimate
from protocol.reception import Decoded, in_batches, read_all

Item = Decoded | Event  # a decoded message, or the event that the bytes were rejected
MAILBOX_KINDS = (Gossip, Beacon, Hello, Estimate)  # kinds that wait in the receivers' mailboxes until the instant holds no other event


class MessageGroup:
    """Consecutive messages of one kind to the same listeners, each with its sender; put into batches once for all listeners."""

    def __init__(self, listeners: "list[BusEndpoint]", said: "list[tuple[BusEndpoint, Item]]") -> None:
        self.listeners, self.said = listeners, said

    @cached_attribute
    def events(self) -> list[Event]:
        """The events of all messages, the listener's own messages included."""
        return [*in_batches([item for _, item in self.said])]


@dataclass(slots=True)
class Delivery:
    """A message on its way to all its listeners, as bytes under a key. `kind` is its type."""

    listeners: "list[BusEndpoint]"
    sender: "BusEndpoint"
    kind: type[Message]
    key: str
    payload: bytes

    def with_followers(self, ready: deque[Any], *, most: int | None = None) -> list[MessageGroup]:
        """This message and the next ones of its kind in the queue, `most` in all, decoded together; they leave the queue."""
        found = [self]
        while ready and isinstance(ready[0], Delivery) and ready[0].kind is self.kind and len(found) != most:
            found.append(ready.popleft())
        items = read_all([(delivery.key, delivery.payload) for delivery in found])
        groups: list[MessageGroup] = []
        for delivery, item in zip(found, items):
            if not groups or groups[-1].listeners is not delivery.listeners:
                groups.append(MessageGroup(delivery.listeners, []))
            groups[-1].said.append((delivery.sender, item))
        return groups


@dataclass(eq=False, slots=True)
class BusEndpoint:
    """A node on the bus, and what the bus keeps for it."""

    node: Node
    label: str
    number: int  # in the order in which nodes were added
    expressions: Counter[str] = field(default_factory=Counter)
    timer: float | None = None
    paused: bool = False
    waiting: list[Event] = field(default_factory=list)  # what arrived while it stood still or was at work
    unpublished: list[Effect] = field(default_factory=list)  # the effects of a round that it had computed, while it stands still
    clock: float = 0.0  # offset of its clock from the time of the bus, s
    work: Callable[[], float] | None = None  # draws the time that its next round takes, s; None: none
    published_after: float = 0.0  # share of that time after which the effects of the round come out
    at_work: bool = False
    armed: float | None = None  # the deadline for which the timer is set
    mailbox: list[MessageGroup] = field(default_factory=list)  # groups of messages of this instant that have not been handed over
    handle: Callable[[Event, float], list[Effect]] = field(init=False)  # the methods of the node, looked up once
    deadline: Callable[[], float | None] = field(init=False)

    def __post_init__(self) -> None:
        self.handle, self.deadline = self.node.handle, self.node.deadline

    @property
    def token(self) -> str:
        """Key of its liveliness token."""
        return token_key(self.node.run, self.node.role, self.node.name, self.node.incarnation)

    def empty_mailbox(self) -> list[Event]:
        """The events of the mailbox in the order of arrival, own messages among them; it is empty afterwards."""
        mailbox, self.mailbox = self.mailbox, []
        if len(mailbox) == 1:
            return mailbox[0].events
        return [*in_batches([item for group in mailbox for _, item in group.said])]

    def catch_up(self) -> list[Event]:
        """The events that waited, of observations as many as the node needs, the newest: a slow node skips ticks."""
        events, self.waiting = self.waiting, []
        most = self.node.most_observations
        if not most:
            return events
        observed = [row for row, event in enumerate(events) if isinstance(event, Received) and event.batch.kind is Observation]
        old = set(observed[:-most])
        return [event for row, event in enumerate(events) if row not in old]


def order_of_joining(endpoint: BusEndpoint) -> int:
    """Sort key: the order in which nodes were added to the bus."""
    return endpoint.number
