"""Recordings of real swarms: opened after kill -9 of the recorder, and scored to the figures of the run."""

import signal
import time
from pathlib import Path

import pytest

from deploy.recording.recording import Recording, event_of
from protocol.node import Received, messages_of
from protocol.observer_messages import Truth
from tests.live.harness import BOUND, Covey

pytestmark = [pytest.mark.live, pytest.mark.slow, pytest.mark.timeout(400)]
LAST_SECOND = 1.0  # s that a recorder which is killed may lose


def truths(path: Path) -> list[tuple[int, float]]:
    """Tick of each truth in a recording, and the Unix time, s, at which it was heard."""
    found = []
    for entry in Recording(path).entries():
        found += [(message.tick, entry.published / 1e9) for message in messages_of(event_of(entry)) if isinstance(message, Truth)]
    return found


@pytest.mark.alone
def test_a_recorder_that_is_killed_loses_the_last_second_and_nobody_notices(covey: Covey) -> None:
    covey.start("up", "quick", "--seconds", "1000", "--rate", "2", "--record")
    covey.running()
    recorder = covey.start("record", "outside.mcap")
    assert recorder.stdout is not None
    assert recorder.stdout.readline().startswith("recording into")
    file = covey.folder / "outside.mcap"
    end = time.monotonic() + BOUND
    while len(truths(file)) < 12:  # it may have begun late
        assert time.monotonic() < end, "nothing is recorded"
        time.sleep(0.1)
    heard = covey.wait(lambda data: True)["swarm"]["tick"]
    recorder.send_signal(signal.SIGKILL)
    recorder.wait(timeout=BOUND)
    killed_at = time.time()

    recording = Recording(file)
    (first, _), (tick, _) = truths(file)[0], truths(file)[-1]
    assert not recording.is_whole
    lost = killed_at - max(entry.published for entry in recording.entries()) / 1e9
    print(f"the last {lost:.2f} s are lost")
    assert lost <= LAST_SECOND
    covey.wait(lambda data: data["swarm"]["tick"] > heard + 4)
    assert covey.run("down")[0] == 0
    whole = {entry.payload for entry in Recording(covey.folder / "runs" / "latest" / "recording.mcap").entries()}
    messages = [entry for entry in recording.entries() if isinstance(event_of(entry), Received) and 0.25 * first < entry.time < 0.25 * tick]
    assert len(messages) > 0
    assert all(entry.payload in whole for entry in messages)


@pytest.mark.parametrize("pace", [pytest.param(("--lockstep",), marks=pytest.mark.nightly), ("--rate", "4")])
def test_a_recording_alone_gives_the_figures_of_the_live_run(covey: Covey, pace: tuple[str, ...]) -> None:
    live = covey.result("up", "quick", "--seconds", "10", "--kill", "s3@4", "--record", *pace)
    again = covey.result("score", "latest")
    assert again["transcript"] == live["transcript"]
    assert again["ticks"] == live["ticks"] > 30
    for name in ("mean_ospa", "steady_ospa", "final_ospa", "mean_gospa", "final_gospa", "cardinality_error", "hole_area", "overlap_area"):
        assert again[name] == pytest.approx(live[name], rel=0.0, abs=1e-9), name
    assert [kill["name"] for kill in again["kills"]] == ["s3"]


@pytest.mark.nightly
def test_a_swarm_that_was_cut_in_two_is_cut_in_every_recording(covey: Covey) -> None:
    """In that of the run and in that of an onlooker, who is told by the supervisor, for no key says it."""
    process = covey.start("up", "quick", "--seconds", "1000", "--rate", "2", "--record", "--set", "network.link_faults=true")
    covey.running()
    recorder = covey.start("record", "outside.mcap")
    assert recorder.stdout is not None
    assert recorder.stdout.readline().startswith("recording into")
    assert covey.run("partition", "s1,s2")[0] == 0
    assert covey.run("heal")[0] == 0
    outside = covey.folder / "outside.mcap"
    end = time.monotonic() + BOUND
    while len(Recording(outside).faults) < 2:
        assert time.monotonic() < end, "the onlooker does not note what has been cut"
        time.sleep(0.1)
    assert covey.run("down")[0] == 0
    process.wait(timeout=BOUND)
    recorder.wait(timeout=BOUND)
    recording = Recording(covey.folder / "runs" / "latest" / "recording.mcap")
    assert [(fault.verb, fault.text) for fault in recording.faults] == [
        ("partition", "cut off s1, s2"),
        ("heal", "all links are clear again"),
    ]
    assert 0.0 <= recording.faults[0].time <= recording.faults[1].time <= recording.seconds
    assert Recording(outside).faults == recording.faults
    assert covey.result("score", "outside.mcap")["kills"] == []  # who was ended with the run has not died
