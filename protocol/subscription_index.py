"""The index of subscriptions: the listeners of a key, found in a time that does not grow with the number of other listeners."""

from bisect import bisect_left
from collections.abc import Callable
from typing import Generic, TypeVar

from protocol.keys import matches

T = TypeVar("T")


class SubscriptionIndex(Generic[T]):
    """Listeners by key expression; `order` sorts the listeners of one key. A listener is added to an expression once.

    Most expressions are a key, or a parent with one `*` behind it: these are looked up. The others are compared with every new key.
    """

    def __init__(self, order: Callable[[T], int]) -> None:
        self._order = order
        self._lists: dict[str, list[T]] = {}  # listeners by expression, in order; a list is replaced, never modified
        self._rare: set[str] = set()  # the expressions that are no key and no parent with one `*` behind it
        self._found: dict[str, list[T]] = {}  # results of `listeners` that still hold

    def add(self, expression: str, listener: T) -> None:
        """Add a listener to an expression."""
        listeners = self._lists.get(expression, [])
        at = bisect_left(listeners, self._order(listener), key=self._order)
        self._lists[expression] = [*listeners[:at], listener, *listeners[at:]]
        if "*" in expression.removesuffix("/*"):
            self._rare.add(expression)
        self._forget_found(expression)

    def remove(self, expression: str, listener: T) -> None:
        """Remove a listener from an expression."""
        self._lists[expression] = [other for other in self._lists[expression] if other != listener]
        if not self._lists[expression]:
            del self._lists[expression]
            self._rare.discard(expression)
        self._forget_found(expression)

    def _forget_found(self, expression: str) -> None:
        """Drop the results that a change of an expression may change: that of a key itself, or all."""
        if "*" in expression:
            self._found.clear()
        else:
            self._found.pop(expression, None)

    def listeners(self, key: str) -> list[T]:
        """The listeners of a key, in order; not to be modified. Keys that lie in the same single expression share a list."""
        known = self._found.get(key)
        if known is None:
            expressions = [key, key.rpartition("/")[0] + "/*", *(expression for expression in self._rare if matches(expression, key))]
            lists = [self._lists[expression] for expression in expressions if expression in self._lists]
            known = self._found[key] = lists[0] if len(lists) == 1 else sorted({one for some in lists for one in some}, key=self._order)
        return known
