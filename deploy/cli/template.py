"""A scenario file with every section and every setting and its default, made from the types of the settings.

The purpose of a setting is the comment beside its declaration. The allowed values follow from its type.
"""

import inspect
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
from msgspec.inspect import DictType, Field, FloatType, IntType, LiteralType, StructType, Type, UnionType, VarTupleType, type_info

from deploy.scenario import Scenario, toml_value

COMMENT = re.compile(r"^    (\w+): .*?  # (.*)$", re.MULTILINE)
HEAD = """\
# A scenario of Covey: every section and every setting, each with its default.
# Take the "# " away from a setting to change it; what is left out stays at its default. `covey check` tells what is wrong.
"""
FIRST = ("run", "arena", "team", "targets")  # what is changed most
COLUMN = 40  # where comments begin


class SettingRow(NamedTuple):
    """One setting: its name, its default as TOML, its purpose and the allowed values."""

    name: str
    default: str
    note: str


class SectionRows(NamedTuple):
    """One section: its heading as TOML, its purpose, its settings."""

    heading: str
    purpose: str
    rows: tuple[SettingRow, ...]


def template() -> str:
    """The text of the file."""
    return "\n".join([HEAD, *("\n".join(_lines(section)) + "\n" for section in sections())])


def sections() -> list[SectionRows]:
    """All sections of a scenario; first those that are changed most."""
    notes = _notes(Scenario)
    ordered = sorted(_fields(Scenario), key=lambda field: FIRST.index(field.name) if field.name in FIRST else len(FIRST))
    return [_section(field, notes.get(field.name, "")) for field in ordered]


def dotted_names() -> list[str]:
    """All settings with one place, such as run.seed."""
    sections = [(field.name, field.type) for field in _fields(Scenario)]
    return [f"{name}.{inner.name}" for name, kind in sections if isinstance(kind, StructType) for inner in _fields(kind.cls)]


def _section(field: Field, note: str) -> SectionRows:
    kind = field.type
    if isinstance(kind, StructType):
        return SectionRows(f"[{field.name}]", _purpose(kind.cls), _rows(kind.cls))
    if isinstance(kind, DictType) and isinstance(kind.value_type, StructType):
        return SectionRows(f"[{field.name}.NAME]", _purpose(kind.value_type.cls), _rows(kind.value_type.cls))
    if isinstance(kind, VarTupleType) and isinstance(kind.item_type, StructType):
        return SectionRows(f"[[{field.name}]]", _purpose(kind.item_type.cls), _rows(kind.item_type.cls))
    return SectionRows(f"[{field.name}]", note, ())


def _rows(section: type) -> tuple[SettingRow, ...]:
    notes = _notes(section)
    known = {field.name: [part for part in (notes.get(field.name, ""), allowed(field.type)) if part] for field in _fields(section)}
    return tuple(SettingRow(field.name, _default(field), "; ".join(known[field.name])) for field in _fields(section))


def _lines(section: SectionRows) -> Iterator[str]:
    """The lines of one section; one that holds names of the user's, or nothing, is a comment."""
    single = section.rows and "NAME" not in section.heading and not section.heading.startswith("[[")
    yield _with(section.heading if single else f"# {section.heading}", section.purpose)
    for row in section.rows:
        yield _with(f"# {row.name} = {row.default}", row.note)


def _default(field: Field) -> str:
    """The default as TOML; without a default, the kind of value in angle brackets."""
    value = (
        field.default_factory() if field.default is msgspec.NODEFAULT and field.default_factory is not msgspec.NODEFAULT else field.default
    )
    if value is None or value is msgspec.NODEFAULT:
        return f"<{plain(field.type)}>"
    return toml_value(value)


def plain(kind: Type) -> str:
    """A type in one plain word."""
    if isinstance(kind, UnionType):
        return plain(next(part for part in kind.types if not isinstance(part, msgspec.inspect.NoneType)))
    words: list[tuple[type[Any], str]] = [(IntType, "whole number"), (FloatType, "number"), (DictType, "table")]
    return next((word for known, word in words if isinstance(kind, known)), "text")


def allowed(kind: Type) -> str:
    """Which values are right, where not all are: `one of power, voronoi`, `0 to 1`, `> 0`."""
    if isinstance(kind, UnionType):
        return allowed(next(part for part in kind.types if not isinstance(part, msgspec.inspect.NoneType)))
    if isinstance(kind, LiteralType):
        return f"one of {', '.join(map(str, kind.values))}"
    if not isinstance(kind, IntType | FloatType):
        return ""
    signs = {">": kind.gt, ">=": kind.ge, "<": kind.lt, "<=": kind.le}
    return ", ".join(f"{sign} {limit if isinstance(limit, int) else f'{limit:g}'}" for sign, limit in signs.items() if limit is not None)


def _fields(struct: type) -> tuple[Field, ...]:
    kind = type_info(struct)
    assert isinstance(kind, StructType)
    return kind.fields


def _purpose(section: type) -> str:
    """The first line of a section's docstring, without the name that it begins with."""
    return re.sub(r"^\[.*?\]+ ", "", (section.__doc__ or "").strip().splitlines()[0]).rstrip(".")


def _notes(struct: type) -> dict[str, str]:
    """The comments beside the declarations of a struct and of its bases."""
    found: dict[str, str] = {}
    for part in reversed(struct.__mro__):
        if issubclass(part, msgspec.Struct) and part.__module__.split(".")[0] != "msgspec":
            found |= dict(COMMENT.findall(inspect.getsource(part)))
    return found


def _with(line: str, comment: str) -> str:
    return f"{line:<{COLUMN}}  # {comment}" if comment else line
