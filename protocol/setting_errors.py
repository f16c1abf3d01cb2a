"""All mistakes in the data of a settings file, not only the first one."""

import copy
import re
from typing import Any, get_args, get_type_hints

import msgspec

from protocol.settings import explain, fits, locate, part_of

MOST_MISTAKES = 50  # mistakes that are reported
SAMPLE_VALUES: tuple[Any, ...] = (1.0, 1, "x", False, {}, [])  # one of them replaces a missing or wrong value


def mistakes(data: dict[str, Any], into: type) -> tuple[list[str], list[list[str | int]], dict[str, Any]]:
    """The mistakes, a line each in the words of the file; their paths; and the data without them, valid for `into`."""
    found: list[str] = []
    paths: list[list[str | int]] = []
    rest = copy.deepcopy(data)
    for _ in range(10 * MOST_MISTAKES):
        try:
            msgspec.convert(rest, into)
            return found, paths, rest
        except msgspec.ValidationError as error:
            kind, path, hint = _mistake(str(error), rest, into)
            if not any(path[: len(known)] == known for known in paths):  # else it follows from a mistake that is reported
                found.append(explain(str(error), rest, into))
                paths.append(path)
            _mend(rest, kind, path, hint)
        if len(found) == MOST_MISTAKES:
            break
    return [*found, "and more"], paths, {}


def _mistake(text: str, data: dict[str, Any], into: type) -> tuple[str, list[str | int], Any]:
    """The kind of a mistake, the names that lead to it, and its type: an unknown field, a wrong key, a missing field, a wrong value."""
    complaint, _, where = text.partition(" - at ")
    path, value, hint = locate(data, into, where)
    unknown = re.search(r"unknown field `(.*)`", complaint)
    if unknown:
        return "unknown", [*path, unknown[1]], None
    if where.startswith("`key`"):
        return "key", [*path, str(value)], None
    missing = re.search(r"missing required field `(.*)`", complaint)
    if missing:
        return "missing", [*path, missing[1]], part_of(hint, missing[1])
    return "wrong", path, hint


def _mend(data: dict[str, Any], kind: str, path: list[str | int], hint: Any) -> None:
    """Remove the mistake; a required field gets some valid value."""
    holder: Any = data
    for step in path[:-1]:
        holder = holder[step]
    if kind != "missing" and isinstance(holder, dict):
        holder.pop(path[-1])
        return
    holder[path[-1]] = _valid_value(hint)


def _valid_value(hint: Any) -> Any:
    """A valid value of a type."""
    if hasattr(hint, "__struct_fields__"):
        hints = get_type_hints(hint, include_extras=True)
        return {field.encode_name: _valid_value(hints[field.name]) for field in msgspec.structs.fields(hint) if field.required}
    return next((copy.copy(value) for value in (*SAMPLE_VALUES, *get_args(hint)) if fits(value, hint)), None)
