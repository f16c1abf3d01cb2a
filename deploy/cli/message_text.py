"""Messages as text: JSON lines for programs, blocks for people."""

from typing import Any

import msgspec
import numpy as np

from deploy.cli.listener import KeyedPayload
from protocol.codec import decode
from protocol.fields import Malformed
from protocol.message import Message

LONGEST_TEXT = 64  # characters of a text in a terminal


def fields(message: Message) -> dict[str, Any]:
    """A message for people: its fields by name, arrays as lists of rows, bytes that are no array in hexadecimal."""
    found: dict[str, Any] = {"type": type(message).__struct_config__.tag}
    for name in message.__struct_fields__:
        attribute = name.removesuffix("_bytes")
        value = getattr(message, attribute if hasattr(message, attribute) else name)  # `label_numbers` have no attribute that reads them
        found[attribute] = _plain(value)
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex()
    if not isinstance(value, np.ndarray):
        return msgspec.to_builtins(value)
    rows = value.tolist()
    return rows if value.dtype.names is None else [[_plain(item) for item in row] for row in rows]  # a component holds an array itself


def plain_line(heard: KeyedPayload) -> str:
    """One line of JSON: the key with the message, or with the raw bytes, the reason why they do not decode, and in words `why`."""
    if heard.message is not None:
        return msgspec.json.encode({"key": heard.key, **fields(heard.message)}).decode()
    raw: dict[str, Any] = {"key": heard.key, "unknown": heard.reason, "why": _why(heard)}
    raw |= {"bytes": len(heard.payload), "raw": heard.payload[:256].hex()}
    try:
        raw["msgpack"] = msgspec.to_builtins(msgspec.msgpack.decode(heard.payload), builtin_types=(bytes,), str_keys=True)
        return msgspec.json.encode(raw).decode()
    except (msgspec.MsgspecError, ValueError, TypeError, RecursionError, UnicodeError):
        raw.pop("msgpack", None)
        return msgspec.json.encode(raw).decode()


def block(heard: KeyedPayload, most: int = 6) -> str:
    """Several lines for a terminal: the key, then field by field, long arrays by their first rows."""
    if heard.message is None:
        lines = [heard.key, f"  {heard.reason}: {_why(heard)}", f"  {len(heard.payload)} bytes: {heard.payload[:64].hex(' ')}"]
    else:
        lines = [heard.key, *(f"  {name:14} {_short(value, most)}" for name, value in fields(heard.message).items())]
    return "\n".join(map(printable, lines))


def _why(heard: KeyedPayload) -> str:
    """The broken rule, with the name of the field; empty for a good message, of a sender in quarantine."""
    try:
        decode(heard.key, heard.payload)
    except Malformed as error:
        return str(error)
    return ""


def printable(line: str) -> str:
    """A line with its control characters as escapes: anybody may publish texts and keys, and a terminal would obey them."""
    return line if line.isprintable() else repr(line)[1:-1]


def _short(value: Any, most: int) -> str:
    if isinstance(value, list | tuple) and len(value) > most:
        return f"{len(value)} rows: {', '.join(_short(item, most) for item in value[:most])}, ..."
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_short(item, most) for item in value) + "]"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str) and len(value) > LONGEST_TEXT:  # bytes that are no array: one or six for each particle
        return f"{value[:LONGEST_TEXT]}... ({len(value)} characters)"
    return str(value)
