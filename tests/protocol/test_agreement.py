"""Which sections of settings differ between two who should compute the same."""

import hashlib
import json

import msgspec
import pytest

from agents.config import AgentConfig, BirthSettings, CapacitySettings, FilterSettings, TimingSettings
from protocol.agreement import disagreement, section_hash, whole
from protocol.settings import ArenaSettings, DetectionSettings, LimitSettings, RunSettings, SensorSettings

MODEL = {"R": SensorSettings(model="deploy.examples.sensors:RangeFalling")}
OTHERS = {
    "run": AgentConfig(run=RunSettings(dt=0.5)),
    "arena": AgentConfig(arena=ArenaSettings(width=99.0)),
    "detection": AgentConfig(detection=DetectionSettings(clutter=0.2)),
    "limits": AgentConfig(limits=LimitSettings(speed=3.0)),
    "filter": AgentConfig(filter=FilterSettings(seed=1)),
    "birth": AgentConfig(birth=BirthSettings(copies=9)),
    "timing": AgentConfig(timing=TimingSettings(tile=36.0)),
}


def test_the_hash_of_a_section_is_what_the_page_says() -> None:
    written = json.dumps({"height": 100.0, "width": 40.0}, separators=(",", ":")).encode()
    expected = int.from_bytes(hashlib.blake2b(written, digest_size=4).digest(), "little")
    assert section_hash(ArenaSettings(width=40.0, height=100.0)) == expected


@pytest.mark.parametrize("section", OTHERS)
def test_a_section_that_differs_is_named_and_no_other(section: str) -> None:
    mine, theirs = AgentConfig().agreed(), OTHERS[section].agreed()
    assert disagreement(mine, theirs) == (section,)
    assert whole(mine) != whole(theirs)


def test_what_is_nobody_elses_concern_need_not_agree() -> None:
    own = AgentConfig(
        capacity=CapacitySettings(mode="static"),
        timing=TimingSettings(deadline=0.1, estimate_every=4),
        run=RunSettings(seconds=5.0, rate=2.0, patience=1.0),
        sensors={"L": SensorSettings(angle=1.0, radius=2.0)},
        members={"s1": "A"},
    )
    assert disagreement(AgentConfig().agreed(), own.agreed()) == () and whole(AgentConfig().agreed()) == whole(own.agreed())


def test_models_that_announce_themselves_by_a_name_must_be_the_same_to_both() -> None:
    other = {"R": msgspec.structs.replace(MODEL["R"], parameters={"radius": 9.0})}
    assert disagreement(AgentConfig(sensors=MODEL).agreed(), AgentConfig(sensors=other).agreed()) == ("sensors.R",)
    assert disagreement(AgentConfig(sensors=MODEL).agreed(), AgentConfig().agreed()) == ()


def test_who_says_nothing_of_its_settings_contradicts_nobody() -> None:
    assert disagreement(AgentConfig().agreed(), {}) == disagreement({}, AgentConfig().agreed()) == ()
