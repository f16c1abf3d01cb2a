"""The codec: what goes in comes out, and whatever else comes in, only `Malformed` with a documented reason comes out."""

import math
import os
import random
import re
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest

from protocol import codec
from protocol.fields import Malformed, pack
from protocol.keys import message_key
from protocol.messages import Beacon, Command, Estimate, Gossip, Hello, Message, Observation, Truth
from protocol.sensing import SENSOR_CLASSES

REASONS = frozenset({"key", "size", "format", "version", "shape", "range", "sender"})
RUN = "fuzz"


def samples() -> list[Message]:
    """One message of every kind with every field set, the gossip with 60 particles."""
    rng = np.random.default_rng(7)
    places = rng.uniform(0.0, 100.0, (60, 4))
    return [
        Hello(
            sender="s1",
            incarnation=9,
            sensor_class="A",
            sensor=SENSOR_CLASSES["A"],
            max_speed=2.0,
            max_turn_rate=5.0,
            heard=("s2", "s3"),
            software="0.1",
        ),
        Beacon(sender="s1", incarnation=9, tick=4, position=(1.0, 2.0), cod=(2.0, 2.0), power_radius=6.5, reach=8.0, column=1, row=0),
        Gossip(
            sender="s1",
            incarnation=9,
            tick=4,
            pose=(1.0, 2.0, 0.3),
            cod=(2.0, 2.0),
            power_radius=6.5,
            unused=130.0,
            detections_bytes=pack(places[:3, :2], "<f4"),
            claim_tick=3,
            claim_names=("s1", "s2", "s3"),
            claim_bytes=pack(places[:3, :3], "<f8"),
            view=2**62,
            weight=0.02,
            states_bytes=pack(places, "<f4"),
            ids_bytes=pack(np.sort(rng.integers(0, 2**64, 60, dtype=np.uint64)), "<u8"),
        ),
        Observation(
            sender="world",
            incarnation=9,
            recipient="s1",
            tick=4,
            time=1.0,
            pose=(1.0, 2.0, 0.3),
            detections_bytes=pack(places[:3, :2], "<f4"),
        ),
        Command(sender="s1", incarnation=9, tick=4, velocity=(1.0, -1.0), turn_rate=0.5),
        Estimate(
            sender="s1",
            incarnation=9,
            tick=4,
            pose=(1.0, 2.0, 0.3),
            cod=(2.0, 2.0),
            power_radius=6.5,
            unused=130.0,
            load=1.5,
            mass=2.5,
            cell_bytes=pack(places[:5, :2], "<f8"),
            targets_bytes=pack(places[:2, :2], "<f8"),
            neighbours=("s2",),
            counters={"rounds": 4, "rejected.format": 1},
            round_seconds=0.001,
        ),
        Truth(
            sender="world",
            incarnation=9,
            tick=4,
            time=1.0,
            targets_bytes=pack(places[:2, :2], "<f8"),
            ids_bytes=pack(np.array([1, 2]), "<u8"),
            bodies=("s1",),
            poses_bytes=pack(places[:1, :3], "<f8"),
            in_view=1,
            alive=("s1",),
        ),
    ]


SAMPLES = [(message_key(RUN, message), codec.encode(message), message) for message in samples()]
GOSSIP_KEY, GOSSIP_BYTES, GOSSIP = SAMPLES[2]


def reason_of(key: str, payload: bytes) -> str:
    """The reason why the bytes are refused, or "accepted"; any other exception fails the test."""
    try:
        codec.decode(key, payload)
    except Malformed as error:
        assert error.reason in REASONS, f"undocumented reason {error.reason!r} for {payload.hex()}"
        assert 0 < len(str(error)) < 2000
        return error.reason
    return "accepted"


def altered(key: str, payload: bytes, **fields: Any) -> bytes:
    """The payload with some fields replaced (None removes one), written by plain msgpack."""
    plain = msgpack.unpackb(payload)
    plain.update(fields)
    return msgpack.packb({name: value for name, value in plain.items() if value is not None})


@pytest.mark.parametrize(("key", "payload", "message"), SAMPLES, ids=[type(sample[2]).__name__ for sample in SAMPLES])
def test_every_kind_comes_back_equal(key: str, payload: bytes, message: Message) -> None:
    assert codec.decode(key, payload) == message


def test_encoding_is_the_same_every_time() -> None:
    assert codec.encode(codec.decode(GOSSIP_KEY, GOSSIP_BYTES)) == GOSSIP_BYTES


def test_a_usual_gossip_is_small() -> None:
    assert len(GOSSIP_BYTES) < 2000


def test_the_documented_reasons_are_those_of_the_docstring_and_of_the_page() -> None:
    listed = re.search(r"`reason` is one of ([a-z, ]+)\.", codec.decode.__doc__ or "")
    assert listed is not None and set(listed[1].split(", ")) == REASONS
    page = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text(encoding="utf-8")
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
    for key, payload, _ in SAMPLES[:-1]:
        assert reason_of(key.replace("/s1", "/s2"), payload) == "sender"
    assert reason_of(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, sender="s2")) == "sender"


