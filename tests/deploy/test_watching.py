"""Key expressions, what `echo` prints, the rates of `hz`, the map of `watch`, and a recorder that hears nothing; without a swarm."""

import json
import signal
import socket
import struct
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
import zenoh

from deploy.cli import listen
from deploy.cli.listen import rates_table, record
from deploy.cli.listener import LOOK, SILENCE, KeyedPayload, Listener, Rates, expression, kinds, lies_in
from deploy.cli.message_text import block, fields, plain_line
from deploy.cli.terminal import table_console
from deploy.cli.terminal_map import swarm_map
from deploy.scenario import resolve, toml_text
from deploy.storage.run_directory import RunDirectory
from protocol import codec
from protocol.message import Message
from protocol.messages import Command
from protocol.node import Alive, Rejected, Started, Stop, Subscribe, Timer, Unsubscribe, received
from protocol.observer_messages import Truth
from protocol.settings import BadSetting
from tests.protocol.samples import GOSSIP, GOSSIP_BYTES, GOSSIP_KEY, SAMPLES, altered

COMMAND = Command(sender="s1", incarnation=1, tick=7, velocity=(1.0, 2.0), turn_rate=0.5)


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


def listener(go_on: Callable[[KeyedPayload, float], bool], seconds: float | None = None) -> Listener:
    return Listener("r", "echo-1", "covey/r/**", go_on, seconds)


def test_a_listener_hands_on_what_is_ours_and_what_is_not_and_stops_on_demand() -> None:
    heard: list[KeyedPayload] = []

    def on_heard(one: KeyedPayload, now: float) -> bool:
        heard.append(one)
        return len(heard) < 2

    node = listener(on_heard)
    assert node.handle(Started(), 0.0) == [Subscribe("covey/r/**")]
    assert node.deadline() is None
    assert node.handle(received(COMMAND, payloads=[codec.encode(COMMAND)]), 1.0) == []
    assert node.handle(Rejected("x", "key", "covey/r/strange/x", b"\x01"), 2.0) == [Stop(0, "enough")]
    assert heard[0] == KeyedPayload("covey/r/command/s1", codec.encode(COMMAND), COMMAND, "")
    assert heard[1] == KeyedPayload("covey/r/strange/x", b"\x01", None, "key")


def test_a_listener_that_has_heard_enough_hears_no_more_of_what_came_together() -> None:
    heard: list[KeyedPayload] = []

    def on_heard(one: KeyedPayload, now: float) -> bool:
        heard.append(one)
        return len(heard) < 2

    node = listener(on_heard)
    node.handle(Started(), 0.0)
    assert node.handle(received(COMMAND, COMMAND, COMMAND, payloads=[codec.encode(COMMAND)] * 3), 1.0) == [Stop(0, "enough")]
    assert len(heard) == 2


