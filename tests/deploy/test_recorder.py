"""Recordings: the bytes as they were on the wire, readable after a kill and on a full disk, and scored to the same figures."""

import itertools
import signal
import subprocess
import sys
from pathlib import Path

import msgpack
import msgspec
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, Writer

from deploy.recording.observers import Observers, open_recorder, recording_path
from deploy.recording.recorder import ABOUT, CHUNK_SECONDS, Recorder, message_schema
from deploy.recording.recording import Recording, event_of, find_recording
from deploy.recording.rescore import difference, rescore
from deploy.scenario import FaultSettings, Scenario, resolve
from deploy.scoring.result import Fault, Result
from deploy.scoring.scores import read_scores, write_scores
from deploy.simulation import Simulation
from protocol import codec
from protocol.keys import message_key
from protocol.message import Message
from protocol.messages import KINDS, Command
from protocol.node import Alive, Gone, Received, Rejected, messages_of, received
from protocol.observer_messages import Truth
from protocol.settings import BadSetting

ROOT = Path(__file__).resolve().parents[2]
SHORT = {"run.seconds": 6.0, "run.name": "short"}


def scenario(**more: object) -> Scenario:
    return resolve("quick", {**SHORT, **more})


def command(tick: int) -> Command:
    return Command(sender="s1", incarnation=1, tick=tick, velocity=(1.0, 0.0), turn_rate=0.0)


def heard(message: Message) -> Received:
    """A message with what was on the wire."""
    return received(message, payloads=[codec.encode(message)])


def payloads_of(events: list[Received]) -> list[bytes]:
    return [payload for event in events for payload in event.batch.payloads]


def recorded_run(path: Path, of: Scenario) -> tuple[Simulation, Result]:
    simulation = Simulation(of)
    Observers(simulation.scorer, open_recorder(path, simulation.scenario, virtual=True))
    return simulation, simulation.run()


def heard_truths(of: Scenario) -> list[Received]:
    """What the world says in a run of 6 s."""
    simulation, found = Simulation(of), []
    simulation.scorer.on_event = lambda event, now: found.append(event)
    simulation.run()
    return [event for event in found if isinstance(event, Received) and event.batch.kind is Truth]


