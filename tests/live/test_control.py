"""The control socket by itself: a client that is still connected when the run ends is no error."""

import asyncio
import logging
from pathlib import Path

import pytest

from deploy.live.control import Answer, ControlClient, ControlServer
from deploy.storage.run_directory import RunDirectory


def test_a_client_that_is_still_connected_when_the_run_ends_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path))
    directory = RunDirectory("r")
    directory.path.mkdir(parents=True)

    async def answer(request: dict[str, object]) -> Answer:
        return {"ok": str(request["verb"])}

    async def run() -> ControlClient:
        server = ControlServer(directory, answer)
        await server.open()
        client = await asyncio.to_thread(ControlClient, directory)
        assert (await asyncio.to_thread(client.ask, "status"))["ok"] == "status"
        await server.close()
        return client

    with caplog.at_level(logging.WARNING):
        asyncio.run(run()).close()
    assert not caplog.records
