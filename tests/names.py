"""The made-up names that an object keeps: x1, x2, ... and y1, y2, ..."""

import re
from collections import deque
from collections.abc import Mapping
from typing import Any

MADE_UP = re.compile(r"[xy]\d+")


def names_in(root: object, *rooms: str) -> set[str]:
    """The made-up names that can be reached from an object of these packages, but for what numpy, msgspec and memos keep."""
    found, seen, waiting = set[str](), set[int](), deque([root])
    while waiting:
        item = waiting.popleft()
        if isinstance(item, str):
            found |= {item} if MADE_UP.fullmatch(item) else set()
        elif id(item) not in seen:
            seen.add(id(item))
            waiting.extend(_parts_of(item, rooms))
    return found


def _parts_of(item: Any, rooms: tuple[str, ...]) -> list[object]:
    if isinstance(item, Mapping):
        return [*item.keys(), *item.values()]
    if isinstance(item, list | tuple | set | frozenset | deque):
        return [*item]
    if type(item).__module__.partition(".")[0] not in rooms:
        return []
    slots = [name for each in type(item).__mro__ for name in getattr(each, "__slots__", ())]
    return [*getattr(item, "__dict__", {}).values(), *(getattr(item, name, None) for name in slots)]
