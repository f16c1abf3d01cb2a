"""The fixture of the live tests: a `covey` command; whatever it started is gone when the test ends."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.live.harness import Covey, exists


@pytest.fixture
def covey(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Covey]:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path / "runs"))
    command = Covey(tmp_path)
    yield command
    for process in command.started:
        if process.poll() is None:
            process.kill()
        process.communicate()
    for pid in command.pids:
        if exists(pid):
            os.kill(pid, signal.SIGKILL)
