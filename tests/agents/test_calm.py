"""Gossips read together are what each is alone, and what the reader takes the decoder and the neighbours take with the same values."""

import random
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.agent import Agent
from agents.backend import PLAIN
from agents.calm import CalmRound, Expected, Roll
from agents.config import AgentConfig, PartitionSettings
from agents.fast import FAST
from agents.neighbours import Neighbours
from agents.words import Words, eye_of, learn, side_by_side
from protocol import codec
from protocol.fields import pack
from protocol.keys import message_key
from protocol.messages import Gossip, Hello
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import sensor_of
from tests.protocol.test_codec_fuzz import mutate

MEMBERS = dict(zip(("s1", "s2", "s3", "s10", "s11"), "ABCDE"))
CONFIG = AgentConfig(members=MEMBERS)
TICK = 7
Wire = tuple[str, bytes]


def gossip(dice: random.Random, name: str, tick: int = TICK, **fields: Any) -> Gossip:
    """What a peer could say."""
    count, seen, bounds = dice.choice([0, 1, 5, 60]), dice.choice([0, 0, 1, 4]), dice.choice([1, 2, 20])
    sensor = SENSOR_CLASSES[MEMBERS[name]]
    east, north = dice.uniform(10.0, 90.0), dice.uniform(10.0, 90.0)
    names = (name, *(f"s{20 + n}" for n in range(bounds - 1))) if count or dice.random() < 0.7 else ()
    rows = np.array([[dice.uniform(0.0, 100.0) for _ in range(4)] for _ in range(max(count, seen, bounds))])
    ids = np.array(sorted(dice.sample(range(1, 2**63), count)), dtype=np.uint64)
    said = {
        "sender": name,
        "incarnation": 1,
        "tick": tick,
        "pose": (east, north, dice.uniform(-4.0, 4.0)),
        "cod": (east + dice.uniform(-1.0, 1.0), north),
        "power_radius": dice.uniform(0.0, 1.0),
        "unused": dice.uniform(0.0, 1.0) * sensor.area * sensor.prob_detection,
        "detections_bytes": pack(rows[:seen, :2], "<f4"),
        "scanned": dice.random() < 0.8,
        "claim_tick": max(0, tick - 1),
        "claim_names": names,
        "claim_bytes": pack(rows[: len(names), :3], "<f8"),
        "view": dice.choice([5, 5, 2**40]),
        "weight": dice.uniform(0.0, 1.0) if count else 0.0,
        "states_bytes": pack(rows[:count], "<f4"),
        "ids_bytes": pack(ids, "<u8"),
    }
    return Gossip(**(said | fields))


def wire(said: Gossip) -> Wire:
    return message_key(CONFIG.run.name, said), codec.encode(said)


def roll(config: AgentConfig = CONFIG, without: str = "s3") -> Roll:
    """All members but one, whose row is left free."""
    assert FAST.reader is not None
    facts = Neighbours(config, without)
    for name, sensor_class in MEMBERS.items():
        if name != without:
            facts.greet(Hello(sender=name, incarnation=1, sensor_class=sensor_class))
    expected = []
    for name, peer in facts.peers.items():
        assert peer.outfit is not None
        eye = eye_of(name, peer.outfit.sensor, config.detection.clutter)
        expected.append(Expected(name, 1, eye, peer.outfit.facts.capability, peer.outfit.sensor.reach))
    return Roll(config, FAST.reader, expected, list(MEMBERS).index(without))


def read(batch: list[Wire]) -> CalmRound | None:
    reading = CalmRound(roll(), TICK)
    return reading if reading.read(*zip(*batch)) is not None else None


def one_by_one(gossips: list[Gossip], config: AgentConfig = CONFIG) -> Words:
    for said in gossips:
        learn(said, sensor_of(config, MEMBERS[said.sender]), config)
    return side_by_side(gossips)


def assert_same(found: Words, wanted: Words) -> None:
    assert found.names == wanted.names and found.claimed == wanted.claimed and found.listening == wanted.listening
    assert found.table.tobytes() == wanted.table.tobytes() and found.view == wanted.view and found.all_wedges == wanted.all_wedges
    assert found.detections.tobytes() == wanted.detections.tobytes() and found.detections.shape == wanted.detections.shape
    for a, b in zip((*found.stated, *found.particles), (*wanted.stated, *wanted.particles)):
        assert a.tobytes() == b.tobytes() and a.shape == b.shape and a.dtype == b.dtype
    assert found.gossips == wanted.gossips


@pytest.mark.parametrize("kind", ["power", "voronoi", "voronoi-cod"])
def test_the_words_of_a_calm_round_are_those_of_its_gossips(kind: str) -> None:
    config = AgentConfig(members=MEMBERS, partition=PartitionSettings(kind=kind))  # type: ignore[arg-type]
    for seed in range(40):
        dice = random.Random(seed)
        gossips = [gossip(dice, name) for name in MEMBERS]
        mine = gossips[2]
        batch = [wire(said) for said in gossips if said is not mine]
        dice.shuffle(batch)
        reading = CalmRound(roll(config), TICK)
        cut = dice.randint(1, 3)
        for part in (batch[:cut], batch[cut:]):
            names = reading.read(*zip(*part))
            assert names is not None and [f"/{name}" for name in names] == [key[key.rindex("/") :] for key, _ in part], f"seed {seed}"
        learn(mine, SENSOR_CLASSES["C"], config)
        assert_same(reading.words(mine), one_by_one(gossips, config))
        assert list(reading) == ["s1", "s2", "s10", "s11"] and list(reading.gossips()) == list(reading)


