"""Recorders and pages that crash, stop or do not keep up, and a disk that is full: the swarm does not notice."""

import json
import resource
import signal
import socket
import subprocess
from pathlib import Path

import pytest

from deploy.recording.recording import Recording
from deploy.scenario import resolve
from deploy.simulation import Simulation
from tests.live.harness import PATIENT, Covey

pytestmark = [pytest.mark.live, pytest.mark.slow]
ROOM = 200_000  # bytes that a file may have: a disk that is soon full


def transcript(seconds: float) -> str:
    """Of the same run in virtual time, which nobody watches."""
    return Simulation(resolve("quick", {"run.seconds": seconds})).run().transcript


def ended(process: subprocess.Popen[str]) -> dict:
    """The result of a run, once it has ended."""
    output, complaints = process.communicate(timeout=300)
    assert process.returncode == 0, complaints
    return json.loads(output.splitlines()[-1])


def silent_browser(url: str) -> socket.socket:
    """A browser that asks for everything and reads nothing."""
    host, port = url.removeprefix("http://").rstrip("/").split(":")
    browser = socket.socket()
    browser.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    browser.connect((host, int(port)))
    lines = ["GET /ws HTTP/1.1", f"Host: {host}:{port}", "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
    browser.sendall("\r\n".join([*lines, "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", "", ""]).encode())
    return browser


@pytest.mark.nightly
def test_a_recorder_that_is_killed_a_page_that_is_stopped_and_a_browser_that_reads_nothing_change_nothing(covey: Covey) -> None:
    words = ("--lockstep", "--seconds", "110", "--json", "--page", "127.0.0.1:0", *PATIENT)
    supervisor = covey.start("up", "quick", *words)
    assert supervisor.stderr is not None
    url = supervisor.stderr.readline().split()[1]
    covey.running()
    browser = silent_browser(url)
    recorder = covey.start("record", "beside.mcap")
    page = covey.start("watch", "--page", "127.0.0.1:0")
    assert recorder.stdout is not None and page.stdout is not None
    assert page.stdout.readline().startswith("page: ") and recorder.stdout.readline().startswith("recording into")
    begin = covey.status()["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > begin + 100)
    page.send_signal(signal.SIGSTOP)
    recorder.kill()
    at = covey.wait(lambda data: data["swarm"]["tick"] > begin + 150)["swarm"]["tick"]
    result = ended(supervisor)
    assert at < result["ticks"] == 440 and result["transcript"] == transcript(110.0)
    assert Recording(covey.folder / "beside.mcap").run == (covey.runs / "latest").readlink().name
    browser.close()
    page.kill()


@pytest.mark.nightly
def test_a_full_disk_ends_the_recording_with_a_warning_and_not_the_run(covey: Covey) -> None:
    def little_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM))

    process = covey.start("up", "quick", "--lockstep", "--seconds", "60", "--json", "--record", *PATIENT, limit=little_room)
    output, complaints = process.communicate(timeout=200)
    assert process.returncode == 0 and "Traceback" not in complaints
    assert "recording.mcap: File too large; the recording ended early" in complaints
    assert json.loads(output.splitlines()[-1])["transcript"] == transcript(60.0)
    file = covey.runs / "latest" / "recording.mcap"
    assert 0 < file.stat().st_size <= ROOM and len(list(Recording(file).entries())) > 100


def test_a_disk_that_is_full_from_the_start_is_one_line(covey: Covey) -> None:
    Path(covey.folder / "full.mcap").symlink_to("/dev/full")
    code, _, complaints = covey.run("up", "quick", "--record", "full.mcap")
    assert (code, complaints) == (2, "covey: --record full.mcap: No space left on device\n")
