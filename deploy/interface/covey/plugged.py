"""Sensors and controllers that a caller passes as objects, under names that a scenario can hold.

A class that others can import goes by its own name, `module:Class`. Any other class, and every object, is kept here under a name of
this module: it can be used in this process, and in no other.
"""

import sys
from collections.abc import Callable
from typing import Any

_KEPT: dict[str, Callable[..., Any]] = {}  # by the name that this module shows


def name_of(thing: object) -> str:
    """`module:Name` of a class or object; a text is such a name already."""
    if isinstance(thing, str):
        return thing
    if isinstance(thing, type) and _can_be_imported(thing):
        return f"{thing.__module__}:{thing.__name__}"
    kind = thing if isinstance(thing, type) else type(thing)
    name = f"{kind.__name__}_{len(_KEPT) + 1}"
    _KEPT[name] = thing if isinstance(thing, type) else lambda: thing
    return f"{__name__}:{name}"


def _can_be_imported(kind: type) -> bool:
    module = sys.modules.get(kind.__module__)
    return module is not None and vars(module).get(kind.__name__) is kind


def __getattr__(name: str) -> Callable[..., Any]:
    """What is kept under a name: called without arguments it gives the object."""
    if name not in _KEPT:
        raise AttributeError(f"{name} was passed to covey in another process; give it as module:Class")
    return _KEPT[name]
