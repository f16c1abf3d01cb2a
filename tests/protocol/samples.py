"""One well-formed message of every kind, as bytes; and why bytes are refused."""

import struct
from typing import Any

import msgpack
import numpy as np

from protocol import codec
from protocol.fields import Malformed, pack
from protocol.keys import message_key
from protocol.message import Message
from protocol.messages import Beacon, BodyPose, Command, Gossip, Halt, Hello, Observation
from protocol.observer_messages import Estimate, Truth
from protocol.sensing import SENSOR_CLASSES

REASONS = frozenset({"key", "size", "format", "version", "shape", "range", "sender"})
RUN = "fuzz"


HUGE = [
    b"\xdd\xff\xff\xff\xff",
    b"\xdf\xff\xff\xff\xff",
    b"\xdb\xff\xff\xff\xff",
    b"\xc6\xff\xff\xff\xff",
    b"\xc9\xff\xff\xff\xff\x00",
    b"\xdc\xff\xff",
    b"\xde\xff\xff",
    b"\xda\xff\xff",
]  # headers that declare far more than follows


def _samples() -> list[Message]:
    """One message of every kind with every field set, the gossip with 60 particles."""
    rng = np.random.default_rng(7)
    places = rng.uniform(0.0, 100.0, (60, 4))
    return [
        Hello(
            sender="s1",
            incarnation=9,
            sensor_class="A",
            sensor=SENSOR_CLASSES["A"],
            heard=("s2", "s3"),
            software="0.1",
            settings={"run": {"dt": 0.25}, "filter": {"seed": 2**63 - 1, "border": "cross"}, "birth": {"background": True}},
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
            diagram_hash=2**62,
            weight=0.02,
            states_bytes=pack(places, "<f4"),
            ids_bytes=pack(np.sort(rng.integers(0, 2**64, 60, dtype=np.uint64)), "<u8"),
            components_bytes=b"".join([struct.pack("<3f12e2Q", 0.5, *places[number], *range(10), 7 * number, 2**40) for number in (0, 1)]),
            labels_bytes=pack(np.array([0, 7, 2**40]), "<u8"),
            label_numbers_bytes=bytes(range(3)) * 20,
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
        BodyPose(sender="s1", incarnation=9, tick=4, pose=(1.0, -1.0, 0.5)),
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
            details_bytes=pack(np.ones((2, 6)), "<f4"),
            labels_bytes=pack(np.array([7, 2**40]), "<u8"),
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
        Halt(sender="operator-7", incarnation=9, held=True),
    ]


SAMPLES = [(message_key(RUN, message), codec.encode(message), message) for message in _samples()]
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
