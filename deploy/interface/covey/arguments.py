"""Arguments of the public functions: all are checked against their annotations, and numbers of numpy are taken as plain ones.

A wrong argument raises `BadSetting`, a line with the argument's name, its value and what would be right.
"""

import types
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from protocol.settings import BadOption, BadSetting
from protocol.user_classes import shown

P = ParamSpec("P")
T = TypeVar("T")
WORDS: dict[object, tuple[str, str]] = {  # one, and several
    str: ("a text", "texts"),
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    bool: ("True or False", "truth values"),
    type: ("a class", "classes"),
    Path: ("a path", "paths"),
    Mapping: ("a dict with texts as keys", "dicts"),
    Callable: ("a function", "functions"),
}


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """The function, which raises BadSetting for an argument that does not fit its annotation, and for a wrong option that it stands for."""
    taken = signature(function)

    @wraps(function)
    def call(*given: P.args, **named: P.kwargs) -> T:
        try:
            bound, hints = taken.bind(*given, **named), get_type_hints(function)
        except TypeError as error:
            raise TypeError(f"{function.__name__}() {error}") from None
        for name, value in bound.arguments.items():
            bound.arguments[name] = plain = _plain(value)
            if not _fits(plain, hints[name]):
                raise BadSetting(f"{name} = {shown(value)}: should be {_words(hints[name])}")
        try:
            return function(*bound.args, **bound.kwargs)
        except BadOption as error:
            raise BadSetting(f"{error.option} = {error.value!r}: {error.right}") from None

    return call


def _plain(value: Any) -> Any:
    """A value with Python's own numbers and lists in place of those of numpy; an object of any other class stays as it is."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if type(value) is dict:
        return {key: _plain(item) for key, item in value.items()}
    return type(value)(map(_plain, value)) if type(value) in (list, tuple) else value


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of an annotated type."""
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
        return any(_fits(value, part) for part in parts)
    if kind is Literal:
        return value in parts
    if kind is Sequence:
        return isinstance(value, Sequence) and not isinstance(value, str | bytes) and all(_fits(item, parts[0]) for item in value)
    if kind is Mapping:
        return isinstance(value, Mapping) and all(isinstance(key, str) for key in value)
    if kind in (int, float):
        return isinstance(value, int | kind) and not isinstance(value, bool)
    return kind is Any or isinstance(value, kind)


def _words(hint: Any, number: int = 0) -> str:
    """An annotated type in words; `number` 1: several of them."""
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
        return " or ".join(_words(part, number) for part in parts if part is not types.NoneType)
    if kind is Literal:
        return f"one of {', '.join(map(str, parts))}"
    if kind is Sequence:
        return f"a list of {_words(parts[0], 1)}"
    return WORDS[kind][number] if kind in WORDS else f"a {kind.__name__}"