ODD: dict[str, dict[str, Any]] = {
    "another tick": {"tick": TICK + 1},
    "another incarnation": {"incarnation": 2},
    "no cell yet": {"listening": True},
    "more unused capacity than there is": {"unused": 1e5},
    "a power radius beyond its sensor": {"power_radius": 100.0},
    "a COD beyond reach": {"cod": (0.0, 0.0), "pose": (90.0, 90.0, 0.0)},
    "a number that is none": {"weight": float("nan")},
    "a negative weight": {"weight": -1e-9},
    "a place that is nowhere": {"pose": (float("inf"), 0.0, 0.0)},
    "a particle that is nowhere": {"states_bytes": pack(np.array([[1.0, np.nan, 1.0, 1.0]]), "<f4"), "ids_bytes": bytes(8)},
    "a detection that is nowhere": {"detections_bytes": pack(np.array([[1.0, np.inf]]), "<f4")},
    "half a detection": {"detections_bytes": bytes(4)},
    "ids that fall": {
        "states_bytes": bytes(32),
        "ids_bytes": pack(np.array([9, 3]), "<u8"),
        "claim_names": ("s2",),
        "claim_bytes": bytes(24),
    },
    "fewer ids than particles": {"states_bytes": bytes(32), "ids_bytes": bytes(8)},
    "a claim of the future": {"claim_tick": TICK},
    "somebody else's claim": {"claim_names": ("s1",), "claim_bytes": bytes(24)},
    "a claim without numbers": {"claim_names": ("s2",), "claim_bytes": b""},
    "particles without a claim": {"states_bytes": bytes(16), "ids_bytes": bytes(8), "claim_names": (), "claim_bytes": b""},
    "a whole number for a real one": {"weight": 1},
    "another's name": {"sender": "s1"},
    "another wire": {"wire": 2},
    "a name not of ASCII": {"claim_names": ("s2", "\u00e9"), "claim_bytes": bytes(48)},
}


@pytest.mark.parametrize("odd", ODD)
def test_what_is_out_of_the_ordinary_is_left_to_be_read_alone(odd: str) -> None:
    dice = random.Random(3)
    good, base = wire(gossip(dice, "s1")), gossip(dice, "s2")
    assert read([good, wire(base)]) is not None
    bad = message_key(CONFIG.run.name, base), msgspec.msgpack.encode(msgspec.structs.replace(base, **ODD[odd]))
    assert read([good, bad]) is None and read([bad]) is None


def test_a_stranger_a_second_word_and_bytes_too_many_are_left_to_be_read_alone() -> None:
    dice = random.Random(4)
    key, payload = wire(gossip(dice, "s1"))
    assert read([(key, payload), (key, payload)]) is None
    assert read([(f"{key}9", payload)]) is None and read([("covey/other/gossip/s1", payload)]) is None
    assert read([(key, payload + b"\xc0")]) is None and read([(key, payload[:-1])]) is None and read([(key, b"")]) is None
    reading = read([(key, payload)])
    assert reading is not None and reading.read([key], [payload]) is None and len(reading) == 1
    assert reading.read(*zip(wire(gossip(dice, "s2")))) is not None and len(reading) == 2


def test_whatever_bytes_the_reader_takes_the_decoder_and_the_neighbours_take_with_the_same_values() -> None:
    dice, taken, changed = random.Random(11), 0, 0
    names = [name for name in MEMBERS if name != "s3"]
    for number in range(6000):
        key, payload = wire(gossip(dice, dice.choice(names)))
        mutated = mutate(dice, payload)
        reading = read([(key, mutated)])
        if reading is not None:
            said = codec.decode(key, mutated)  # raises what the reader should have seen
            assert isinstance(said, Gossip), f"message {number}"
            mine = gossip(dice, "s3")
            learn(mine, SENSOR_CLASSES["C"], CONFIG)
            others = {name: gossip(dice, name) for name in names if name != said.sender}
            assert reading.read(*zip(*map(wire, others.values()))) is not None
            everybody = {said.sender: said, "s3": mine, **others}
            assert_same(reading.words(mine), one_by_one([everybody[name] for name in MEMBERS]))
            assert believed(said), f"message {number}"
            taken, changed = taken + 1, changed + (mutated != payload)
    assert changed > 100 and taken < 3000


def believed(said: Gossip) -> bool:
    judge = Neighbours(CONFIG, "s3")
    judge.alive(said.sender, 1)
    judge.greet(Hello(sender=said.sender, incarnation=1, sensor_class=MEMBERS[said.sender]))
    return judge.hear(said) is None


def test_plain_arithmetic_reads_one_by_one() -> None:
    assert PLAIN.reader is None
    assert Agent(CONFIG, "s1").hear_all([], [], 0.0) is None
