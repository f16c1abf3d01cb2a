"""docs/reference/protocol.md against the bytes: plain msgpack and struct read every kind, and the tables of the page are the schema.

Nothing of ours is used to read a message; the encoder writes it. A second group of tests holds the limits, defaults and required
fields of the page against our decoder, so that the page cannot go stale.
"""

import inspect
import json
import math
import re
import struct
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import msgspec
import pytest

from agents.agent import Agent
from agents.membership.peer_table import OWN, UNASKED, UNKNOWN_SENSOR, PeerTable
from protocol.codec import decode, encode
from protocol.fields import Malformed
from protocol.keys import message_key
from protocol.live import session_config
from protocol.message import WIRE_VERSION, Message
from protocol.messages import KINDS, Beacon, BodyPose, Command, Gossip, Halt, Hello, Observation
from protocol.observer_messages import Estimate, Truth
from protocol.reception import Reception
from protocol.sensing import WedgeSensor
from protocol.settings import NetworkSettings

PAGE = (Path(__file__).parents[1] / "docs" / "reference" / "protocol.md").read_text(encoding="utf-8")
LETTERS = {"float32": "f", "float64": "d", "uint64": "Q"}


class Row(NamedTuple):
    """One line of a field table."""

    field: str
    type: str
    unit: str
    default: str
    limits: str
    meaning: str


