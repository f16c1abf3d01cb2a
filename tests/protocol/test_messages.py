"""Messages: arrays read back, and every rule of a receiver with the smallest message that breaks it."""

import math
from datetime import datetime, timedelta
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from deploy.scenario import resolve
from protocol.codec import decode, encode
from protocol.fields import LARGEST_NUMBER, LARGEST_TIME, Malformed, pack
from protocol.keys import message_key
from protocol.message import Message
from protocol.messages import KINDS, Beacon, Command, Gossip, Hello, Observation
from protocol.observer_messages import Estimate, Truth
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import BadSetting

GOSSIP = Gossip(
    sender="s1",
    incarnation=3,
    tick=8,
    pose=(1.0, 2.0, 0.5),
    cod=(3.0, 2.0),
    power_radius=2.0,
    unused=12.5,
    detections_bytes=pack(np.array([[1.5, 2.5]]), "<f4"),
    claim_tick=7,
    claim_names=("s1", "s2"),
    claim_bytes=pack(np.array([[3.0, 2.0, 2.0], [9.0, 9.0, 1.0]]), "<f8"),
    weight=0.25,
    states_bytes=pack(np.array([[1.0, 2.0, 0.1, 0.2], [3.0, 4.0, 0.3, 0.4]]), "<f4"),
    ids_bytes=pack(np.array([5, 2**64 - 1], dtype=np.uint64), "<u8"),
)
BEACON = Beacon(sender="s1", incarnation=1, tick=1, position=(0.0, 0.0), cod=(1.0, 1.0), power_radius=1.0, reach=8.0, column=0, row=0)
HELLO = Hello(sender="s1", incarnation=1, sensor_class="A", sensor=SENSOR_CLASSES["A"])
OBSERVATION = Observation(sender="world", incarnation=1, recipient="s1", tick=1, time=0.25, pose=(0.0, 0.0, 0.0))
COMMAND = Command(sender="s1", incarnation=1, tick=1, velocity=(1.0, 0.0), turn_rate=0.5)
ESTIMATE = Estimate(sender="s1", incarnation=1, tick=1, pose=(0.0, 0.0, 0.0), cod=(0.0, 0.0), power_radius=0.0, unused=0.0)
TRUTH = Truth(sender="world", incarnation=1, tick=1, time=0.25)


def changed(message: Message, **fields: Any) -> Message:
    return msgspec.structs.replace(message, **fields)


def check(message: Message) -> None:
    """Raise what a receiver raises."""
    decode(message_key("demo", message), encode(message))


@pytest.mark.parametrize(
    "message", [GOSSIP, BEACON, HELLO, OBSERVATION, COMMAND, ESTIMATE, TRUTH], ids=lambda message: type(message).__name__
)
def test_a_sound_message_of_every_kind_passes(message: Message) -> None:
    check(message)


def test_all_nine_kinds_are_known_by_their_tag() -> None:
    assert {kind: message_type.__struct_config__.tag for kind, message_type in KINDS.items()} == {kind: kind for kind in KINDS}
    assert len(KINDS) == 9


def test_a_gossip_gives_its_arrays_back() -> None:
    assert GOSSIP.detections.tolist() == [[1.5, 2.5]]
    assert GOSSIP.claim.tolist() == [[3.0, 2.0, 2.0], [9.0, 9.0, 1.0]]
    assert GOSSIP.states.shape == (2, 4)
    assert GOSSIP.ids.tolist() == [5, 2**64 - 1]
    assert (GOSSIP.states.dtype, GOSSIP.claim.dtype, GOSSIP.ids.dtype) == (np.float32, np.float64, np.uint64)


def test_arrays_are_read_only_and_messages_frozen() -> None:
    with pytest.raises(ValueError, match="read-only"):
        GOSSIP.states[0, 0] = 1.0
    with pytest.raises(AttributeError):
        GOSSIP.tick = 9  # type: ignore[misc]


def test_an_agent_that_saw_nothing_and_owns_nothing_sends_empty_arrays_of_the_right_shape() -> None:
    empty = Gossip(sender="s1", incarnation=1, tick=1, pose=(0.0, 0.0, 0.0), cod=(0.0, 0.0), power_radius=0.0, unused=0.0)
    check(empty)
    assert (empty.detections.shape, empty.claim.shape, empty.states.shape, empty.ids.shape) == ((0, 2), (0, 3), (0, 4), (0,))


