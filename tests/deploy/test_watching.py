"""Key expressions, what `echo` prints, the rates of `hz`, and the map of `watch`; without a network."""

import json
from collections.abc import Callable

import pytest

from deploy.field import swarm_map
from deploy.watching import Heard, Listener, Rates, block, expression, fields, plain_line
from protocol import codec
from protocol.messages import Command, Truth
from protocol.node import Alive, Received, Rejected, Started, Stop, Subscribe, Timer
from protocol.settings import BadSetting

COMMAND = Command(sender="s1", incarnation=1, tick=7, velocity=(1.0, 2.0), turn_rate=0.5)


def received(message: Command) -> Received:
    payload = codec.encode(message)
    return Received(message, len(payload), payload)


@pytest.mark.parametrize(
    ("text", "whole"),
    [
        ("truth", "covey/r/truth"),
        ("estimate/s3", "covey/r/estimate/s3"),
        ("gossip/*", "covey/r/gossip/*"),
        ("**", "covey/r/**"),
        ("covey/**", "covey/**"),
        ("**/s3", "**/s3"),
        ("/command/s1/", "covey/r/command/s1"),
        ("estimate/s$*", "covey/r/estimate/s$*"),
    ],
)
def test_a_key_is_meant_within_the_run_unless_it_says_otherwise(text: str, whole: str) -> None:
    assert expression(text, "r") == whole


@pytest.mark.parametrize("text", ["", "a//b", "a?b", "**/**", "x***", "a b", "#"])
def test_what_is_no_key_expression_is_refused(text: str) -> None:
    with pytest.raises(BadSetting, match="should be a key expression"):
        expression(text, "r")


def listener(go_on: Callable[[Heard, float], bool], seconds: float | None = None) -> Listener:
    return Listener("r", "echo-1", "covey/r/**", go_on, seconds)


def test_a_listener_hands_on_what_is_ours_and_what_is_not_and_stops_on_demand() -> None:
    heard: list[Heard] = []

    def on_heard(one: Heard, now: float) -> bool:
        heard.append(one)
        return len(heard) < 2

    node = listener(on_heard)
    assert node.handle(Started(), 0.0) == [Subscribe("covey/r/**")]
    assert node.deadline() is None
    assert node.handle(received(COMMAND), 1.0) == []
    assert node.handle(Rejected("x", "key", "covey/r/strange/x", b"\x01"), 2.0) == [Stop(0, "enough")]
    assert heard[0] == Heard("covey/r/command/s1", codec.encode(COMMAND), COMMAND, "")
    assert heard[1] == Heard("covey/r/strange/x", b"\x01", None, "key")


def test_a_listener_stops_when_its_time_is_up_and_knows_who_is_there() -> None:
    node = listener(lambda heard, now: True, 2.0)
    node.handle(Started(), 10.0)
    node.handle(Alive("agent", "s1", 4), 10.5)
    assert node.deadline() == 12.0
    assert node.handle(Timer(), 12.0) == [Stop(0, "time is up")]
    assert node.tokens == {("agent", "s1", 4)}


def test_a_known_message_is_printed_as_json_with_its_arrays_spelled_out() -> None:
    truth = Truth(sender="world", incarnation=1, tick=3, time=0.75, bodies=("s1",), poses_bytes=bytes(24))
    line = json.loads(plain_line(Heard("covey/r/truth", b"", truth, "")))
    assert (line["key"], line["type"], line["tick"]) == ("covey/r/truth", "truth", 3)
    assert (line["poses"], line["targets"]) == ([[0.0, 0.0, 0.0]], [])
    assert "poses_bytes" not in line


def test_an_unknown_message_is_printed_raw_and_unpacked_where_it_is_msgpack() -> None:
    line = json.loads(plain_line(Heard("a/b", b"\x81\xa1x\x05", None, "key")))
    assert (line["unknown"], line["bytes"], line["raw"], line["msgpack"]) == ("key", 4, "81a17805", {"x": 5})
    assert "msgpack" not in json.loads(plain_line(Heard("a/b", b"\xc1\xff", None, "key")))
    assert "c1 ff" in block(Heard("a/b", b"\xc1\xff", None, "format"))


def test_long_arrays_are_cut_in_a_terminal() -> None:
    text = block(
        Heard("k", b"", Truth(sender="world", incarnation=1, tick=3, time=0.75, ids_bytes=bytes(80), targets_bytes=bytes(160)), "")
    )
    assert "10 rows: 0, 0, 0, 0, 0, 0, ..." in text
    assert fields(COMMAND)["velocity"] == (1.0, 2.0)


def test_rates_are_messages_per_second_the_longest_gap_and_the_mean_size() -> None:
    rates = Rates()
    for now in (0.0, 0.5, 1.0, 2.0):
        assert rates.note(Heard("covey/r/gossip/s10", b"1234", None, ""), now)
    rates.note(Heard("covey/r/gossip/s9", b"12", None, ""), 2.0)
    assert rates.rows() == [("covey/r/gossip/s9", None, None, 2.0), ("covey/r/gossip/s10", 1.5, 1.0, 4.0)]


SWARM = {"arena": (20.0, 10.0), "places": [[0.1, 9.9], [10.0, 5.0]], "estimates": [[10.0, 5.0], [19.9, 0.1]]}


def test_the_map_has_north_up_and_marks_targets_estimates_and_bodies() -> None:
    rows = [
        {"name": "s12", "state": "running", "pose": [5.0, 2.0, 1.5707]},
        {"name": "s3", "state": "dead", "pose": [15.0, 8.0, 0.0]},
        {"name": "world", "state": "running"},
    ]
    lines = swarm_map(SWARM, rows, 20).plain.splitlines()
    assert lines[1][1] == "o"
    assert lines[-2][-2] == "x"
    assert sum(line.count("*") for line in lines[:-1]) == 1
    assert any("↑12" in line for line in lines)
    assert any("+3" in line for line in lines)
    assert len({len(line) for line in lines[:-1]}) == 1


def test_there_is_no_map_where_there_is_no_room_and_who_is_outside_stands_at_the_border() -> None:
    assert swarm_map(SWARM, [], 5).plain == ""
    outside = [{"name": "s1", "state": "running", "pose": [-3.0, 99.0, 0.0]}]
    assert swarm_map({**SWARM, "places": []}, outside, 20).plain.splitlines()[1][1] == "→"