def tables(heading: str) -> list[list[Row]]:
    """The field tables under a heading of the page."""
    section = re.search(rf"^### {re.escape(heading)}\n(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert section, f"docs/reference/protocol.md has no section {heading!r}"
    found: list[list[Row]] = []
    for line in section[1].splitlines():
        if line.startswith("| field |"):
            found.append([])
        elif line.startswith("| `"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            assert len(cells) == len(Row._fields), f"{heading}: {line}"
            found[-1].append(Row(cells[0].strip("`"), *cells[1:]))
    return found


COMMON = tables("Fields of every message")[0]
FIELDS = {kind: [*COMMON, *tables(kind)[0]] for kind in KINDS}
SENSOR = tables("hello")[1]
CASES = [(kind, row) for kind, rows in FIELDS.items() for row in rows]

FULL: dict[str, Message] = {
    "hello": Hello(
        sender="s1",
        incarnation=7,
        role="monitor",
        software="x 1",
        sensor_class="A",
        sensor=WedgeSensor(1.5, 8.0, 0.9),
        heard=("s2",),
        neighbours_only=True,
        settings={"arena": {"width": 40.0}, "filter": {"seed": 7, "border": "cross"}, "birth": {"background": True}},
    ),
    "beacon": Beacon(
        sender="s1",
        incarnation=7,
        tick=3,
        position=(1.0, 2.0),
        cod=(1.5, 2.5),
        power_radius=2.0,
        reach=8.0,
        column=4,
        row=5,
        sensor_class="A",
        sensor=WedgeSensor(1.5, 8.0, 0.9),
        asks=True,
        settings=2**62 + 1,
        widest_reach=25.0,
        widest_offset=7.0,
        widest_radius=20.5,
    ),
    "gossip": Gossip(
        sender="s1",
        incarnation=7,
        tick=3,
        pose=(1.0, 2.0, 0.5),
        cod=(1.5, 2.5),
        power_radius=2.0,
        unused=12.0,
        detections_bytes=struct.pack("<2f", 1.25, -2.5),
        scanned=False,
        listening=True,
        claim_tick=2,
        claim_names=("s1", "s2"),
        claim_bytes=struct.pack("<6d", 1.5, 2.5, 2.0, 9.1, 8.1, 1.0),
        diagram_hash=2**62 + 1,
        weight=0.25,
        states_bytes=struct.pack("<8f", 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0),
        ids_bytes=struct.pack("<2Q", 5, 2**64 - 1),
        components_bytes=struct.pack("<3f12e2Q", 0.5, *range(2), *range(12), 6, 2**53 - 1),
        labels_bytes=struct.pack("<2Q", 3, 2**53 - 1),
        label_numbers_bytes=b"\1\0",
        goal=(3.5, -4.5),
        goal_utilisation=0.75,
        pace=2,
        behind=1,
        lag=2,
        pose_noise=(0.25, 0.125),
        claim_ages=b"\0\3",
    ),
    "observation": Observation(
        sender="world",
        incarnation=7,
        recipient="s1",
        tick=3,
        time=0.75,
        pose=(1.0, 2.0, 0.5),
        detections_bytes=struct.pack("<2f", 1.25, -2.5),
        obstacles_bytes=struct.pack("<2d", 3.0, 4.0),
        scanned=False,
    ),
    "pose": BodyPose(sender="s1", incarnation=7, tick=3, pose=(1.0, 2.0, 0.5)),
    "command": Command(sender="s1", incarnation=7, tick=3, velocity=(1.5, -0.5), turn_rate=0.25),
    "estimate": Estimate(
        sender="s1",
        incarnation=7,
        tick=3,
        pose=(1.0, 2.0, 0.5),
        cod=(1.5, 2.5),
        power_radius=2.0,
        unused=12.0,
        load=0.5,
        mass=1.5,
        cell_bytes=struct.pack("<6d", 0.0, 0.0, 1.0, 0.0, 0.0, 1.0),
        targets_bytes=struct.pack("<2d", 0.1, 0.2),
        details_bytes=struct.pack("<6f", 1.0, 2.0, 0.5, 0.25, 0.75, 0.5),
        labels_bytes=struct.pack("<Q", 2**53 - 1),
        diagram_hash=2**62 + 1,
        neighbours=("s2",),
        counters={"rounds": 4},
        round_seconds=0.001,
        pace=2,
    ),
    "halt": Halt(sender="operator-7", incarnation=7, held=True),
    "truth": Truth(
        sender="world",
        incarnation=7,
        tick=3,
        time=0.75,
        targets_bytes=struct.pack("<2d", 0.1, 0.2),
        ids_bytes=struct.pack("<Q", 9),
        bodies=("s1",),
        poses_bytes=struct.pack("<3d", 1.0, 2.0, 0.5),
        in_view=1,
        alive=("s1",),
    ),
}


def plain(kind: str) -> dict[str, Any]:
    """The full message of a kind, as a stranger reads it."""
    found = msgpack.unpackb(encode(FULL[kind]))
    assert isinstance(found, dict)
    return found


def compact() -> dict[str, Any]:
    """The full gossip with its particles in few bytes."""
    found = msgpack.unpackb(encode(msgspec.structs.replace(FULL["gossip"], particles=bytes(16 + 2 * 6))))
    assert isinstance(found, dict)
    return found


def columns(row: Row) -> tuple[int, str] | None:
    """Columns and struct letter of an array, None for other types."""
    match = re.fullmatch(r"rows of (\d) (float32|float64|uint64)", row.type)
    return (int(match[1]), LETTERS[match[2]]) if match else None


def is_of_type(value: Any, row: Row) -> bool:
    """Whether a value that msgpack has read is what the page says."""
    array = columns(row)
    if array:
        return type(value) is bytes and len(value) % struct.calcsize(f"<{array[0]}{array[1]}") == 0
    packed = re.fullmatch(r"rows of (\d+) bytes", row.type)
    if packed:
        return type(value) is bytes and len(value) % int(packed[1]) == 0
    several = re.fullmatch(r"(\d) numbers( or nil)?", row.type)
    if several:
        return type(value) is list and len(value) == int(several[1]) and all(type(part) is float for part in value)
    plain_types = {"text": str, "integer": int, "number": float, "boolean": bool, "bytes": bytes}
    if row.type in plain_types:
        return type(value) is plain_types[row.type]
    if row.type == "name":
        return type(value) is str and re.fullmatch(r"[A-Za-z0-9_.-]{1,64}", value) is not None
    if row.type == "list of texts":
        return type(value) is list and all(type(part) is str for part in value)
    if row.type == "map of texts to integers":
        return type(value) is dict and all(type(name) is str and type(count) is int for name, count in value.items())
    if row.type == "map of sections":
        settings = [setting for section in value.values() for setting in section.values()]
        return all(type(setting) in (bool, int, float, str) for setting in settings)
    if row.type == "wedge or nil":
        return value is None or (
            list(value) == [part.field for part in SENSOR] and all(is_of_type(value[part.field], part) for part in SENSOR)
        )
    raise AssertionError(f"the page knows no type {row.type!r}")


def refusal(kind: str, fields: dict[str, Any]) -> str | None:
    """The reason for which our decoder refuses a map that plain msgpack has written; None when it takes it."""
    try:
        decode(message_key("demo", FULL[kind]), msgpack.packb(fields))
    except Malformed as error:
        return error.reason
    return None


def same_length(kind: str, field: str, rows: int) -> dict[str, Any]:
    """The full message with `rows` rows in an array, and just as many in the field that must be as long."""
    groups = [{"states", "ids", "label_numbers"}, {"claim", "claim_names", "claim_ages"}, {"targets", "details", "labels"}]
    if kind == "truth":
        groups = [{"targets", "ids"}, {"poses", "bodies"}]
    if kind == "gossip" and field == "labels":  # so many that each particle names its own with two bytes
        return {**plain(kind), "labels": struct.pack(f"<{rows}Q", *range(rows)), "label_numbers": struct.pack("<2H", 0, rows - 1)}
    message = plain(kind)
    if kind == "gossip":
        message["weight"] = 0.1  # all particles together hold at most 1000 expected targets
    for name in next((group for group in groups if field in group), {field}):
        row = next(row for row in FIELDS[kind] if row.field == name)
        array = columns(row)
        if name == "ids":
            message[name] = struct.pack(f"<{rows}Q", *range(rows))
        elif array or row.type == "bytes":
            message[name] = bytes(struct.calcsize(f"<{array[0]}{array[1]}") * rows if array else rows)
        else:
            message[name] = ["s1"] * rows
    return message


def test_the_page_describes_every_kind_and_no_other() -> None:
    assert re.findall(r"^### ([a-z]+)$", PAGE, re.MULTILINE) == list(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_message_holds_just_the_fields_of_the_page_in_its_order(kind: str) -> None:
    rows = [row.field for row in FIELDS[kind]]
    assert list(plain(kind)) == [field for field in rows if field != "particles"]
    if kind == "gossip":
        assert list(compact()) == [field for field in rows if field not in ("states", "ids")]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_not_given_is_left_out_but_the_kind_and_the_version_are_said(kind: str) -> None:
    needed = [row.field for row in FIELDS[kind] if row.default == "required"]
    bare = decode(message_key("demo", FULL[kind]), msgpack.packb({name: plain(kind)[name] for name in needed}))
    assert list(msgpack.unpackb(encode(bare))) == [row.field for row in FIELDS[kind] if row.field in (*needed, "type", "wire")]


@pytest.mark.parametrize(("kind", "row"), CASES, ids=[f"{kind}-{row.field}" for kind, row in CASES])
def test_every_field_has_the_type_of_the_page(kind: str, row: Row) -> None:
    value = (compact() if row.field == "particles" else plain(kind))[row.field]
    assert is_of_type(value, row), f"{row.field} = {value!r} is no {row.type}"


@pytest.mark.parametrize("kind", KINDS)
def test_every_example_differs_from_the_defaults_so_that_each_field_is_really_written(kind: str) -> None:
    by_default = {"type", "wire", "scanned", "particles"}  # the default of `scanned` is true; the last takes the place of states and ids
    for row in FIELDS[kind]:
        if row.default != "required" and row.field not in by_default:
            assert plain(kind)[row.field] not in ("", 0, 0.0, False, None, [], {}, b"")


def test_arrays_are_little_endian_row_by_row_to_anybody_with_a_struct_module() -> None:
    message = plain("gossip")
    assert struct.unpack("<2f", message["detections"]) == (1.25, -2.5)
    assert struct.unpack("<6d", message["claim"]) == (1.5, 2.5, 2.0, 9.1, 8.1, 1.0)
    assert struct.unpack("<8f", message["states"]) == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
    assert struct.unpack("<2Q", message["ids"]) == (5, 2**64 - 1)
    assert message["detections"] == bytes.fromhex("0000a03f000020c0")


@pytest.mark.parametrize("kind", KINDS)
def test_what_plain_msgpack_writes_is_taken_in_any_order_of_fields(kind: str) -> None:
    message = plain(kind)
    assert refusal(kind, dict(reversed(message.items()))) is None


@pytest.mark.parametrize(("kind", "row"), CASES, ids=[f"{kind}-{row.field}" for kind, row in CASES])
def test_a_required_field_must_be_there_and_any_other_may_be_left_out_for_its_default(kind: str, row: Row) -> None:
    if row.default == "required":
        assert refusal(kind, {name: value for name, value in plain(kind).items() if name != row.field}) == "format"
        return
    needed = {other.field: plain(kind)[other.field] for other in FIELDS[kind] if other.default == "required"}
    spoken = {
        "the kind of the key": kind,
        "empty": {} if row.type.startswith("map") else b"" if row.type.startswith("rows") or row.type == "bytes" else [],
        "nil": None,
        "true": True,
        "false": False,
        '""': "",
    }
    bare = decode(message_key("demo", FULL[kind]), msgpack.packb(needed))
    default = spoken[row.default] if row.default in spoken else row.default.strip('"') if row.type == "name" else float(row.default)
    assert bare == decode(
        message_key("demo", FULL[kind]), msgpack.packb({**needed, row.field: int(default) if row.type == "integer" else default})
    )


@pytest.mark.parametrize(("kind", "row"), CASES, ids=[f"{kind}-{row.field}" for kind, row in CASES])
def test_the_limits_of_the_page_are_those_of_the_decoder(kind: str, row: Row) -> None:
    low_high = re.search(r"([\de.+-]+) to ([\de.+-]+)", row.limits)
    around = re.search(r"±([\de.+-]+)", row.limits)
    most = re.search(r"at most (\d+)", row.limits)
    if row.type == "integer" and low_high:
        low, high = int(low_high[1]), int(low_high[2])
        assert refusal(kind, {**plain(kind), row.field: low - 1}) == refusal(kind, {**plain(kind), row.field: high + 1}) == "range"
        assert refusal(kind, {**plain(kind), row.field: high}) in (
            None,
            "range",
            "sender",
        )  # a claim later than its tick; a tile not of the key
    elif row.type == "number":
        low, high = (
            (float(low_high[1]), float(low_high[2]))
            if low_high
            else (-float(around[1]), float(around[1]))
            if around
            else (math.nan, math.nan)
        )
        inside = same_length(kind, "ids", 0) if row.field == "weight" else plain(kind)  # without particles: they have a limit together
        assert [refusal(kind, {**inside, row.field: value}) for value in (low, high)] == [None, None]
        outside = [math.nextafter(low, -math.inf), math.nextafter(high, math.inf), math.nan, math.inf, -math.inf]
        assert [refusal(kind, {**plain(kind), row.field: value}) for value in outside] == ["range"] * 5
    elif re.fullmatch(r"\d numbers( or nil)?", row.type):
        assert low_high or around
        bound = float(low_high[2] if low_high else around[1])  # type: ignore[index]
        least = float(low_high[1]) if low_high else -bound
        count = int(row.type[0])
        assert refusal(kind, {**plain(kind), row.field: [bound] * count}) is None
        assert refusal(kind, {**plain(kind), row.field: [least] * count}) is None
        for place in range(count):
            for value in (math.nextafter(bound, math.inf), math.nextafter(least, -math.inf), math.nan, -math.inf):
                assert refusal(kind, {**plain(kind), row.field: [0.0] * place + [value] + [0.0] * (count - place - 1)}) == "range"
        assert refusal(kind, {**plain(kind), row.field: [0.0] * (count + 1)}) == "format"
    elif columns(row):
        width, letter = columns(row) or (0, "")
        assert most is not None and (around is not None) == (letter != "Q")
        assert refusal(kind, same_length(kind, row.field, int(most[1]))) is None
        too_many = plain(kind)
        too_many[row.field] = bytes(struct.calcsize(f"<{width}{letter}") * (int(most[1]) + 1))
        assert refusal(kind, too_many) == "size"
        assert refusal(kind, {**plain(kind), row.field: plain(kind)[row.field][:-1]}) == "shape"
        if around:
            bad = struct.pack(f"<{width}{letter}", *[2.0 * float(around[1])] * width)
            assert refusal(kind, {**same_length(kind, row.field, 1), row.field: bad}) == "range"
    elif row.field == "components":
        size, row_bytes = int(row.type.split()[2]), plain(kind)[row.field]
        assert most is not None and refusal(kind, {**plain(kind), row.field: bytes(size * (int(most[1]) + 1))}) == "size"
        assert refusal(kind, {**plain(kind), row.field: row_bytes[:-1]}) == "shape"
        assert refusal(kind, {**plain(kind), row.field: row_bytes * 2}) == "range"  # ids that do not ascend
        right, nan, inf = (0.5, 1.0e6, 2.0, 3.0, 2**53 - 1), math.nan, math.inf
        wrongs: list[tuple[int, Any]] = [
            (0, -0.5),
            (0, 2.0e6),
            (0, nan),
            (1, 2.0e6),
            (1, nan),
            (2, inf),
            (2, nan),
            (3, -inf),
            (3, nan),
            (4, 2**53),
        ]
        for values in (right, *([*right[:place], wrong, *right[place + 1 :]] for place, wrong in wrongs)):
            weight, place, velocity, factor, label = values
            stated = struct.pack("<3f12e2Q", weight, *[place] * 2, *[velocity] * 2, *[factor] * 10, 6, label)
            assert refusal(kind, {**plain(kind), row.field: stated}) == (None if values is right else "range")
    elif row.field == "claim_ages":
        lengths = [refusal(kind, {**plain(kind), row.field: bytes(length)}) for length in range(4)]
        assert lengths == [None, "shape", None, "shape"] and len(plain(kind)["claim_names"]) == 2
    elif row.type == "bytes":
        assert [refusal(kind, {**plain(kind), row.field: value}) for value in (b"\1", b"\1\2", b"\1\0\0", bytes(16385))] == ["shape"] * 4
    elif row.type == "name":
        assert [refusal(kind, {**plain(kind), row.field: value}) for value in ("", "a b", "x" * 65, "x\n", "a/b")] == ["format"] * 5
    elif row.type == "list of texts" and most:
        assert refusal(kind, {**plain(kind), row.field: ["s1"] * (int(most[1]) + 1)}) in ("size", "shape")  # shape: the array is shorter
    else:
        assert row.type in ("text", "integer", "boolean", "list of texts", "map of texts to integers", "map of sections", "wedge or nil")


@pytest.mark.parametrize("row", SENSOR, ids=lambda row: row.field)
def test_the_limits_of_a_wedge_are_those_of_the_page(row: Row) -> None:
    low_high = re.fullmatch(r"(more than 0|[\de.+-]+) to ([\de.+-]+)", row.limits)
    assert low_high is not None
    high = float(low_high[2])
    low = 5e-324 if low_high[1] == "more than 0" else float(low_high[1])

    def with_value(value: float) -> str | None:
        return refusal("hello", {**plain("hello"), "sensor": {**plain("hello")["sensor"], row.field: value}})

    assert [with_value(low), with_value(high)] == [None, None]
    beyond = math.nextafter(low, 0.0), -1.0, math.nextafter(high, math.inf), math.nan, math.inf
    assert [with_value(value) for value in beyond] == ["format"] * 5
    assert (
        refusal(
            "hello", {**plain("hello"), "sensor": {name: value for name, value in plain("hello")["sensor"].items() if name != row.field}}
        )
        == "format"
    )


def test_a_probability_at_the_far_edge_is_read_as_the_page_says() -> None:
    """It may be missing, lies in (0, `prob_detection`], and is the one at `radius`; halfway there is the mean of both."""

    def hello(far: float) -> dict[str, Any]:
        return {**plain("hello"), "sensor": {**plain("hello")["sensor"], "prob_detection_far": far}}

    assert "The map may also hold `prob_detection_far`, more than 0 to `prob_detection`" in PAGE
    assert [refusal("hello", hello(far)) for far in (0.1, 0.9, 0.0, math.nextafter(0.9, 1.0), math.nan)] == [None, None, *["format"] * 3]
    assert "prob_detection_far" not in plain("hello")["sensor"]
    said = Hello(sender="s1", incarnation=7, sensor=WedgeSensor(1.5, 8.0, 0.9, None, 0.25))
    assert msgpack.unpackb(encode(said))["sensor"] == {**plain("hello")["sensor"], "prob_detection_far": 0.25}


def test_the_limits_of_settings_are_those_of_the_page() -> None:
    row = next(row for row in FIELDS["hello"] if row.field == "settings")
    most, value_size, largest = (float(number) for number in re.findall(r"\d[\de+]*", row.limits))

    def with_settings(settings: dict[str, Any]) -> str | None:
        return refusal("hello", {**plain("hello"), "settings": settings})

    assert with_settings({"a": {"b": "x" * int(most - 2)}}) is None and with_settings({"a": {"b": "x" * int(most - 1)}}) == "size"
    full = {"x" * int(most - value_size - 1): {"b": 1.5}}
    assert with_settings(full) is None and with_settings({**full, "a": {}}) == "size"
    assert with_settings({"a": {"b": -largest}}) is None and with_settings({"a": {"b": math.nextafter(largest, math.inf)}}) == "range"
    assert row.limits.endswith("any integer") and with_settings({"a": {"b": 2**63 - 1}}) is None  # filter.seed is as large


def test_the_version_and_the_size_limit_of_the_page_are_those_of_the_code() -> None:
    assert f"`wire` is the version of this page: **{WIRE_VERSION}**" in PAGE
    assert "more than 524288 bytes" in PAGE
    for kind in KINDS:
        assert refusal(kind, {**plain(kind), "wire": WIRE_VERSION + 1}) == "version"
        assert refusal(kind, {**plain(kind), "padding": b"\0" * 524288}) == "size"
        assert refusal(kind, {**plain(kind), "padding": b"\0" * 250000}) is None


def test_the_keys_of_the_page_are_those_of_the_code() -> None:
    rows = re.findall(r"^\| `(covey/[^`]+)`", PAGE, re.MULTILINE)
    said = {key.replace("<run>", "demo").replace("<agent>", "s1").replace("<column>/<row>", "4/5") for key in rows if "/alive/" not in key}
    assert said == {message_key("demo", message) for message in FULL.values()}
    assert "covey/<run>/alive/<role>/<name>/<incarnation>" in rows


def test_the_page_gives_every_reason_for_which_an_agent_refuses_a_gossip() -> None:
    listed = re.findall(r"^\| `(\w+)` \|", PAGE.partition("### When a gossip counts")[2].partition("\n## ")[0], re.MULTILINE)
    source = inspect.getsource(PeerTable._judge).partition('"""')[2].partition('"""')[2]
    assert set(listed) == {OWN, UNASKED, UNKNOWN_SENSOR, *re.findall(r'"(\w+)"', source)} and len(listed) == len(set(listed))


def test_the_page_gives_every_other_reason_that_an_agent_counts() -> None:
    text = PAGE.partition("Beside the reasons of this page an agent counts")[2].partition("\n\n")[0]
    hello = set(re.findall(r'return "(\w+)"', inspect.getsource(PeerTable.take_hello)))
    own = set(re.findall(r'"rejected\.(\w+)"', inspect.getsource(Agent)))
    quarantined = set(re.findall(r'Rejected\([^"\n]+"/"[^"\n]+"(\w+)"', inspect.getsource(Reception)))
    assert set(re.findall(r"`(?:rejected\.)?(\w+)`", text)) == hello | own | quarantined and len(hello | own | quarantined) == 5


def test_the_example_in_bytes_is_what_the_encoder_writes() -> None:
    lines = re.findall(r"^    ([0-9a-f ]+?)(?: {2,}.*)?$", PAGE.partition("## A message in bytes")[2], re.MULTILINE)
    example = Command(sender="s3", incarnation=7, tick=12, velocity=(1.5, -0.5), turn_rate=0.25)
    assert bytes.fromhex("".join(lines)) == encode(example)


@pytest.mark.parametrize(
    ("line", "key", "value"),
    [
        ("| mode | `peer` |", "mode", "peer"),
        ("| multicast scouting | off |", "scouting/multicast/enabled", False),
        ("| gossip scouting | on, `greater-zid` dials |", "scouting/gossip/enabled", True),
        ("| gossip scouting | on, `greater-zid` dials |", "scouting/gossip/autoconnect_strategy/peer/to_peer", "greater-zid"),
        ("| connect endpoints | the seeds of `[network] seeds`, for ever, every 0.2 to 1 s |", "connect/timeout_ms", -1),
        ("| connect endpoints | the seeds of `[network] seeds`, for ever, every 0.2 to 1 s |", "connect/retry/period_init_ms", 200),
        ("| connect endpoints | the seeds of `[network] seeds`, for ever, every 0.2 to 1 s |", "connect/retry/period_max_ms", 1000),
        ("| lease | 5 s, 4 keep-alives |", "transport/link/tx/lease", 5000),
        ("| lease | 5 s, 4 keep-alives |", "transport/link/tx/keep_alive", 4),
        ("| timeout of the handshake | 60 s; 15 s where all endpoints are `udp/` |", "transport/unicast/open_timeout", 60000),
        ("| largest message | 524288 bytes |", "transport/link/rx/max_message_size", 524288),
        ("| shared memory | off |", "transport/shared_memory/enabled", False),
    ],
)
def test_the_zenoh_settings_of_the_page_are_those_of_our_sessions(line: str, key: str, value: Any) -> None:
    assert line in PAGE
    found: Any = json.loads(str(session_config(NetworkSettings())))
    for part in key.split("/"):
        found = found[part]
    assert found == value