@given(arrays(np.float64, st.tuples(st.integers(0, 20), st.just(2)), elements=st.floats(-1e6, 1e6)))
def test_packed_arrays_come_back_bit_for_bit_whatever_their_layout(array: np.ndarray) -> None:
    for layout in (array, np.asfortranarray(array), array.astype(">f8")):
        assert changed(ESTIMATE, cell_bytes=pack(layout, "<f8")).cell.tobytes() == array.tobytes()


BROKEN = [
    (GOSSIP, {"states_bytes": GOSSIP.states_bytes[:-1]}, "shape", "states"),
    (GOSSIP, {"states_bytes": GOSSIP.states_bytes[:-4]}, "shape", "states"),
    (GOSSIP, {"states_bytes": GOSSIP.states_bytes[:-16]}, "shape", "ids"),
    (GOSSIP, {"claim_bytes": GOSSIP.claim_bytes[:-8]}, "shape", "claim"),
    (GOSSIP, {"detections_bytes": b"\0" * 9}, "shape", "detections"),
    (GOSSIP, {"ids_bytes": GOSSIP.ids_bytes[:-1]}, "shape", "ids"),
    (GOSSIP, {"ids_bytes": b""}, "shape", "ids"),
    (GOSSIP, {"claim_names": ("s1",)}, "shape", "claim_names"),
    (GOSSIP, {"claim_ages": b"\0"}, "shape", "claim_ages"),
    (GOSSIP, {"claim_names": ("s2", "s1")}, "sender", "claim_names"),
    (GOSSIP, {"claim_names": (), "claim_bytes": b""}, "shape", "states"),
    (GOSSIP, {"claim_tick": 8}, "range", "claim_tick"),
    (GOSSIP, {"claim_tick": 9}, "range", "claim_tick"),
    (GOSSIP, {"tick": 0, "claim_tick": 1}, "range", "claim_tick"),
    (GOSSIP, {"ids_bytes": pack(np.array([5, 5]), "<u8")}, "range", "ids"),
    (GOSSIP, {"ids_bytes": pack(np.array([6, 5]), "<u8")}, "range", "ids"),
    (GOSSIP, {"ids_bytes": pack(np.array([2**63, 2**63 - 1], dtype=np.uint64), "<u8")}, "range", "ids"),
    (GOSSIP, {"weight": -0.1}, "range", "weight"),
    (GOSSIP, {"weight": 500.1}, "range", "weight: the particles hold 1000.2 expected targets, at most 1000"),
    (
        GOSSIP,
        {"components_bytes": b"".join(pack(np.array([weight]), "<f4") + bytes(48) for weight in (500.0, 500.1))},
        "range",
        "components: they hold",
    ),
    (GOSSIP, {"power_radius": -1.0}, "range", "power_radius"),
    (GOSSIP, {"unused": -1.0}, "range", "unused"),
    (GOSSIP, {"unused": 1.1e12}, "range", "unused"),
    (GOSSIP, {"detections_bytes": bytes(8 * 8193)}, "size", "detections"),
    (GOSSIP, {"states_bytes": bytes(16 * 8193)}, "size", "states"),
    (GOSSIP, {"ids_bytes": bytes(8 * 8193)}, "size", "ids"),
    (GOSSIP, {"claim_bytes": bytes(24 * 8193)}, "size", "claim"),
    (BEACON, {"power_radius": -1.0}, "range", "power_radius"),
    (BEACON, {"reach": math.inf}, "range", "reach"),
    (HELLO, {"heard": ("s",) * 8193}, "size", "heard"),
    (ESTIMATE, {"mass": -1.0}, "range", "mass"),
    (ESTIMATE, {"round_seconds": math.nan}, "range", "round_seconds"),
    (TRUTH, {"time": -0.25}, "range", "time"),
    (TRUTH, {"time": 1.1e9}, "range", "time"),
    (TRUTH, {"targets_bytes": bytes(16)}, "shape", "target"),
    (TRUTH, {"bodies": ("s1",)}, "shape", "body"),
    (TRUTH, {"ids_bytes": b"\0"}, "shape", "ids"),
]


@pytest.mark.parametrize(
    ("message", "fields", "reason", "word"),
    BROKEN,
    ids=[f"{type(b[0]).__name__}-{next(iter(b[1]))}-{b[2]}-{n}" for n, b in enumerate(BROKEN)],
)
def test_each_rule_is_refused_with_its_reason_and_names_the_field(message: Message, fields: dict[str, Any], reason: str, word: str) -> None:
    with pytest.raises(Malformed, match=word) as caught:
        check(changed(message, **fields))
    assert caught.value.reason == reason


