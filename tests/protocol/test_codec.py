"""The codec: what goes in comes out, and whatever else comes in, only `Malformed` with a documented reason comes out."""

import math
import re
import tracemalloc
from pathlib import Path

import msgpack
import pytest

from protocol import codec
from protocol.message import Message
from protocol.messages import Hello
from tests.protocol.samples import GOSSIP, GOSSIP_BYTES, GOSSIP_KEY, HUGE, REASONS, RUN, SAMPLES, altered, reason_of


@pytest.mark.parametrize(("key", "payload", "message"), SAMPLES, ids=[type(sample[2]).__name__ for sample in SAMPLES])
def test_every_kind_comes_back_equal(key: str, payload: bytes, message: Message) -> None:
    assert codec.decode(key, payload) == message


def test_encoding_is_the_same_every_time() -> None:
    assert codec.encode(codec.decode(GOSSIP_KEY, GOSSIP_BYTES)) == GOSSIP_BYTES


def test_a_gossip_of_sixty_particles_with_labels_and_two_components_is_small() -> None:
    assert len(GOSSIP_BYTES) < 2100


def test_the_documented_reasons_are_those_of_the_docstring_and_of_the_page() -> None:
    listed = re.search(r"`reason` is one of ([a-z, ]+)\.", codec.decode.__doc__ or "")
    assert listed is not None and set(listed[1].split(", ")) == REASONS
    page = (Path(__file__).parents[2] / "docs" / "reference" / "protocol.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `([a-z]+)` \| refused", page, re.MULTILINE)) == REASONS


@pytest.mark.parametrize(
    "key",
    [
        "",
        "covey",
        "covey/fuzz/gossip",
        "covey/fuzz/gossip/s1/x",
        "covey/fuzz/unknown/s1",
        "covey/fuzz/alive/agent/s1/9",
        "other/fuzz/gossip/s1",
    ],
)
def test_an_unknown_key_is_refused_as_key(key: str) -> None:
    assert reason_of(key, GOSSIP_BYTES) == "key"


def test_a_message_under_the_key_of_another_kind_is_refused() -> None:
    for _, payload, message in SAMPLES:
        for other_key, _, other in SAMPLES:
            if other is not message:
                assert reason_of(other_key, payload) == "format"


def test_another_sender_than_the_key_says_is_refused() -> None:
    for key, payload, _ in SAMPLES[:-2]:
        assert reason_of(key.replace("/s1", "/s2"), payload) == "sender"
    assert reason_of(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, sender="s2")) == "sender"


@pytest.mark.parametrize("name", ["world", "monitor", "supervisor", "operator"])
def test_an_agent_with_the_name_of_another_process_is_refused(name: str) -> None:
    hello = codec.encode(Hello(sender=name, incarnation=1))
    assert reason_of(f"covey/{RUN}/hello/{name}", hello) == "format"
    assert reason_of(GOSSIP_KEY.replace("/s1", f"/{name}"), altered(GOSSIP_KEY, GOSSIP_BYTES, sender=name)) == "format"
    assert reason_of(f"covey/{RUN}/hello/world", codec.encode(Hello(sender="world", incarnation=1, role="world"))) == "accepted"


def test_an_observation_is_checked_by_its_recipient_because_the_world_speaks_under_the_agents_name() -> None:
    key, payload, _ = SAMPLES[3]
    assert reason_of(key, altered(key, payload, sender="anyone")) == "accepted"
    assert reason_of(key, altered(key, payload, recipient="s2")) == "sender"


@pytest.mark.parametrize("wire", [0, 1, 3, -1, 2**40])
def test_another_version_is_refused_as_version(wire: int) -> None:
    for key, payload, _ in SAMPLES:
        assert reason_of(key, altered(key, payload, wire=wire)) == "version"


def test_another_version_is_recognised_although_its_fields_have_changed() -> None:
    assert reason_of(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, wire=3, pose=[0.0] * 6, tick=None)) == "version"


def test_a_message_without_wire_is_of_this_version() -> None:
    assert reason_of(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, wire=None)) == "accepted"


def test_an_unknown_field_is_passed_over() -> None:
    assert codec.decode(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, colour=[1, {"a": b"x"}])) == GOSSIP


def test_whole_numbers_count_as_floats_and_nothing_else_is_converted() -> None:
    assert reason_of(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, power_radius=6)) == "accepted"
    for wrong in (
        {"power_radius": "6.5"},
        {"tick": 4.0},
        {"tick": True},
        {"scanned": 1},
        {"sender": b"s1"},
        {"states": "text"},
        {"pose": [1.0, 2.0]},
    ):
        assert reason_of(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, **wrong)) == "format"


def test_a_wedge_that_cannot_be_built_is_refused_as_format() -> None:
    key, payload, _ = SAMPLES[0]
    for sensor in (
        {"angle": 7.0, "radius": 8.0, "prob_detection": 0.9},
        {"angle": 1.0, "radius": math.inf, "prob_detection": 0.9},
        {"angle": math.nan, "radius": 1.0, "prob_detection": 1.0},
        {"angle": 1.0, "radius": 1.0, "prob_detection": 0.5, "prob_detection_far": 0.6},
    ):
        assert reason_of(key, altered(key, payload, sensor=sensor)) == "format"


@pytest.mark.parametrize("name", ["", "a b", "s1\n", "s1/x", "*", "s" * 65, "ä"])
def test_a_name_that_could_not_stand_in_a_key_is_refused(name: str) -> None:
    assert reason_of(f"covey/{RUN}/gossip/{name}", altered(GOSSIP_KEY, GOSSIP_BYTES, sender=name)) in ("format", "key")


def test_one_byte_too_many_is_refused_before_anything_is_read() -> None:
    assert reason_of(GOSSIP_KEY, b"\xc1" * codec.MAX_BYTES) == "format"
    assert reason_of(GOSSIP_KEY, b"\xc1" * (codec.MAX_BYTES + 1)) == "size"


def test_every_truncation_and_every_longer_message_is_refused_as_format() -> None:
    for key, payload, _ in SAMPLES:
        assert {reason_of(key, payload[:length]) for length in range(len(payload))} == {"format"}
        assert reason_of(key, payload + b"\x00") == "format"


@pytest.mark.parametrize("opener", [b"\x91", b"\x81\xa1a", b"\x81\x91", b"\xdc\x00\x01", b"\xdf\x00\x00\x00\x01\xa1a"])
def test_deep_nesting_is_refused_also_inside_an_unknown_field(opener: bytes) -> None:
    depth = (codec.MAX_BYTES - 100) // len(opener)
    assert reason_of(GOSSIP_KEY, opener * depth + b"\xc0") == "format"
    assert reason_of(GOSSIP_KEY, b"\x81\xa1z" + opener * depth + b"\xc0") == "format"
    assert reason_of(GOSSIP_KEY, b"\x82\xa4wire\x02\xa1z" + opener * depth + b"\xc0") in ("format", "version")


@pytest.mark.parametrize("header", HUGE, ids=lambda header: header.hex())
@pytest.mark.parametrize("field", ["pose", "claim_names", "states", "counters", "heard", "sender", "unknown", "bodies"])
def test_a_huge_declared_length_is_refused_without_taking_memory(header: bytes, field: str) -> None:
    packed_field = msgpack.packb(field)
    tracemalloc.start()
    try:
        for key, _, _ in SAMPLES:
            assert reason_of(key, header) == "format"
            assert reason_of(key, b"\x81" + packed_field + header) in ("format", "size")
            assert reason_of(key, b"\x81" + packed_field + header + b"\x01" * 100) in ("format", "size")
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()
