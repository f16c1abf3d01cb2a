"""Bytes to messages and back: msgpack maps, checked for size, type, range and sender before a node receives them."""

import re
from collections.abc import Iterable

import msgspec

from protocol.compact_particles import unpacked
from protocol.fields import RESERVED, Malformed
from protocol.keys import NAME, RUN_WIDE_KINDS, Key, parse_message_key
from protocol.message import WIRE_VERSION, Message
from protocol.messages import KINDS, Beacon, Gossip, Hello, Observation, are_contents_valid

MAX_BYTES = 512 * 1024
OUT_OF_RANGE = re.compile(r"Expected `(int|float)` [<>]")  # how msgspec says that a number is outside its limits,
TOO_LONG = re.compile(r"Expected `(bytes|array)` of length <=")  # and that an array or a list is too long


class _Wire(msgspec.Struct):
    """The one field that every version of every message has."""

    wire: int


_encoder = msgspec.msgpack.Encoder()
_wire_decoder = msgspec.msgpack.Decoder(_Wire)
_decoders = {kind: msgspec.msgpack.Decoder(message_type) for kind, message_type in KINDS.items()}


def encode(message: Message) -> bytes:
    """The msgpack map of a message."""
    if isinstance(message, Gossip) and message.particles:
        message = msgspec.structs.replace(message, states_bytes=b"", ids_bytes=b"")
    return _encoder.encode(message)


def decode(key: str, payload: bytes) -> Message:
    """The message that arrived under `key`.

    Raises `Malformed` and nothing else: `reason` is one of key, size, format, version, shape, range, sender.
    """
    message = _parse(key, payload)
    message.check()
    return message


def decode_all(arrivals: Iterable[tuple[str, bytes]]) -> list[Message | Malformed]:
    """The result of `decode` for each key and payload: the message, or the `Malformed` that it raises.

    The contents of the arrays of all gossips are checked in one pass, which costs less.
    """
    found: list[Message | Malformed] = []
    gossips: list[Gossip] = []
    for key, payload in arrivals:
        try:
            message = _parse(key, payload)
            if type(message) is Gossip:
                message.check_lengths()
                gossips.append(message)
            else:
                message.check()
            found.append(message)
        except Malformed as error:
            found.append(error)
    return found if not gossips or are_contents_valid(gossips) else [_checked(message) for message in found]


def _checked(message: Message | Malformed) -> Message | Malformed:
    try:
        if isinstance(message, Gossip):
            message.check_contents()
    except Malformed as error:
        return error
    return message


def _parse(key: str, payload: bytes) -> Message:
    """The message under a key. Only its types, its version and its sender are checked."""
    parts = parse_message_key(key)
    if parts is None or parts.kind not in _decoders:
        raise Malformed("key", f"{key!r} is no key of a known message")
    if len(payload) > MAX_BYTES:
        raise Malformed("size", f"{len(payload)} bytes, at most {MAX_BYTES} are allowed")
    try:
        message = _decoders[parts.kind].decode(payload)
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError, UnicodeError) as error:
        _check_version(payload)
        raise Malformed(_reason(str(error)), f"{parts.kind}: {error}") from None
    if message.wire != WIRE_VERSION:
        raise Malformed("version", f"wire = {message.wire}: this software speaks version {WIRE_VERSION}")
    _check_name(parts, message)
    if isinstance(message, Gossip) and message.particles:
        _unpack(message)
    return message


def _reason(text: str) -> str:
    """The reason of `Malformed` for what msgspec says."""
    return "range" if OUT_OF_RANGE.match(text) else "size" if TOO_LONG.match(text) else "format"


def _unpack(gossip: Gossip) -> None:
    """Fill in the states and ids of a gossip that states its particles in few bytes. Raises Malformed."""
    if gossip.states_bytes or gossip.ids_bytes:
        raise Malformed("shape", "particles: states and ids should be empty beside them")
    states, ids = unpacked(gossip.particles, gossip.sender, gossip.tick - 1 - gossip.behind)
    msgspec.structs.force_setattr(gossip, "states_bytes", states.tobytes())
    msgspec.structs.force_setattr(gossip, "ids_bytes", ids.astype("<u8").tobytes())


def _check_version(payload: bytes) -> None:
    """Raise `Malformed` for a message of another version, the fields of which may differ; return for a broken message."""
    try:
        wire = _wire_decoder.decode(payload).wire
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError, UnicodeError):
        return
    if wire != WIRE_VERSION:
        raise Malformed("version", f"wire = {wire}: this software speaks version {WIRE_VERSION}")


def _check_name(parts: Key, message: Message) -> None:
    if isinstance(message, Beacon) and message.tile != parts.tile:
        raise Malformed("sender", f"tile = {message.tile}: was said in the tile {parts.tile}")
    named = message.recipient if isinstance(message, Observation) else message.sender
    if named != parts.name and parts.kind not in RUN_WIDE_KINDS:
        if not NAME.match(named):
            raise Malformed("format", f"{parts.kind}: {named[:64]!r} is no name")
        raise Malformed("sender", f"{named!r} speaks under the key of {parts.name!r}")
    if parts.name in RESERVED and (not isinstance(message, Hello) or message.role == "agent"):
        raise Malformed("format", f"{parts.kind}: {parts.name} is the name of no agent")
    if named == message.sender == parts.name:
        msgspec.structs.force_setattr(message, "sender", parts.name)  # one string object per sender makes look-ups faster
