"""Messages that were mutated at random, and many read together: what each is alone, and no exception but `Malformed`."""

import math
import os
import random
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
from protocol.message import Message
from tests.protocol.samples import GOSSIP, GOSSIP_BYTES, GOSSIP_KEY, HUGE, REASONS, RUN, SAMPLES, altered, reason_of


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
            gossip = msgspec.structs.replace(gossip, states_bytes=b"", ids_bytes=b"", labels_bytes=b"", label_numbers_bytes=b"")
        if number % 3 == 2:
            gossip = msgspec.structs.replace(
                gossip,
                states_bytes=b"",
                ids_bytes=b"",
                labels_bytes=b"",
                label_numbers_bytes=b"",
                components_bytes=b"",
                claim_names=(),
                claim_bytes=b"",
                claim_tick=0,
                detections_bytes=b"",
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
        {"claim_ages": b"\0\1"},
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
    assert set(found) == (REASONS - {"key"}) | {"accepted"}, f"seed {seed}: {found}"
    assert found["format"] > 5_000 and found["range"] > 100 and found["shape"] > 100, f"seed {seed}: {found}"


@pytest.mark.slow
@pytest.mark.nightly
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
