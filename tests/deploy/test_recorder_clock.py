"""A recording has two clocks: the world's for what happened, the wall's for when it was heard."""

from pathlib import Path

from deploy.recording.recorder import Recorder
from deploy.recording.recording import Recording
from deploy.scenario import resolve
from protocol import codec
from protocol.message import Message
from protocol.messages import Command
from protocol.node import Alive, received
from protocol.observer_messages import Truth


def test_what_is_heard_is_stamped_with_the_worlds_time_and_with_the_walls(tmp_path: Path) -> None:
    walls = iter([1000.0, 1001.5, 1002.25])
    recorder = Recorder(tmp_path / "a.mcap", resolve("quick"), wall=lambda: next(walls))
    command = Command(sender="s1", incarnation=1, tick=9, velocity=(0.0, 0.0), turn_rate=0.0)
    said: list[Message] = [Truth(sender="world", incarnation=1, tick=tick, time=0.25 * tick) for tick in (8, 10)]
    for message in (said[0], command, said[1]):
        recorder.see(received(message, payloads=[codec.encode(message)]), 0.0)
    recorder.close()
    found = [(entry.time, entry.published / 1e9) for entry in Recording(tmp_path / "a.mcap").entries()]
    assert found == [(2.0, 1000.0), (2.0, 1001.5), (2.5, 1002.25)]


def test_the_wall_time_of_a_run_begins_with_its_first_tick_and_not_with_its_start(tmp_path: Path) -> None:
    walls = iter([990.0, 1000.0, 1001.5, 1002.25])
    recorder = Recorder(tmp_path / "a.mcap", resolve("quick"), wall=lambda: next(walls))
    recorder.see(Alive("agent", "s1", 1), 0.0)
    for tick in (0, 1, 2):
        truth = Truth(sender="world", incarnation=1, tick=tick, time=0.25 * tick)
        recorder.see(received(truth, payloads=[codec.encode(truth)]), 0.0)
    recorder.close()
    assert Recording(tmp_path / "a.mcap").wall_seconds == 2.25
