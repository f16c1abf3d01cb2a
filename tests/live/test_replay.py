"""A recording that is said again on Zenoh, heard by the commands that listen to a running swarm."""

import json
import signal
from pathlib import Path

import pytest

from deploy.recording.observers import Observers, open_recorder
from deploy.scenario import resolve
from deploy.simulation import Simulation
from tests.live.harness import BOUND, Covey

pytestmark = [pytest.mark.live, pytest.mark.timeout(200)]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A recording of 30 s."""
    path = tmp_path / "some.mcap"
    simulation = Simulation(resolve("quick", {"run.seconds": 30.0}))
    Observers(simulation.scorer, open_recorder(path, simulation.scenario, virtual=True))
    simulation.run()
    return path


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
