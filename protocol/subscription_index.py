"""The index of subscriptions: the listeners of a key, found in a time that does not grow with the number of other listeners."""

from bisect import bisect_left
from collections.abc import Callable
from typing import Generic, TypeVar

from protocol.keys import matches

T = TypeVar("T")


class SubscriptionIndex(Generic[T]):
    """Listeners by key expression; `order` sorts the listeners of one key.

    Most expressions are a key, or a parent with one `*` behind it: these are looked up. The others are compared with every new key.
    """

    def __init__(self, order: Callable[[T], int]) -> None:
        self._order = order
        self._exact: dict[str, dict[T, None]] = {}  # by key
        self._below: dict[str, dict[T, None]] = {}  # by parent
        self._in_order: dict[str, list[T]] = {}  # listeners below a parent, in order; a list is replaced, never modified
        self._other: dict[str, dict[T, None]] = {}  # by expression
        self._found: dict[str, dict[str, list[T]]] = {}  # results of earlier look-ups, by parent and key

    def add(self, expression: str, listener: T) -> None:
        """Add a listener to an expression."""
        table, place = self._table(expression)
        table.setdefault(place, {})[listener] = None
        if table is self._below:
            self._in_order[place] = self._with(self._in_order.get(place, []), listener)
        known = self._looked_up(table, place)
        if known is None:
            self._forget(table, place)
        else:
            known[place] = self._with(known[place], listener)

    def remove(self, expression: str, listener: T) -> None:
        """Remove a listener from an expression."""
        table, place = self._table(expression)
        del table[place][listener]
        if not table[place]:
            del table[place]
        if table is self._below:
            self._in_order[place] = self._without(self._in_order[place], listener)
            if not self._in_order[place]:
                del self._in_order[place]
        known = self._looked_up(table, place)
        if known is None or listener in self._below.get(place.rpartition("/")[0], {}):
            self._forget(table, place)
        else:
            known[place] = self._without(known[place], listener)

    def _with(self, listeners: list[T], listener: T) -> list[T]:
        at = bisect_left(listeners, self._order(listener), key=self._order)
        return listeners if listeners[at : at + 1] == [listener] else [*listeners[:at], listener, *listeners[at:]]

    def _without(self, listeners: list[T], listener: T) -> list[T]:
        at = bisect_left(listeners, self._order(listener), key=self._order)
        return [*listeners[:at], *listeners[at + 1 :]]

    def listeners(self, key: str) -> list[T]:
        """The listeners of a key, in order; not to be modified."""
        parent = key.rpartition("/")[0]
        if not self._other and key not in self._exact:
            return self._in_order.get(parent, [])
        known = self._found.setdefault(parent, {})
        listeners = known.get(key)
        if listeners is None:
            groups = [self._exact.get(key, {}), self._below.get(parent, {})]
            groups += [group for expression, group in self._other.items() if matches(expression, key)]
            listeners = known[key] = sorted({listener for group in groups for listener in group}, key=self._order)
        return listeners

    def _table(self, expression: str) -> tuple[dict[str, dict[T, None]], str]:
        if "*" not in expression:
            return self._exact, expression
        parent, _, last = expression.rpartition("/")
        return (self._below, parent) if last == "*" and "*" not in parent else (self._other, expression)

    def _looked_up(self, table: dict[str, dict[T, None]], place: str) -> dict[str, list[T]] | None:
        """The table that holds the known listeners of a key, of which one is to change; None: they must be looked up again."""
        known = self._found.get(place.rpartition("/")[0], {}) if table is self._exact and not self._other else {}
        return known if place in known else None

    def _forget(self, table: dict[str, dict[T, None]], place: str) -> None:
        if table is self._other:
            self._found.clear()
        elif table is self._below:
            self._found.pop(place, None)
        else:
            self._found.get(place.rpartition("/")[0], {}).pop(place, None)
