"""What the processes of a run must agree on: a short hash of every section of settings on which the rounds of others depend.

An agent that filters with other settings computes another PHD, and the cells of all are no longer parts of one. Every Hello says the
hash of each section, so that a difference is named; every Beacon says one hash of them all.
"""

import hashlib
from collections.abc import Mapping
from typing import Any

import msgspec

from protocol.settings import Common

Agreed = dict[str, int]  # the section and the hash of what it says


def section_hash(contents: Any) -> int:
    """32 bits of the BLAKE2b hash of a section as JSON, its fields in alphabetical order and without spaces."""
    return int.from_bytes(hashlib.blake2b(msgspec.json.encode(contents, order="sorted"), digest_size=4).digest(), "little")


def common_sections(config: Common) -> dict[str, Any]:
    """The sections that world and agents must agree on; of the sensors those that announce themselves by their class alone."""
    models = {f"sensors.{name}": sensor for name, sensor in config.sensors.items() if sensor.model != "wedge"}
    return {"run": {"dt": config.run.dt}, "arena": config.arena, "detection": config.detection, "limits": config.limits, **models}


def agreed(sections: Mapping[str, Any]) -> Agreed:
    """The hash of each section."""
    return {name: section_hash(contents) for name, contents in sections.items()}


def whole(hashes: Agreed) -> int:
    """One number below 2^63 for all of them, never 0."""
    return int.from_bytes(hashlib.blake2b(msgspec.json.encode(hashes, order="sorted"), digest_size=8).digest(), "little") >> 1 | 1


def disagreement(mine: Agreed, theirs: Mapping[str, int]) -> tuple[str, ...]:
    """The sections of which both say something, and not the same."""
    return tuple(sorted(name for name, number in mine.items() if theirs.get(name, number) != number))