def test_payloads_come_back_byte_for_byte_in_order_under_their_keys(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", scenario())
    sent = [heard(command(tick)) for tick in range(300)]
    for event in sent:
        recorder.see(event, 0.0)
    recorder.close()
    entries = list(Recording(tmp_path / "a.mcap").entries())
    assert [entry.payload for entry in entries] == payloads_of(sent)
    assert {entry.key for entry in entries} == {message_key("short", command(0))}
    assert [messages_of(event_of(entry)) for entry in entries] == [event.batch.messages for event in sent]


def test_tokens_and_what_was_rejected_come_back_as_the_same_events(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", scenario())
    seen = [
        Alive("agent", "s1", 7),
        Rejected("s1", "format", "covey/short/command/s1", b"\xc1"),
        Rejected("s1", "quarantine", "covey/short/command/s1", b"\xc1"),
        Gone("agent", "s1", 7),
    ]
    for event in seen:
        recorder.see(event, 0.0)
    recorder.close()
    assert [event_of(entry) for entry in Recording(tmp_path / "a.mcap").entries()] == [seen[0], seen[1], seen[3]]


def test_a_stranger_reads_channels_schemas_and_scenario_with_the_mcap_library_and_msgpack_alone(tmp_path: Path) -> None:
    recorded_run(tmp_path / "a.mcap", scenario())
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        seen = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (channel.message_encoding, schema.encoding) == ("msgpack", "jsonschema")
            seen[channel.topic.split("/")[2]] = schema.name, set(msgpack.unpackb(message.data))
        names = [metadata.name for metadata in reader.iter_metadata()]
    assert names == ["covey"]
    assert seen["gossip"][0] == "covey.Gossip"
    assert seen["alive"] == ("covey.Token", {"alive"})
    for kind, (_, fields) in seen.items():
        if kind in KINDS:
            assert fields <= set(message_schema(kind)["properties"])


def test_a_recording_alone_gives_the_figures_of_the_run_to_the_last_digit(tmp_path: Path) -> None:
    with_kill = msgspec.structs.replace(scenario(), faults=(FaultSettings(at=3.0, verb="kill", who="2"),))
    simulation, result = recorded_run(tmp_path / "a.mcap", with_kill)
    (tmp_path / "result.json").write_text(result.to_json(), encoding="utf-8")
    scorer = rescore(Recording(tmp_path / "a.mcap"))
    assert scorer.scores == simulation.scorer.scores
    assert len(scorer.scores) == 24
    again = scorer.result(0.0)
    assert [kill.name for kill in again.kills] == [kill.name for kill in result.kills]
    assert difference(tmp_path / "a.mcap", again) == 0.0


def test_the_difference_to_another_run_is_not_stated(tmp_path: Path) -> None:
    _, other = recorded_run(tmp_path / "b.mcap", scenario(**{"run.seed": 2}))
    _, result = recorded_run(tmp_path / "a.mcap", scenario())
    assert difference(tmp_path / "a.mcap", result) is None
    (tmp_path / "result.json").write_text(other.to_json(), encoding="utf-8")
    assert difference(tmp_path / "a.mcap", result) is None


def test_scores_are_written_and_read_with_every_digit(tmp_path: Path) -> None:
    simulation, _ = recorded_run(tmp_path / "a.mcap", scenario())
    write_scores(tmp_path / "scores.csv", simulation.scorer.scores)
    head = (tmp_path / "scores.csv").read_text(encoding="utf-8").splitlines()[0]
    assert head.startswith("tick,time,ospa,gospa")
    assert read_scores(tmp_path / "scores.csv") == simulation.scorer.scores


def test_chunks_are_smaller_than_the_mcap_library_makes_them_by_itself(tmp_path: Path) -> None:
    recorded_run(tmp_path / "a.mcap", scenario())
    with (tmp_path / "a.mcap").open("rb") as file:
        chunks = [record for record in StreamReader(file, emit_chunks=True).records if isinstance(record, Chunk)]
    assert len(chunks) == 2
    for chunk in chunks:
        whole = zstandard.decompress(chunk.data, max_output_size=chunk.uncompressed_size)
        assert len(chunk.data) < 0.99 * len(zstandard.compress(whole))


@pytest.mark.parametrize("cut", [1, 9, 100, 2000])
def test_a_file_that_lost_its_end_is_read_as_far_as_it_is_whole(tmp_path: Path, cut: int) -> None:
    recorded_run(tmp_path / "a.mcap", scenario())
    whole = list(Recording(tmp_path / "a.mcap").entries())
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(data[:-cut])
    broken = Recording(tmp_path / "b.mcap")
    entries = list(broken.entries())
    assert not broken.is_whole
    assert entries == whole[: len(entries)]
    assert broken.scenario == Recording(tmp_path / "a.mcap").scenario


def test_a_chunk_that_was_cut_through_costs_only_itself(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", scenario())
    for tick in range(40):
        recorder.see(heard(command(tick)), 0.0)
        if tick % 10 == 9:
            recorder.flush()
    data = (tmp_path / "a.mcap").read_bytes()
    recorder.close()
    (tmp_path / "b.mcap").write_bytes(data[:-30])
    assert len(Recording(tmp_path / "b.mcap").spans) == 3
    assert len(list(Recording(tmp_path / "b.mcap").entries())) == 30


def test_one_large_chunk_takes_the_place_of_the_small_ones_and_what_is_read_stays_the_same(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", scenario())
    truths, spans = heard_truths(scenario()), []
    for number, truth in enumerate(truths, 1):
        recorder.see(truth, 0.0)
        recorder.flush()
        recording = Recording(tmp_path / "a.mcap")
        assert not recording.is_whole
        assert [entry.payload for entry in recording.entries()] == [
            payload for event in truths[:number] for payload in event.batch.payloads
        ]
        spans.append(len(recording.spans))
    recorder.close()
    recording = Recording(tmp_path / "a.mcap")
    small = round(CHUNK_SECONDS / recording.scenario.run.dt)
    assert spans == [*range(1, small + 1), *range(2, len(truths) - small + 2)]
    assert len(recording.spans) == 2
    assert recording.is_whole
    assert [entry.payload for entry in recording.entries()] == payloads_of(truths)


def test_a_file_that_is_read_while_a_large_chunk_takes_the_place_of_the_small_ones_ends_where_it_is_not_whole(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", scenario())
    truths, before, after = heard_truths(scenario()), b"", b""
    recorder._wall = itertools.count(1.0).__next__
    for truth in truths:
        before = (tmp_path / "a.mcap").read_bytes()
        opened = Recording(tmp_path / "a.mcap")
        recorder.see(truth, 0.0)
        after = (tmp_path / "a.mcap").read_bytes()
        if len(after) < len(before):  # the small chunks went
            break
        recorder.flush()
    recorder.close()
    (tmp_path / "a.mcap").write_bytes(after)
    payloads = payloads_of(truths)
    replaced = [entry.payload for entry in opened.entries()]
    assert len(replaced) > 0 and replaced == payloads[: len(replaced)]
    assert (opened.wall_seconds or 0.0) > 0.0

    settled = opened.spans[0].offset
    for place in range(settled, len(after), max(1, (len(after) - settled) // 50)):  # as far as the large one has been written
        (tmp_path / "b.mcap").write_bytes(after[:place] + before[place:])
        recording = Recording(tmp_path / "b.mcap")
        assert not recording.is_whole
        found = [entry.payload for entry in recording.entries()]
        assert found == payloads[: len(found)]


def test_a_damaged_chunk_of_a_whole_file_is_named(tmp_path: Path) -> None:
    recorded_run(tmp_path / "a.mcap", scenario())
    offset = Recording(tmp_path / "a.mcap").spans[1].offset
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    data[offset + 200] ^= 0xFF
    (tmp_path / "a.mcap").write_bytes(data)
    with pytest.raises(BadSetting, match=rf"a\.mcap: the chunk at byte {offset} is damaged"):
        list(Recording(tmp_path / "a.mcap").entries())


def test_the_recording_of_a_simulation_is_the_same_to_the_last_byte_every_time(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        recorded_run(tmp_path / name, scenario())
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


@pytest.mark.parametrize("whole", [True, False])
def test_faults_that_do_not_show_by_themselves_stand_in_the_recording(tmp_path: Path, whole: bool) -> None:
    recorder = Recorder(tmp_path / "a.mcap", scenario())
    recorder.see(heard(command(1)), 0.0)
    recorder.note_fault(Fault(12.25, "partition", "cut off s1", sides=2))
    recorder.see(heard(command(2)), 0.0)
    recorder.note_fault(Fault(13.0, "pause", "pause s2, s3", "s2,s3"))
    recorder.note_fault(Fault(14.0, "heal", "all links are clear again"))
    data = (tmp_path / "a.mcap").read_bytes()  # as a kill would leave it
    recorder.close()
    if not whole:
        (tmp_path / "a.mcap").write_bytes(data)
    recording = Recording(tmp_path / "a.mcap")
    assert recording.faults == [
        (12.25, "partition", "cut off s1", "", 2),
        (13.0, "pause", "pause s2, s3", "s2,s3", 1),
        (14.0, "heal", "all links are clear again", "", 1),
    ]
    assert len(list(recording.entries())) == 2
    assert recording.is_whole == whole


KILLED = """
import sys, time
from pathlib import Path
from tests.deploy.test_recorder import Recorder, command, heard, scenario
recorder = Recorder(Path(sys.argv[1]), scenario())
for tick in range(50):
    recorder.see(heard(command(tick)), 0.0)
recorder.flush()
for tick in range(50, 60):
    recorder.see(heard(command(tick)), 0.0)
print("ready", flush=True)
time.sleep(60)
"""


def test_a_recorder_that_is_killed_leaves_all_that_it_had_flushed(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path / "a.mcap")], stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGKILL)
    recording = Recording(tmp_path / "a.mcap")
    ticks = [event.batch.messages[0].tick for entry in recording.entries() if isinstance(event := event_of(entry), Received)]
    assert not recording.is_whole
    assert ticks[:50] == list(range(50))


FULL = """
import resource, signal, sys
from pathlib import Path
from tests.deploy.test_recorder import Recorder, command, heard, scenario
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
recorder = Recorder(Path(sys.argv[1]), scenario())
room = recorder.file_bytes + 3000
resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
for tick in range(3000):
    recorder.see(heard(command(tick)), 0.0)
    if tick % 50 == 49:
        recorder.flush()
recorder.close()
print(recorder.messages, recorder.lost, recorder.stopped)
"""


def test_a_full_disk_ends_the_recording_with_a_counter_and_what_was_written_opens(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "a.mcap")], capture_output=True, text=True, timeout=60, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    messages, lost, *why = done.stdout.split()
    assert int(messages) + int(lost) == 3000
    assert int(lost) > 0
    assert why
    entries = list(Recording(tmp_path / "a.mcap").entries())
    assert 0 < len(entries) <= int(messages)
    assert len(entries) % 50 == 0


def test_made_up_keys_end_no_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deploy.recording.recorder.MOST_CHANNELS", 3)
    recorder = Recorder(tmp_path / "a.mcap", scenario(), None)
    for number in range(5):
        recorder.see(Rejected(f"x{number}", "format", f"covey/quick/gossip/x{number}", b"?"), 0.0)
    recorder.see(Rejected("x1", "format", "covey/quick/gossip/x1", b"!"), 0.0)
    recorder.close()
    entries = [(entry.key, entry.payload) for entry in Recording(tmp_path / "a.mcap").entries()]
    assert entries == [*((f"covey/quick/gossip/x{number}", b"?") for number in range(3)), ("covey/quick/gossip/x1", b"!")]
    assert recorder.lost == 2 and recorder.stopped is None


@pytest.mark.parametrize(("name", "text"), [("run.toml", "[run"), ("versions.json", "{"), ("run.toml", None)])
def test_a_recording_whose_head_is_damaged_is_refused_by_name(tmp_path: Path, name: str, text: str | None) -> None:
    about = {"run.toml": '[run]\nscenario = "quick"\n', "versions.json": "{}", "run": "quick"}
    about = {key: value for key, value in {**about, name: text}.items() if value is not None}
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("covey")
        writer.add_metadata(ABOUT, about)
        writer.finish()
    with pytest.raises(BadSetting, match=r"a\.mcap: what it says of its run is damaged: "):
        Recording(tmp_path / "a.mcap")


def test_what_is_no_recording_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"nothing of the kind")
    with pytest.raises(BadSetting, match=r"a\.mcap: no recording of Covey"):
        Recording(tmp_path / "a.mcap")
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(BadSetting, match=r"empty\.mcap: no recording"):
        Recording(tmp_path / "empty.mcap")
    (tmp_path / "begun.mcap").write_bytes(MCAP0_MAGIC)
    with pytest.raises(BadSetting, match=r"begun\.mcap: no recording of Covey"):
        Recording(tmp_path / "begun.mcap")
    with pytest.raises(BadSetting, match="no such file, and no run of this name"):
        find_recording("never-run")


def test_a_recording_is_found_by_file_folder_and_run_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path))
    (tmp_path / "one").mkdir()
    file = tmp_path / "one" / "recording.mcap"
    with pytest.raises(BadSetting, match="no recording in it"):
        find_recording("one")
    Recorder(file, scenario())
    assert find_recording("one") == find_recording(str(tmp_path / "one")) == find_recording(str(file)) == file


def test_record_names_an_mcap_file_or_means_the_run_directory(tmp_path: Path) -> None:
    assert recording_path(False, tmp_path) is None
    names = [recording_path(True, tmp_path) for _ in range(3)]  # of recorders that start at once
    assert names == [tmp_path / "recording.mcap", tmp_path / "recording-2.mcap", tmp_path / "recording-3.mcap"]
    with pytest.raises(BadSetting, match=r"--record .*recording\.mcap: No such file or directory"):
        recording_path(True, tmp_path / "never")
    assert recording_path(Path("x.mcap"), tmp_path) == Path("x.mcap")
    with pytest.raises(BadSetting, match=r"--record quick: should be a file that ends in \.mcap"):
        recording_path(Path("quick"), tmp_path)
    with pytest.raises(BadSetting, match="--record"):
        open_recorder(Path("/dev/null/x.mcap"), scenario())


def test_a_recording_is_never_written_over_by_another(tmp_path: Path) -> None:
    file = tmp_path / "kept.mcap"
    open_recorder(file, scenario())
    before = file.read_bytes()
    with pytest.raises(BadSetting, match=r"--record .*kept\.mcap: holds something already; should be a new file"):
        open_recorder(file, scenario())
    assert file.read_bytes() == before


def test_a_recorder_that_has_heard_nothing_leaves_no_file_in_the_way_of_the_next_one(tmp_path: Path) -> None:
    for _ in range(2):
        open_recorder(tmp_path / "a.mcap", scenario()).close()
    assert list(tmp_path.iterdir()) == []


def test_an_onlooker_that_fails_is_left_out_and_the_run_goes_on(tmp_path: Path) -> None:
    simulation = Simulation(scenario())
    onlookers = Observers(simulation.scorer, None)
    heard: list[object] = []

    def faulty(event: object, now: float) -> None:
        heard.append(event)
        raise RuntimeError("planted")

    onlookers._listeners.append(faulty)
    assert simulation.run().ticks == 24
    assert len(heard) == 1