def test_an_observation_is_checked_by_its_recipient_because_the_world_speaks_under_the_agents_name() -> None:
    key, payload, _ = SAMPLES[3]
    assert reason_of(key, altered(key, payload, sender="anyone")) == "accepted"
    assert reason_of(key, altered(key, payload, recipient="s2")) == "sender"


@pytest.mark.parametrize("wire", [0, 2, -1, 2**40])
def test_another_version_is_refused_as_version(wire: int) -> None:
    for key, payload, _ in SAMPLES:
        assert reason_of(key, altered(key, payload, wire=wire)) == "version"


def test_another_version_is_recognised_although_its_fields_have_changed() -> None:
    assert reason_of(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, wire=2, pose=[0.0] * 6, tick=None)) == "version"


def test_a_message_without_wire_is_of_the_first_version() -> None:
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


HUGE = [
    b"\xdd\xff\xff\xff\xff",
    b"\xdf\xff\xff\xff\xff",
    b"\xdb\xff\xff\xff\xff",
    b"\xc6\xff\xff\xff\xff",
    b"\xc9\xff\xff\xff\xff\x00",
    b"\xdc\xff\xff",
    b"\xde\xff\xff",
    b"\xda\xff\xff",
]


@pytest.mark.parametrize("header", HUGE, ids=lambda header: header.hex())
@pytest.mark.parametrize("field", ["pose", "claim_names", "states", "counters", "heard", "sender", "unknown", "bodies"])
def test_a_huge_declared_length_is_refused_without_taking_memory(header: bytes, field: str) -> None:
    packed_field = msgpack.packb(field)
    tracemalloc.start()
    try:
        for key, _, _ in SAMPLES:
            assert reason_of(key, header) == "format"
            assert reason_of(key, b"\x81" + packed_field + header) == "format"
            assert reason_of(key, b"\x81" + packed_field + header + b"\x01" * 100) == "format"
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


def _random_value(dice: random.Random, depth: int = 0) -> Any:
    numbers = [0, 1, -1, 2**53, 2**53 + 1, 2**63, 2**64 - 1, -(2**63), math.nan, math.inf, -math.inf, 1e300, 1e-320, 1e6, 1.1e6, -0.0]
    kind = dice.randrange(9 if depth < 3 else 5)
    if kind <= 1:
        return dice.choice(numbers)
    if kind == 2:
        return dice.choice(
            [
                None,
                True,
                False,
                "",
                "s1",
                "s2",
                "ÿ" * 30,
                "gossip",
                b"",
                b"\x00" * dice.randrange(70),
                msgpack.Timestamp(1, 2),
                msgpack.ExtType(5, b"x"),
            ]
        )
    if kind == 3:
        return dice.randbytes(dice.choice([1, 7, 8, 15, 16, 24, 33, 64, 960]))
    if kind == 4:
        return struct.pack("<4d", *(dice.choice([math.nan, math.inf, -math.inf, 1.0, 2e6]) for _ in range(4)))
    if kind <= 7:
        return [_random_value(dice, depth + 1) for _ in range(dice.randrange(5))]
    return {dice.choice(["a", "angle", "radius", "rounds"]): _random_value(dice, depth + 1) for _ in range(dice.randrange(3))}


def mutate(dice: random.Random, payload: bytes) -> bytes:
    """A message with a few faults of one kind: bits, bytes, cuts, splices, headers, or fields of another value or type."""
    kind = dice.randrange(8)
    data = bytearray(payload)
    if kind == 0:
        for _ in range(dice.randint(1, 4)):
            data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
    elif kind == 1:
        for _ in range(dice.randint(1, 8)):
            data[dice.randrange(len(data))] = dice.randrange(256)
    elif kind == 2:
        start = dice.randrange(len(data))
        del data[start : start + dice.randint(1, 40)]
    elif kind == 3:
        other = dice.choice(SAMPLES)[1]
        start = dice.randrange(len(other))
        place = dice.randrange(len(data))
        data[place:place] = other[start : start + dice.randint(1, 60)]
    elif kind == 4:
        place = dice.randrange(len(data))
        header = dice.choice(HUGE)
        data[place : place + len(header)] = header
    elif kind == 5:
        return dice.randbytes(dice.randint(0, 200))
    else:
        plain = msgpack.unpackb(payload)
        for _ in range(dice.randint(1, 3)):
            field = dice.choice([*plain, "stranger"])
            value = plain.get(field)
            plain[field] = value[:-1] if kind == 6 and isinstance(value, bytes | list | str) and len(value) else _random_value(dice)
        return msgpack.packb(plain)
    return bytes(data)


