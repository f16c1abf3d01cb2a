"""What the virtual driver knows of a node that it drives, and messages on their way to their listeners."""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from protocol.keys import token_key
from protocol.messages import Beacon, Gossip, Hello, Observation
from protocol.node import Effect, Event, Node, Received
from protocol.once import once
from protocol.reception import Decoded, in_batches

Item = Decoded | Event  # what one message is to a listener: the message, or the event that it could not be read
TO_MANY = (Gossip, Beacon, Hello)  # kinds that wait in the boxes of their listeners until nothing else is left of the instant


class MessageRun:
    """Messages to the very same listeners, published one right after the other: read once for all of them."""

    def __init__(self, sender: "BusEndpoint", item: Item) -> None:
        self.senders = [sender]
        self.items = [item]

    @once
    def events(self) -> list[Event]:
        """All of it, the listener's own messages included."""
        return [*in_batches(self.items)]

    def without(self, seat: "BusEndpoint") -> list[Item]:
        """What the others have said."""
        return [item for sender, item in zip(self.senders, self.items) if sender is not seat]


@dataclass(slots=True)
class Delivery:
    """A message on its way to all its listeners."""

    listeners: "list[BusEndpoint]"
    sender: "BusEndpoint"
    item: Item

    @property
    def kind(self) -> type | None:
        """Of the message; None when it could not be read."""
        return type(self.item.message) if isinstance(self.item, Decoded) else None

    def with_followers(self, ready: deque[Any]) -> MessageRun:
        """This message and those next in the queue that are of its kind and go to the very same listeners; they leave the queue."""
        run = MessageRun(self.sender, self.item)
        while ready and isinstance(ready[0], Delivery) and ready[0].listeners is self.listeners and ready[0].kind is self.kind:
            following = ready.popleft()
            run.senders.append(following.sender)
            run.items.append(following.item)
        return run


@dataclass(eq=False, slots=True)
class BusEndpoint:
    """A node on the bus."""

    node: Node
    place: int  # in the order of coming
    expressions: Counter[str] = field(default_factory=Counter)
    timer: float | None = None
    paused: bool = False
    waiting: list[Event] = field(default_factory=list)  # what arrived while it was paused or at work
    clock: float = 0.0  # how far its clock is ahead, s
    work: float = 0.0  # how long it takes over an observation, s
    at_work: bool = False
    armed: float | None = None  # the deadline for which the timer is set
    box: list[MessageRun] = field(default_factory=list)  # what was said to many in this instant
    handle: Callable[[Event, float], list[Effect]] = field(init=False)  # those of the node, looked up once
    deadline: Callable[[], float | None] = field(init=False)

    def __post_init__(self) -> None:
        self.handle, self.deadline = self.node.handle, self.node.deadline

    @property
    def token(self) -> str:
        """Key of its liveliness token."""
        return token_key(self.node.run, self.node.role, self.node.name, self.node.incarnation)

    def empty_box(self) -> list[Event]:
        """The events of what lay in the box, in the order in which it came."""
        box, self.box = self.box, []
        if len(box) == 1 and len(box[0].items) > 1:
            return box[0].events
        return [*in_batches(item for run in box for item in run.without(self))]

    def catch_up(self) -> list[Event]:
        """What has waited for it; of observations the newest only: nobody works off a queue of them."""
        events, self.waiting = self.waiting, []
        newest = max((place for place, event in enumerate(events) if is_observation(event)), default=0)
        return [event for place, event in enumerate(events) if place >= newest or not is_observation(event)]


def is_observation(event: Event) -> bool:
    """Whether an event tells an agent where it is and what it sees."""
    return isinstance(event, Received) and event.batch.kind is Observation


def place_of(seat: BusEndpoint) -> int:
    """To sort by."""
    return seat.place
