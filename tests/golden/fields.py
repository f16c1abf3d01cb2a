"""What the golden record holds of an agent's tick: the one place that knows the names of messages and of their fields.

A rename of a message or of its fields is followed here and moves no hash: values are hashed in the order of `FIELDS`, without names.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from protocol.message import Message
from protocol.messages import Command, Gossip
from protocol.observer_messages import Estimate

Values = list[Any]  # numbers, texts, arrays, or lists of them
RECORDED_AS = {  # counters renamed since the record
    "rejected.closed": "rejected.stale",
    "rejected.old_observation": "rejected.stale",
    "rejected.unknown_sensor": "rejected.stranger",
    "rejected.implausible": "rejected.bounds",
}


def counts(counters: Mapping[str, int]) -> list[list[Any]]:
    """The counters that are not 0, by the names of the record and in their order."""
    found: Counter[str] = Counter()
    for name, count in counters.items():
        found[RECORDED_AS.get(name, name)] += count
    return sorted([name, count] for name, count in found.items() if count)


FIELDS: dict[str, tuple[type[Message], Callable[[Any], Iterable[Any]]]] = {
    "pose": (Gossip, lambda said: (said.pose, said.cod, said.scanned, said.listening)),
    "scan": (Gossip, lambda said: (said.detections,)),
    "unused": (Gossip, lambda said: (said.unused, said.power_radius)),
    "claim": (Gossip, lambda said: (said.claim_tick, said.claim_names, said.claim)),
    "diagram_hash": (Gossip, lambda said: (said.diagram_hash,)),
    "ids": (Gossip, lambda said: (said.ids,)),
    "states": (Gossip, lambda said: (said.states,)),
    "weights": (Gossip, lambda said: (said.weight,)),
    "command": (Command, lambda said: (said.velocity, said.turn_rate)),
    "cell": (Estimate, lambda said: (said.cell, said.neighbours, said.diagram_hash)),
    "mass": (Estimate, lambda said: (said.mass, said.load, said.unused)),
    "estimates": (Estimate, lambda said: (said.targets,)),
    "counters": (Estimate, lambda said: (counts(said.counters),)),
}


def values_of(message: Message) -> dict[str, Values]:
    """The values of the fields that a message holds; other messages hold none."""
    return {name: list(read(message)) for name, (kind, read) in FIELDS.items() if isinstance(message, kind)}


def address_of(message: Message) -> tuple[int, str, int]:
    """Tick, sender and incarnation of a message that has fields."""
    return message.tick, message.sender, message.incarnation  # type: ignore[attr-defined]


def digest(values: object) -> bytes:
    """Eight bytes that change with any bit of any value; -0.0 counts as 0.0, and the precision of an array does not matter."""
    return hashlib.blake2b(_canonical(values), digest_size=8).digest()


def _canonical(value: object) -> bytes:
    """Bytes that tell all values apart."""
    if isinstance(value, np.ndarray):
        numbers = value.astype("<f8") + 0.0 if value.dtype.kind == "f" else value.astype("<u8")
        return repr(value.shape).encode() + numbers.tobytes()
    if isinstance(value, list | tuple):
        return b"(" + b",".join([_canonical(part) for part in value]) + b")"
    return (float.hex(value + 0.0) if isinstance(value, float) else repr(value)).encode()
