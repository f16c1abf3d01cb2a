"""The control socket by itself: what a command is told when the supervisor fails, is late, or has gone."""

import asyncio
import contextlib
import io
import json
import logging
import os
import socket
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from deploy.cli import control as commands
from deploy.live import control
from deploy.live.control import Answer, ControlClient, ControlServer
from deploy.storage.run_directory import RunDirectory
from protocol.settings import BadSetting


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunDirectory:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path))
    made = RunDirectory("r")
    made.path.mkdir(parents=True)
    return made


def test_a_client_that_is_still_connected_when_the_run_ends_is_no_error(directory: RunDirectory, caplog: pytest.LogCaptureFixture) -> None:
    async def answer(request: dict[str, object]) -> Answer:
        return {"ok": str(request["verb"])}

    async def run() -> asyncio.StreamWriter:
        server = ControlServer(directory, answer)
        await server.open()
        reader, writer = await asyncio.open_unix_connection(json.loads(directory.control.read_text())["socket"])
        writer.write(b'{"verb": "status"}\n')
        assert json.loads(await reader.readline()) == {"ok": "status"}
        await server.close()
        return writer

    with caplog.at_level(logging.WARNING):
        writer = asyncio.run(run())
    del writer
    assert not caplog.records


def test_a_socket_that_cannot_be_made_is_told_with_its_folder(
    directory: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk names no file when a socket is bound."""

    async def bind(*_: object, **options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(asyncio, "start_unix_server", bind)
    with pytest.raises(BadSetting, match=rf"^TMPDIR = {tmp_path}: the run's socket cannot be made there: No space left on device$"):
        asyncio.run(ControlServer(directory, lambda request: {}).open())  # type: ignore[arg-type, return-value]


def test_a_socket_of_another_user_is_no_end_of_the_run(directory: RunDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    class Closed(socket.socket):
        def connect(self, address: object) -> None:
            raise PermissionError(13, "Permission denied")

    directory.control.write_text('{"socket": "/tmp/covey-1000/a.sock"}')
    monkeypatch.setattr(socket, "socket", Closed)
    with pytest.raises(BadSetting, match=r"^/tmp/covey-1000/a\.sock: Permission denied: the run is that of another user$"):
        ControlClient(directory).ask("down")


def complaint(directory: RunDirectory, answer: Callable[[dict[str, object]], Awaitable[Answer]]) -> str:
    """What a command says when the supervisor answers like this."""

    async def run() -> str:
        server = ControlServer(directory, answer)
        await server.open()
        client = await asyncio.to_thread(ControlClient, directory)
        try:
            with pytest.raises(BadSetting) as caught:
                await asyncio.to_thread(client.ask, "status")
        finally:
            await server.close()
        return str(caught.value)

    return asyncio.run(run())


def test_a_supervisor_that_fails_at_a_request_says_so_and_logs_it(directory: RunDirectory, caplog: pytest.LogCaptureFixture) -> None:
    async def answer(request: dict[str, object]) -> Answer:
        raise OSError(28, "No space left on device")

    assert "failed at it, see its log: OSError: [Errno 28] No space left on device" in complaint(directory, answer)
    assert "a request could not be carried out" in caplog.text


def test_a_late_answer_is_not_taken_for_the_end_of_the_run(directory: RunDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "CLIENT_SECONDS", 0.1)

    async def answer(request: dict[str, object]) -> Answer:
        await asyncio.sleep(0.4)
        return {"ok": ""}

    assert "has not answered for" in complaint(directory, answer)


def test_after_a_late_answer_the_next_request_has_its_own(directory: RunDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "CLIENT_SECONDS", 0.2)

    async def answer(request: dict[str, object]) -> Answer:
        await asyncio.sleep(0.3 if request["verb"] == "slow" else 0.0)
        return {"ok": str(request["verb"])}

    async def run() -> str:
        server = ControlServer(directory, answer)
        await server.open()
        client = await asyncio.to_thread(ControlClient, directory)
        with pytest.raises(BadSetting, match="has not answered for"):
            await asyncio.to_thread(client.ask, "slow")
        said: str = (await asyncio.to_thread(client.ask, "status"))["ok"]
        await server.close()
        return said

    assert asyncio.run(run()) == "status"


def test_half_an_answer_of_a_supervisor_that_is_killed_is_the_end_of_the_run(directory: RunDirectory) -> None:
    async def hang_up(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(b'{"ok": "", "data": {')
        writer.close()

    async def run() -> None:
        path = directory.socket_path()
        async with await asyncio.start_unix_server(hang_up, str(path)):
            directory.control.write_text(json.dumps({"socket": str(path)}))
            with pytest.raises(BadSetting, match=r"^the run has ended$"):
                await asyncio.to_thread(ControlClient(directory).ask, "status")

    asyncio.run(run())


def test_a_client_can_ask_where_somebody_elses_event_loop_runs(directory: RunDirectory) -> None:
    async def answer(request: dict[str, object]) -> Answer:
        return {"ok": str(request["verb"])}

    async def serve(opened: threading.Event, over: threading.Event) -> None:
        server = ControlServer(directory, answer)
        await server.open()
        opened.set()
        await asyncio.to_thread(over.wait)
        await server.close()

    async def beside() -> None:
        assert ControlClient(directory).ask("status") == {"ok": "status"}

    opened, over = threading.Event(), threading.Event()
    serving = threading.Thread(target=lambda: asyncio.run(serve(opened, over)))
    serving.start()
    try:
        assert opened.wait(20.0)
        asyncio.run(beside())
    finally:
        over.set()
        serving.join()


def test_a_supervisor_that_hangs_up_has_ended_its_run(directory: RunDirectory) -> None:
    async def answer(request: dict[str, object]) -> Answer:
        raise asyncio.CancelledError

    assert complaint(directory, answer) == "the run has ended"


def test_down_waits_as_long_as_a_supervisor_computes_and_says_at_what(directory: RunDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a long run the scores of tracks take minutes, in which the supervisor answers nothing."""
    monkeypatch.setattr(commands, "QUIET_SECONDS", 0.0)
    asked, said = asyncio.Event(), io.StringIO()

    async def answer(request: dict[str, object]) -> Answer:
        asked.set()
        return {"ok": "going down"}

    async def supervise(opened: threading.Event) -> None:
        lock = directory.hold()
        assert lock is not None
        server = ControlServer(directory, answer)
        await server.open()
        opened.set()
        await asked.wait()
        for file, next_words in ((directory.scores, "computes the scores of its tracks"), (directory.result, "ends its processes")):
            await asyncio.sleep(0.1)
            file.touch()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(10.0):
                    while next_words not in said.getvalue():
                        await asyncio.sleep(0.01)
        await server.close()
        os.close(lock)

    opened = threading.Event()
    supervising = threading.Thread(target=lambda: asyncio.run(supervise(opened)))
    supervising.start()
    try:
        assert opened.wait(20.0)
        with contextlib.redirect_stderr(said):
            assert commands.down("r") == 0
    finally:
        supervising.join()
    assert [line.partition(" still ")[2].partition(";")[0] for line in said.getvalue().splitlines()][-2:] == [
        "computes the scores of its tracks",
        "ends its processes",
    ]
