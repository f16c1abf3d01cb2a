"""The settings on which all processes of a run must agree.

An agent with other filter settings computes another PHD, and the cells of the swarm are no longer parts of one PHD. Every Hello
carries these values, so a receiver can name each difference. Every Beacon carries one hash of all of them.
"""

import hashlib
from collections.abc import Mapping
from typing import Any

import msgspec

from protocol.message import Setting, SharedSettings
from protocol.settings import CommonSettings


def common_sections(config: CommonSettings) -> dict[str, Any]:
    """The sections on which world and agents must agree, and the sensors that a message announces by their class alone."""
    models = {
        f"sensors.{name}": {"model": sensor.model, "parameters": sensor.parameters}
        for name, sensor in config.sensors.items()
        if sensor.model != "wedge"
    }
    return {"run": {"dt": config.run.dt}, "arena": config.arena, "detection": config.detection, "limits": config.limits, **models}


def shared_settings(sections: Mapping[str, Any]) -> SharedSettings:
    """The values of each section by name. A value other than a number, text or boolean becomes its JSON text."""
    fields = {section: msgspec.to_builtins(contents) for section, contents in sections.items()}
    return {section: {name: _plain(value) for name, value in values.items()} for section, values in fields.items()}


def _plain(value: Any) -> Setting:
    return value if isinstance(value, bool | int | float | str) else msgspec.json.encode(value, order="sorted").decode()


def settings_digest(settings: SharedSettings) -> int:
    """The hash of all settings: a number below 2^63, never 0."""
    return int.from_bytes(hashlib.blake2b(msgspec.json.encode(settings, order="sorted"), digest_size=8).digest(), "little") >> 1 | 1


def differing_settings(mine: SharedSettings, theirs: SharedSettings) -> tuple[str, ...]:
    """The settings that both sides state with different values, as `section.name`, in alphabetical order."""
    if mine == theirs:
        return ()
    both = [(section, values, theirs[section]) for section, values in mine.items() if section in theirs]
    differ = [f"{section}.{name}" for section, ours, others in both for name, value in ours.items() if others.get(name, value) != value]
    return tuple(sorted(differ))
