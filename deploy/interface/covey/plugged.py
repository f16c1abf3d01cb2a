"""Sensors and controllers that a caller passes as objects, under names that a scenario can hold.

A class that others can import goes by its own name, `module:Class`. Any other class, and every object, is kept here under a name of
this module: it can be used in this process, and in no other. A sensor that is passed as an object serves all agents, because sensors
keep no state. Of a controller, which may remember, each agent gets a copy.
"""

import sys
from collections.abc import Callable
from copy import deepcopy
from typing import Any

from protocol.settings import BadSetting
from protocol.user_classes import shown

_KEPT: dict[str, Callable[..., Any]] = {}  # by the name that this module shows


def name_of_law(law: object) -> str:
    """`name_of` a controller; raises BadSetting for an object that cannot be copied."""
    if isinstance(law, str | type):
        return name_of(law)
    try:
        given = deepcopy(law)
    except Exception as error:  # whatever the parts of the object raise, as one that holds a lock or a file
        wrong = f"control = {shown(law)}: each agent gets a copy, and it cannot be copied ({type(error).__name__}: {error})"
        raise BadSetting(f"{wrong}; should be a class, or an object without that part") from error
    return _kept(type(law), lambda: deepcopy(given))


def name_of(thing: object) -> str:
    """`module:Name` of a class or object; a text is such a name already."""
    if isinstance(thing, str):
        return thing
    if isinstance(thing, type) and _can_be_imported(thing):
        return f"{thing.__module__}:{thing.__name__}"
    return _kept(thing, thing) if isinstance(thing, type) else _kept(type(thing), lambda: thing)


def _kept(kind: type, build: Callable[..., Any]) -> str:
    """The name under which `build` is kept; it tells the class."""
    name = f"{kind.__name__}_{len(_KEPT) + 1}"
    _KEPT[name] = build
    return f"{__name__}:{name}"


def _can_be_imported(kind: type) -> bool:
    module = sys.modules.get(kind.__module__)
    return module is not None and vars(module).get(kind.__name__) is kind


def __getattr__(name: str) -> Callable[..., Any]:
    """What is kept under a name: called without arguments it gives the object."""
    if name not in _KEPT:
        raise AttributeError(f"{name} was passed to covey in another process; give it as module:Class")
    return _KEPT[name]
