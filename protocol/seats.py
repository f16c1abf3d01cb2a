"""What the virtual driver knows of a node that it drives."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from protocol.keys import token_key
from protocol.messages import Message, Observation
from protocol.node import Batch, Effect, Event, Node, Received
from protocol.tokens import sees_all_tokens


@dataclass(eq=False, slots=True)
class Seat:
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
    box: list[Received | Batch] = field(default_factory=list)  # what was said to many in this instant, taken together
    has_batches: bool = False  # in the box
    handle: Callable[[Event, float], list[Effect]] = field(init=False)  # those of the node, looked up once
    deadline: Callable[[], float | None] = field(init=False)
    take_all: Callable[[list[Message], float], list[Effect]] | None = field(init=False)
    hear_together: Callable[[Batch, float], list[Effect] | None] | None = field(init=False)
    sees_all: bool = field(init=False)  # every token, not only those that it asks for

    def __post_init__(self) -> None:
        self.handle, self.deadline = self.node.handle, self.node.deadline
        self.take_all, self.hear_together = getattr(self.node, "take_all", None), getattr(self.node, "hear_together", None)
        self.sees_all = sees_all_tokens(self.node)

    @property
    def token(self) -> str:
        """Key of its liveliness token."""
        return token_key(self.node.run, self.node.role, self.node.name, self.node.incarnation)

    def can_take(self) -> bool:
        """Whether it takes what comes at once, and its clock shows the time."""
        return not (self.paused or self.at_work or self.clock)

    def take(self, part: list[Received] | Batch, now: float) -> list[Effect]:
        """Let the node take at once what it has `take_all` for."""
        if isinstance(part, Batch):
            effects = self.hear_together(part, now) if self.hear_together is not None else None
            if effects is not None:
                return effects
            part = part.without(self)
        assert self.take_all is not None
        return self.take_all([event.message for event in part], now)

    def put(self, batch: Batch) -> None:
        """Into the box."""
        self.box.append(batch)
        self.has_batches = True

    def empty_box(self) -> list[list[Received] | Batch]:
        """What lay in the box, in the order in which it came: batches, and between them single messages end to end."""
        box, self.box = self.box, []
        if not self.has_batches:
            return [box] if box else []  # type: ignore[list-item]
        self.has_batches = False
        parts: list[list[Received] | Batch] = []
        for thing in box:
            if isinstance(thing, Batch):
                parts.append(thing)
            elif parts and isinstance(parts[-1], list):
                parts[-1].append(thing)
            else:
                parts.append([thing])
        return parts

    def catch_up(self) -> list[Event]:
        """What has waited for it; of observations the newest only, for nobody works off a queue of them."""
        events, self.waiting = self.waiting, []
        newest = max((place for place, event in enumerate(events) if is_observation(event)), default=0)
        return [event for place, event in enumerate(events) if place >= newest or not is_observation(event)]


def is_observation(event: Event) -> bool:
    """Whether somebody is told where he is and what he sees."""
    return isinstance(event, Received) and isinstance(event.message, Observation)


def place_of(seat: Seat) -> int:
    """To sort by."""
    return seat.place