def fuzz(count: int, seed: int) -> dict[str, int]:
    """How often each reason came up among `count` mutated messages; fails on any other exception and prints how to replay it."""
    dice = random.Random(seed)
    found: dict[str, int] = {}
    for number in range(count):
        key, payload, _ = SAMPLES[dice.randrange(len(SAMPLES))]
        mutant = mutate(dice, payload)
        try:
            reason = reason_of(key, mutant)
        except BaseException as error:
            pytest.fail(f"mutant {number} of COVEY_FUZZ_SEED={seed} under {key} raised {error!r}: {mutant.hex()}")
        found[reason] = found.get(reason, 0) + 1
    return found


def outcomes(pairs: list[tuple[str, bytes]]) -> list[Message | str]:
    """Each alone: the message, or why it is none."""
    found: list[Message | str] = []
    for key, payload in pairs:
        try:
            found.append(codec.decode(key, payload))
        except Malformed as error:
            found.append(f"{error.reason}: {error}")
    return found


def together(pairs: list[tuple[str, bytes]]) -> list[Message | str]:
    return [f"{found.reason}: {found}" if isinstance(found, Malformed) else found for found in codec.decode_all(pairs)]


def gossips(count: int) -> list[tuple[str, bytes]]:
    """Well-formed gossips of several senders, some without claim or particles."""
    found = []
    for number in range(count):
        name = f"s{number + 1}"
        gossip = msgspec.structs.replace(GOSSIP, sender=name, claim_names=(name, *GOSSIP.claim_names[1:]))
        if number % 3 == 1:
            gossip = msgspec.structs.replace(gossip, states_bytes=b"", ids_bytes=b"")
        if number % 3 == 2:
            gossip = msgspec.structs.replace(
                gossip, states_bytes=b"", ids_bytes=b"", claim_names=(), claim_bytes=b"", claim_tick=0, detections_bytes=b""
            )
        found.append((message_key(RUN, gossip), codec.encode(gossip)))
    return found


def test_many_read_together_are_what_each_is_alone() -> None:
    pairs = gossips(9) + [(key, payload) for key, payload, _ in SAMPLES]
    assert together(pairs) == outcomes(pairs) and all(isinstance(found, Message) for found in together(pairs))
    assert together([]) == [] and together(pairs[:1]) == outcomes(pairs[:1])


@pytest.mark.parametrize("place", range(7))
def test_one_bad_gossip_among_many_is_refused_alone_and_for_its_own_reason(place: int) -> None:
    ids, states = GOSSIP.ids.copy(), GOSSIP.states.copy()
    states[5, 1] = np.nan
    beyond = GOSSIP.claim.copy()
    beyond[2, 0] = 2.0e6
    twice = np.concatenate([ids[:4], ids[3:-1]])
    faults: list[dict[str, Any]] = [
        {"states": pack(states, "<f4")},
        {"claim": pack(beyond, "<f8")},
        {"ids": pack(ids[::-1], "<u8")},
        {"ids": pack(twice, "<u8")},
        {"detections": pack(np.array([[np.inf, 0.0]]), "<f4")},
        {"detections": b"1234567"},
        {"ids": pack(ids[:-1], "<u8")},
        {"power_radius": -1.0},
        {"weight": math.nan},
        {"claim_tick": 4},
        {"claim_names": ["s2", "s1", "s3"]},
        {"claim_names": [], "claim": b""},
        {"unused": 1.0e13},
    ]
    for fault in faults:
        pairs = gossips(6)
        pairs.insert(place, (GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, **fault)))
        alone = outcomes(pairs)
        assert together(pairs) == alone and isinstance(alone[place], str), f"{fault}: {alone[place]}"


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_mutated_messages_read_together_have_the_outcome_of_each_alone() -> None:
    seed = int(os.environ.get("COVEY_FUZZ_SEED", "6"))
    dice = random.Random(seed)
    for number in range(200):
        samples_here = [SAMPLES[dice.randrange(len(SAMPLES))] for _ in range(4)] + [SAMPLES[2]] * 4
        pairs = [(key, mutate(dice, payload)) for key, payload, _ in samples_here] + gossips(5)
        dice.shuffle(pairs)
        assert repr(together(pairs)) == repr(outcomes(pairs)), f"batch {number} of COVEY_FUZZ_SEED={seed}"


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_nothing_but_malformed_leaves_the_decoder_in_20_000_mutated_messages() -> None:
    seed = int(os.environ.get("COVEY_FUZZ_SEED", "1"))
    found = fuzz(20_000, seed)
    assert set(found) == (REASONS - {"key", "size"}) | {"accepted"}, f"seed {seed}: {found}"
    assert found["format"] > 5_000 and found["range"] > 100 and found["shape"] > 100, f"seed {seed}: {found}"


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_nothing_but_malformed_leaves_the_decoder_in_a_million_mutated_messages_and_memory_stays_flat() -> None:
    fuzz(20_000, 2)
    tracemalloc.start()
    try:
        fuzz(20_000, 3)
        before = tracemalloc.get_traced_memory()[0]
        fuzz(20_000, 4)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    resident = resident_bytes()
    fuzz(940_000, 5)
    assert grown < 64 * 1024
    assert resident_bytes() - resident < 16 * 2**20


def resident_bytes() -> int:
    """Memory of this process that is resident, bytes (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