BAD_NUMBERS = [math.nan, math.inf, -math.inf, 1.1 * LARGEST_NUMBER, -1.1 * LARGEST_NUMBER]
NUMBERS = [
    (message, field)
    for message in (GOSSIP, BEACON, HELLO, OBSERVATION, COMMAND, ESTIMATE, TRUTH)
    for field in message.__struct_fields__
    if isinstance(getattr(message, field), float)
    or (isinstance(getattr(message, field), tuple) and field not in ("claim_names", "heard", "neighbours", "bodies", "alive"))
]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300, -1e300])
@pytest.mark.parametrize(("message", "field"), NUMBERS, ids=[f"{type(message).__name__}-{field}" for message, field in NUMBERS])
def test_no_number_of_any_message_may_be_nan_infinite_or_huge(message: Message, field: str, bad: float) -> None:
    value = getattr(message, field)
    for place in range(len(value)) if isinstance(value, tuple) else [None]:
        broken = bad if place is None else (*value[:place], bad, *value[place + 1 :])
        with pytest.raises(Malformed, match=field) as caught:
            check(changed(message, **{field: broken}))
        assert caught.value.reason == "range"


ARRAYS = [
    (GOSSIP, "detections_bytes", "<f4"),
    (GOSSIP, "claim_bytes", "<f8"),
    (GOSSIP, "states_bytes", "<f4"),
    (changed(OBSERVATION, detections_bytes=bytes(16)), "detections_bytes", "<f4"),
    (changed(ESTIMATE, cell_bytes=bytes(48)), "cell_bytes", "<f8"),
    (changed(ESTIMATE, targets_bytes=bytes(32)), "targets_bytes", "<f8"),
    (changed(TRUTH, targets_bytes=bytes(32), ids_bytes=bytes(16)), "targets_bytes", "<f8"),
    (changed(TRUTH, bodies=("s1",), poses_bytes=bytes(24)), "poses_bytes", "<f8"),
]


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("bad", [*BAD_NUMBERS, float(np.float32(1e38))])
@pytest.mark.parametrize(("message", "field", "dtype"), ARRAYS, ids=[f"{type(message).__name__}-{field}" for message, field, _ in ARRAYS])
def test_one_bad_number_anywhere_in_an_array_is_found(message: Message, field: str, dtype: str, bad: float) -> None:
    sound = np.frombuffer(getattr(message, field), dtype=dtype)
    check(message)
    for place in range(len(sound)):
        broken = sound.copy()
        broken[place] = bad
        with pytest.raises(Malformed, match="finite") as caught:
            check(changed(message, **{field: broken.tobytes()}))
        assert caught.value.reason == "range"


@pytest.mark.parametrize(
    ("edge", "accepted"),
    [
        (LARGEST_NUMBER, True),
        (-LARGEST_NUMBER, True),
        (float(np.nextafter(np.float32(LARGEST_NUMBER), np.float32(2e6))), False),
    ],
)
def test_the_bound_is_exact_also_where_the_sum_of_squares_is_too_large_to_tell(edge: float, accepted: bool) -> None:
    message = changed(OBSERVATION, detections_bytes=pack(np.array([[edge, 0.0], [edge, edge]]), "<f4"))
    if accepted:
        check(message)
    else:
        with pytest.raises(Malformed, match="detections"):
            check(message)


def test_a_full_sized_array_of_the_largest_allowed_numbers_passes() -> None:
    check(changed(OBSERVATION, detections_bytes=pack(np.full((4096, 2), LARGEST_NUMBER), "<f4")))


def test_an_error_never_repeats_a_long_name() -> None:
    with pytest.raises(Malformed) as caught:
        check(changed(GOSSIP, claim_names=("x" * 100_000, "s2")))
    assert len(str(caught.value)) < 200


def test_the_largest_time_is_that_of_the_longest_run_and_dates_and_recordings_hold_it() -> None:
    with pytest.raises(BadSetting, match="seconds"):
        resolve("quick", {"run.seconds": math.nextafter(LARGEST_TIME, math.inf)})
    assert resolve("quick", {"run.seconds": LARGEST_TIME}).run.seconds == LARGEST_TIME
    assert datetime(2026, 1, 1) + timedelta(seconds=LARGEST_TIME) < datetime.max and LARGEST_TIME * 1e9 < 2**63
