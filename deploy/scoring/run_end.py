"""The end of a run, as an observer sees it.

After the last tick the world ends, or the bodies where there is no world. Then the agents are dismissed: one that leaves from there on has
not died.
"""

from protocol.node import Event, Gone
from protocol.observer_messages import Truth


def ends_run(event: Event, truth: Truth | None, ticks: int) -> bool:
    """Whether an event ends a run of so many ticks, of which `truth` is the newest that has been heard."""
    return isinstance(event, Gone) and event.role in ("world", "body") and truth is not None and truth.tick >= ticks - 1
