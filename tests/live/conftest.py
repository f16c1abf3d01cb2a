"""The fixture of the live tests: a `covey` command; whatever it started is gone when the test ends."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.live.harness import Covey


@pytest.fixture
def covey(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Covey]:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path / "runs"))
    command = Covey(tmp_path)
    yield command
    command.kill_all()
    for process in command.started:
        process.communicate()
