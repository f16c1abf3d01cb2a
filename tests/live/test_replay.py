"""A recording that is said again on Zenoh, heard by the commands that listen to a running swarm."""

import json
import signal
import socket
from pathlib import Path

import msgspec
import pytest

from deploy.cli import recordings
from deploy.recording.observers import Observers, open_recorder
from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol.node import Effect, Event
from protocol.settings import BadSetting, NetworkSettings
from tests.live.harness import BOUND, Covey

pytestmark = [pytest.mark.live, pytest.mark.timeout(200)]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A recording of 30 s."""
    return recorded(tmp_path / "some.mcap", NetworkSettings())


def recorded(path: Path, network: NetworkSettings) -> Path:
    """A recording of 30 s of a swarm in that network."""
    simulation = Simulation(msgspec.structs.replace(resolve("quick", {"run.seconds": 30.0}), network=network))
    Observers(simulation.scorer, open_recorder(path, simulation.scenario, virtual=True))
    simulation.run()
    return path


@pytest.mark.slow
def test_a_replay_without_a_page_is_heard_by_those_who_listen_and_leaves_no_run_behind(covey: Covey, file: Path) -> None:
    replay = covey.start("replay", str(file), "--no-page", "--publish")
    assert replay.stdout is not None
    assert replay.stdout.readline().startswith(f"{file}: quick, 29.75 s; Ctrl-C")
    assert replay.stdout.readline().startswith("said again as run covey-replay")
    code, output, complaints = covey.run("echo", "estimate/s3", "--count", "3")
    assert code == 0, complaints
    first, *others = [json.loads(line) for line in output.splitlines()]
    assert [heard["tick"] - first["tick"] for heard in others] == [1, 2]
    for words in (("ps",), ("kill", "s3"), ("down",), ("watch",), ("halt",), ("release",)):
        code, _, complaints = covey.run(*words)
        assert code == 2 and complaints.startswith("covey: no run is running in"), (words, complaints)
    [run] = [path.name for path in covey.runs.glob("covey-replay*")]
    assert "is a recording that is said again" in covey.run("kill", "s3", "--run", run)[2]
    replay.send_signal(signal.SIGINT)
    assert replay.wait(timeout=BOUND) == 0
    assert not list(covey.runs.glob("covey-replay*"))


@pytest.mark.parametrize(
    "network",
    [
        pytest.param(NetworkSettings(mode="client", seeds=("tcp/127.0.0.1:1",)), marks=pytest.mark.nightly),
        NetworkSettings(listen=("tls/127.0.0.1:0",), ca="ca.pem", certificate="{name}.pem", key="{name}.key", admit=("s1", "s2")),
    ],
    ids=["client", "certificates"],
)
@pytest.mark.slow
def test_a_recording_of_another_network_is_said_again_on_loopback(covey: Covey, tmp_path: Path, network: NetworkSettings) -> None:
    replay = covey.start("replay", str(recorded(tmp_path / "other.mcap", network)), "--no-page", "--publish")
    assert replay.stdout is not None
    assert replay.stdout.readline() and replay.stdout.readline().startswith("said again as run covey-replay")
    code, output, complaints = covey.run("echo", "estimate/s3", "--count", "1")
    assert (code, len(output.splitlines())) == (0, 1), complaints
    replay.send_signal(signal.SIGINT)
    assert replay.wait(timeout=BOUND) == 0
    assert not list(covey.runs.glob("covey-replay*"))


@pytest.mark.timeout(30)
def test_a_replay_that_cannot_open_its_port_ends_with_one_line_and_leaves_no_run_behind(
    covey: Covey, file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        monkeypatch.setattr(recordings, "free_port", lambda: taken.getsockname()[1])
        with pytest.raises(BadSetting, match="the port is in use"):
            recordings.replay(str(file), False, 1.0, True)
    assert "said again" not in capsys.readouterr().out
    assert not list(covey.runs.glob("covey-replay*"))


@pytest.mark.timeout(30)
def test_a_replay_that_fails_while_it_is_said_ends_and_leaves_no_run_behind(
    covey: Covey, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(node: recordings.ReplayNode, event: Event, now: float) -> list[Effect]:
        raise ValueError("broken")

    monkeypatch.setattr(recordings.ReplayNode, "handle", fail)
    with pytest.raises(ValueError, match="broken"):
        recordings.replay(str(file), False, 1.0, True)
    assert not list(covey.runs.glob("covey-replay*"))