def test_an_outside_recorder_that_hears_nothing_leaves_no_recording_behind(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        listen = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        run = tmp_path / "run.toml"
        run.write_text(toml_text(resolve("quick", {"network.seeds": ["tcp/127.0.0.1:1"], "network.listen": [listen]})))
        with pytest.raises(BadSetting, match="the port is in use"):
            record(tmp_path / "one.mcap", str(run))
    assert [path.name for path in tmp_path.iterdir()] == ["run.toml"]


def test_echo_and_hz_end_with_the_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A pipe behind `covey echo` waited for ever once the run was over."""
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path))
    monkeypatch.setattr(listen, "LOOK_PERIOD", 0.01)
    monkeypatch.setattr(listen, "swarm_to_watch", lambda run: (RunDirectory("over"), resolve("quick", {"run.name": "over"})))

    def too_late(*_: object) -> None:
        raise TimeoutError("it listens on")

    before = signal.signal(signal.SIGALRM, too_late)
    signal.alarm(20)
    try:
        assert listen.echo("truth", None, None) == 0
        assert listen.hz("**", None, None) == 0
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_a_listener_stops_when_its_time_is_up_and_knows_who_is_there() -> None:
    node = listener(lambda heard, now: True, 2.0)
    node.handle(Started(), 10.0)
    node.handle(Alive("agent", "s1", 4), 10.5)
    assert node.deadline() == 12.0
    assert node.handle(Timer(), 12.0) == [Stop(0, "time is up")]
    assert node.tokens == {("agent", "s1", 4)}


def silent(wanted: str, heard: list[KeyedPayload], told: list[list[str]]) -> Listener:
    def on_heard(one: KeyedPayload, now: float) -> bool:
        heard.append(one)
        return True

    return Listener("r", "echo-1", wanted, on_heard, on_silence=told.append)


def test_after_a_silence_a_listener_looks_where_something_is_said_tells_it_once_and_listens_on() -> None:
    heard: list[KeyedPayload] = []
    told: list[list[str]] = []
    node = silent("covey/r/nothing", heard, told)
    assert node.handle(Started(), 1.0) == [Subscribe("covey/r/nothing")]
    assert node.deadline() == 1.0 + SILENCE
    everything = "covey/r/**"
    assert node.handle(Timer(), 1.0 + SILENCE) == [Unsubscribe("covey/r/nothing"), Subscribe(everything)]
    assert node.handle(received(COMMAND), 4.5) == [] and told == []
    assert node.handle(Timer(), 1.0 + SILENCE + LOOK) == [Subscribe("covey/r/nothing"), Unsubscribe(everything)]
    assert told == [["covey/r/command/s1"]] and node.deadline() is None
    assert node.handle(received(COMMAND), 6.5) == [] and heard == [], "what was on its way is not what was asked for"
    assert node.handle(Rejected("x", "kind", "covey/r/nothing", b""), 7.0) == []
    assert [one.key for one in heard] == ["covey/r/nothing"]


def test_what_is_wanted_and_comes_while_it_looks_is_handed_on_and_nothing_is_told() -> None:
    heard: list[KeyedPayload] = []
    told: list[list[str]] = []
    node = silent("covey/r/command/*", heard, told)
    node.handle(Started(), 0.0)
    node.handle(Timer(), SILENCE)
    assert node.handle(received(COMMAND), SILENCE + 0.5) == [Subscribe("covey/r/command/*"), Unsubscribe("covey/r/**")]
    assert len(heard) == 1 and told == [] and node.deadline() is None


def test_whoever_hears_something_in_time_is_told_nothing_and_silence_under_all_keys_needs_no_look() -> None:
    told: list[list[str]] = []
    node = silent("covey/r/command/*", [], told)
    node.handle(Started(), 0.0)
    node.handle(received(COMMAND), 1.0)
    assert node.deadline() is None
    node = silent("covey/r/**", [], told)
    node.handle(Started(), 0.0)
    assert node.handle(Timer(), SILENCE) == [] and told == [[]]


@pytest.mark.parametrize(
    "wanted", ["covey/r/estimate/s3", "covey/r/*/s3", "covey/**", "**/s3", "covey/r/estimate/$*3", "covey/**/estimate/*"]
)
def test_a_key_lies_in_an_expression_or_not(wanted: str) -> None:
    keys = ["covey/r/estimate/s3", "covey/r/truth", "covey/r/estimate/s4", "covey/r/beacon/1/2/s5"]
    inside = [lies_in(wanted, key) for key in keys]
    assert inside == ([True] * 4 if wanted == "covey/**" else [True, False, wanted.endswith("estimate/*"), False])
    assert inside == [zenoh.KeyExpr(wanted).intersects(zenoh.KeyExpr(key)) for key in keys]


def test_keys_are_named_by_kind() -> None:
    keys = ["covey/r/truth", "covey/r/gossip/s1", "covey/r/gossip/s2", "covey/r/beacon/3/4/s1"]
    assert kinds(keys) == kinds(["covey/r", *keys]) == "beacon/** (1 key), gossip/** (2 keys), truth"


def test_a_known_message_is_printed_as_json_with_its_arrays_spelled_out() -> None:
    truth = Truth(sender="world", incarnation=1, tick=3, time=0.75, bodies=("s1",), poses_bytes=bytes(24))
    line = json.loads(plain_line(KeyedPayload("covey/r/truth", b"", truth, "")))
    assert (line["key"], line["type"], line["tick"]) == ("covey/r/truth", "truth", 3)
    assert (line["poses"], line["targets"]) == ([[0.0, 0.0, 0.0]], [])
    assert "poses_bytes" not in line


@pytest.mark.parametrize("sample", [sample for _, _, sample in SAMPLES], ids=lambda sample: type(sample).__name__)
def test_a_message_of_every_kind_is_printed_with_all_its_fields(sample: Message) -> None:
    line = json.loads(plain_line(KeyedPayload("k", b"", sample, "")))
    assert set(line) == {"key", "type", *(name.removesuffix("_bytes") for name in sample.__struct_fields__)}
    assert block(KeyedPayload("k", b"", sample, "")).startswith("k\n  type")


def test_the_labels_of_a_gossip_are_those_of_its_particles_and_plain_bytes_are_hexadecimal() -> None:
    gossip = msgspec.structs.replace(GOSSIP, labels_bytes=struct.pack("<2Q", 0, 9), label_numbers_bytes=b"\1" * 60, claim_ages=b"\0\2\xff")
    line = json.loads(plain_line(KeyedPayload("k", b"", gossip, "")))
    assert (line["labels"], line["label_numbers"], line["claim_ages"]) == ([9] * 60, "01" * 60, "0002ff")


def test_an_unknown_message_is_printed_raw_and_unpacked_where_it_is_msgpack() -> None:
    line = json.loads(plain_line(KeyedPayload("a/b", b"\x81\xa1x\x05", None, "key")))
    assert (line["unknown"], line["bytes"], line["raw"], line["msgpack"]) == ("key", 4, "81a17805", {"x": 5})
    assert "msgpack" not in json.loads(plain_line(KeyedPayload("a/b", b"\xc1\xff", None, "key")))
    assert "c1 ff" in block(KeyedPayload("a/b", b"\xc1\xff", None, "format"))


def test_a_message_that_is_refused_is_printed_with_the_field_that_breaks_a_rule() -> None:
    heard = KeyedPayload(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, tick=-1), None, "range")
    assert "$.tick" in json.loads(plain_line(heard))["why"] and "range: gossip: Expected `int` >= 0 - at `$.tick`" in block(heard)
    heard = KeyedPayload(GOSSIP_KEY, altered(GOSSIP_KEY, GOSSIP_BYTES, ids=bytes(480)), None, "range")
    assert json.loads(plain_line(heard))["why"] == "ids: should be strictly ascending"
    assert json.loads(plain_line(KeyedPayload(GOSSIP_KEY, GOSSIP_BYTES, None, "quarantine")))["why"] == ""


def test_long_arrays_are_cut_in_a_terminal() -> None:
    text = block(
        KeyedPayload("k", b"", Truth(sender="world", incarnation=1, tick=3, time=0.75, ids_bytes=bytes(80), targets_bytes=bytes(160)), "")
    )
    assert "10 rows: 0, 0, 0, 0, 0, 0, ..." in text
    assert fields(COMMAND)["velocity"] == (1.0, 2.0)
    compact = msgspec.structs.replace(GOSSIP, particles=bytes(16 + 6 * 100), claim_ages=b"\0\1")
    assert f"particles      {'0' * 64}... (1232 characters)\n" in block(KeyedPayload("k", b"", compact, ""))
    assert "claim_ages     0001" in block(KeyedPayload("k", b"", compact, ""))


def test_keys_and_texts_that_anybody_makes_up_are_printed_as_they_are_and_obeyed_by_no_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rates = Rates()
    rates.note(KeyedPayload("covey/r/[/red]\x1b[31m", b"", None, "key"), 0.0)
    table_console().print(rates_table(rates))
    assert r"covey/r/[/red]\x1b[31m" in capsys.readouterr().out
    truth = Truth(sender="world", incarnation=1, tick=3, time=0.75, bodies=("\x1b[31mä",), poses_bytes=bytes(24))
    texts = block(KeyedPayload("covey/r/truth", b"", truth, "")), block(KeyedPayload("covey/r/\x1b[31mä", b"", None, "key"))
    assert all("\\x1b[31mä" in text and "\x1b" not in text for text in texts)


def test_rates_are_messages_per_second_the_longest_gap_and_the_mean_size() -> None:
    rates = Rates()
    for now in (0.0, 0.5, 1.0, 2.0):
        assert rates.note(KeyedPayload("covey/r/gossip/s10", b"1234", None, ""), now)
    rates.note(KeyedPayload("covey/r/gossip/s9", b"12", None, ""), 2.0)
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
    assert lines[-2][-2] == "•"
    assert sum(line.count("*") for line in lines[:-1]) == 1
    assert any("↑12" in line for line in lines)
    assert any("x3" in line for line in lines)
    assert len({len(line) for line in lines[:-1]}) == 1


def test_there_is_no_map_where_there_is_no_room_and_who_is_outside_stands_at_the_border() -> None:
    assert swarm_map(SWARM, [], 5).plain == ""
    outside = [{"name": "s1", "state": "running", "pose": [-3.0, 99.0, 0.0]}]
    assert swarm_map({**SWARM, "places": []}, outside, 20).plain.splitlines()[1][1] == "→"
