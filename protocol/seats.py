"""What the virtual driver knows of a node that it drives."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from protocol.keys import token_key
from protocol.messages import Message, Observation
from protocol.node import Effect, Event, Node, Received
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
    box: list[Received] = field(default_factory=list)  # what was said to many in this instant, taken together
    handle: Callable[[Event, float], list[Effect]] = field(init=False)  # those of the node, looked up once
    deadline: Callable[[], float | None] = field(init=False)
    take_all: Callable[[list[Message], float], list[Effect]] | None = field(init=False)
    sees_all: bool = field(init=False)  # every token, not only those that it asks for

    def __post_init__(self) -> None:
        self.handle, self.deadline = self.node.handle, self.node.deadline
        self.take_all, self.sees_all = getattr(self.node, "take_all", None), sees_all_tokens(self.node)

    @property
    def token(self) -> str:
        """Key of its liveliness token."""
        return token_key(self.node.run, self.node.role, self.node.name, self.node.incarnation)

    def can_take(self) -> bool:
        """Whether it takes what comes at once, and its clock shows the time."""
        return not (self.paused or self.at_work or self.clock)

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
