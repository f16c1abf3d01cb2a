"""Bytes to messages and back: msgpack maps, checked for size, type, range and sender before anyone sees them."""

import msgspec

from protocol.fields import Malformed
from protocol.keys import Key, parse_message_key
from protocol.messages import KINDS, WIRE_VERSION, Beacon, Message, Observation

MAX_BYTES = 512 * 1024


class _Wire(msgspec.Struct):
    """The one field that every version of every message has."""

    wire: int


_encoder = msgspec.msgpack.Encoder()
_wire_decoder = msgspec.msgpack.Decoder(_Wire)
_decoders = {kind: msgspec.msgpack.Decoder(message_type) for kind, message_type in KINDS.items()}


def encode(message: Message) -> bytes:
    """The msgpack map of a message."""
    return _encoder.encode(message)


def decode(key: str, payload: bytes) -> Message:
    """The message that arrived under `key`.

    Raises `Malformed` and nothing else: `reason` is one of key, size, format, version, shape, range, sender.
    """
    parts = parse_message_key(key)
    if parts is None or parts.kind not in _decoders:
        raise Malformed("key", f"{key!r} is no key of a known message")
    if len(payload) > MAX_BYTES:
        raise Malformed("size", f"{len(payload)} bytes, at most {MAX_BYTES} are allowed")
    try:
        message = _decoders[parts.kind].decode(payload)
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError, UnicodeError) as error:
        _check_version(payload)
        raise Malformed("format", f"{parts.kind}: {error}") from None
    if message.wire != WIRE_VERSION:
        raise Malformed("version", f"wire = {message.wire}: this software speaks version {WIRE_VERSION}")
    _check_name(parts, message)
    message.check()
    return message


def _check_version(payload: bytes) -> None:
    """Tell a message of another version, whose fields may differ, from a broken one."""
    try:
        wire = _wire_decoder.decode(payload).wire
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError, UnicodeError):
        return
    if wire != WIRE_VERSION:
        raise Malformed("version", f"wire = {wire}: this software speaks version {WIRE_VERSION}")


def _check_name(parts: Key, message: Message) -> None:
    named = message.recipient if isinstance(message, Observation) else message.sender
    if isinstance(message, Beacon) and message.tile != parts.tile:
        raise Malformed("sender", f"tile = {message.tile}: was said in the tile {parts.tile}")
    if parts.kind != "truth" and named != parts.name:
        raise Malformed("sender", f"{named!r} speaks under the key of {parts.name!r}")
