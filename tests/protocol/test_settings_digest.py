"""Which settings differ between two who should compute the same."""

import hashlib
import json
import math
import re
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import pytest

from agents.config import AgentConfig, BirthSettings, CapacitySettings, FilterSettings, TimingSettings
from protocol.codec import decode, encode
from protocol.fields import MAX_SETTINGS, Malformed
from protocol.message import Setting
from protocol.messages import Hello
from protocol.settings import ArenaSettings, DetectionSettings, LimitSettings, RunSettings, SensorSettings
from protocol.settings_digest import differing_settings, settings_digest

MODEL = {"R": SensorSettings(model="deploy.examples.sensors:RangeFalling")}
OTHERS = {
    "run.dt": AgentConfig(run=RunSettings(dt=0.5)),
    "arena.width": AgentConfig(arena=ArenaSettings(width=99.0)),
    "detection.clutter": AgentConfig(detection=DetectionSettings(clutter=0.2)),
    "limits.speed": AgentConfig(limits=LimitSettings(speed=3.0)),
    "filter.seed": AgentConfig(filter=FilterSettings(seed=1)),
    "birth.measurement_particles": AgentConfig(birth=BirthSettings(measurement_particles=9)),
    "timing.tile": AgentConfig(timing=TimingSettings(tile=36.0)),
}


def test_the_hash_of_all_settings_is_what_the_page_says() -> None:
    settings: dict[str, dict[str, Setting]] = {"birth": {"background": True}, "arena": {"width": 40.0, "height": 100.0}}
    written = json.dumps(settings, separators=(",", ":"), sort_keys=True).encode()
    expected = int.from_bytes(hashlib.blake2b(written, digest_size=8).digest(), "little")
    assert settings_digest(settings) == expected // 2 | 1


@pytest.mark.parametrize("name", OTHERS)
def test_a_setting_that_differs_is_named_and_no_other(name: str) -> None:
    mine, theirs = AgentConfig().shared_settings(), OTHERS[name].shared_settings()
    assert differing_settings(mine, theirs) == differing_settings(theirs, mine) == (name,)
    assert settings_digest(mine) != settings_digest(theirs)


def test_what_is_nobody_elses_concern_need_not_agree() -> None:
    own = AgentConfig(
        capacity=CapacitySettings(mode="static"),
        timing=TimingSettings(deadline=0.1, estimate_every=4),
        run=RunSettings(seconds=5.0, rate=2.0, patience=1.0),
        sensors={"L": SensorSettings(angle=1.0, radius=2.0)},
        members={"s1": "A"},
    )
    assert differing_settings(AgentConfig().shared_settings(), own.shared_settings()) == () and settings_digest(
        AgentConfig().shared_settings()
    ) == settings_digest(own.shared_settings())


def test_models_that_announce_themselves_by_a_name_must_be_the_same_to_both() -> None:
    other = {"R": msgspec.structs.replace(MODEL["R"], parameters={"radius": 9.0})}
    assert differing_settings(AgentConfig(sensors=MODEL).shared_settings(), AgentConfig(sensors=other).shared_settings()) == (
        "sensors.R.parameters",
    )
    assert differing_settings(AgentConfig(sensors=MODEL).shared_settings(), AgentConfig().shared_settings()) == ()


def test_who_says_nothing_of_its_settings_contradicts_nobody() -> None:
    assert differing_settings(AgentConfig().shared_settings(), {}) == differing_settings({}, AgentConfig().shared_settings()) == ()


def test_a_setting_that_only_one_says_is_not_compared() -> None:
    mine = AgentConfig().shared_settings()
    assert differing_settings(mine, {"filter": {"gate": mine["filter"]["gate"]}, "kitchen": {"chairs": 4}}) == ()
    assert differing_settings(mine, {"filter": {"gate": 1.5, "colour": "red"}}) == ("filter.gate",)


def test_the_settings_come_out_of_the_bytes_as_they_went_in() -> None:
    hello = Hello(sender="s1", incarnation=1, settings=AgentConfig(sensors=MODEL, filter=FilterSettings(seed=2**63 - 1)).shared_settings())
    assert decode("covey/demo/hello/s1", encode(hello)) == hello


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"a": {"b": "x" * (MAX_SETTINGS - 1)}}, "size"),
        ({"a": {f"{number:08}": True for number in range(MAX_SETTINGS // 16)}}, "size"),
        ({"x" * (MAX_SETTINGS + 1): {}}, "size"),
        ({"a": {"b": math.nan}}, "range"),
        ({"a": {"b": -math.inf}}, "range"),
        ({"a": {"b": 2.0e12}}, "range"),
        ({"a": {"b": [1.0]}}, "format"),
        ({"a": {"b": {"c": 1}}}, "format"),
        ({"a": {"b": None}}, "format"),
        ({"a": 7}, "format"),
    ],
)
def test_settings_that_are_too_many_or_no_plain_values_are_refused(settings: dict[str, Any], reason: str) -> None:
    with pytest.raises(Malformed) as refused:
        decode("covey/demo/hello/s1", msgpack.packb({"sender": "s1", "incarnation": 1, "settings": settings}))
    assert refused.value.reason == reason


def test_settings_of_just_the_largest_size_are_taken() -> None:
    Hello(sender="s1", incarnation=1, settings={"a": {"b": "x" * (MAX_SETTINGS - 2)}}).check()


def test_the_page_lists_just_the_settings_that_a_hello_says() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference" / "protocol.md").read_text(encoding="utf-8")
    listed: dict[str, set[str]] = {}
    section = ""
    for line in page.partition("### Agreement")[2].partition("\n### ")[0].splitlines():
        row = re.fullmatch(r"\|(?: `([\w.<>]+)`)? \| (`.+?`) \|.*", line)
        if row:
            section = row[1] or section
            listed.setdefault(section, set()).update(re.findall(r"`(\w+)`", row[2]))
    said = AgentConfig(sensors=MODEL, filter=FilterSettings(kind="gaussian-mixture")).shared_settings()
    assert listed == {name.replace("sensors.R", "sensors.<class>"): set(values) for name, values in said.items()}
