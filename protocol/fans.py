"""Messages of the virtual driver on their way to all their listeners: each by itself, or those that go the same way together."""

from collections import deque
from dataclasses import dataclass
from typing import Any

from protocol.messages import Beacon, Gossip, Hello
from protocol.node import Batch, Event, Received
from protocol.seats import Seat

BOXED = (Gossip, Beacon, Hello)  # said to many; a listener takes all of them that have come in an instant together
ALIKE = (Gossip, Hello)  # and of these, those that go the same way one right after the other


@dataclass(slots=True)
class Fan:
    """A message on its way to all its listeners."""

    listeners: list[Seat]
    sender: Seat
    event: Event

    @property
    def is_boxed(self) -> bool:
        """Whether it waits in the boxes of its listeners until nothing else is left of its instant."""
        return isinstance(self.event, Received) and isinstance(self.event.message, BOXED)

    def gather(self, ready: deque[Any]) -> Batch | None:
        """This and what comes next, is alike and goes to the very same listeners, no longer `ready` then; None: there is no such thing."""
        if not self._leads(ready):
            return None
        assert isinstance(self.event, Received)
        batch = Batch([self.sender], [self.event])
        while self._leads(ready):
            following = ready.popleft()
            assert isinstance(following, Fan) and isinstance(following.event, Received)
            batch.senders.append(following.sender)
            batch.events.append(following.event)
        return batch

    def _leads(self, ready: deque[Any]) -> bool:
        """Whether a message of this kind to the same listeners is next."""
        following = ready[0] if ready else None
        if not isinstance(following, Fan) or following.listeners is not self.listeners:
            return False
        one, other = self.event, following.event
        if not isinstance(one, Received) or not isinstance(other, Received) or type(one.message) is not type(other.message):
            return False
        return isinstance(one.message, ALIKE)
