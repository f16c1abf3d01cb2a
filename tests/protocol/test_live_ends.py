"""The end of the live driver: while it opens its session, while it opens one anew, and on errors of its own."""

import asyncio
import signal
import socket
import subprocess
import sys
import threading

import pytest

from protocol import live
from protocol.settings import NetworkSettings
from tests.protocol.test_live import ROOT, Scribe, until

pytestmark = pytest.mark.live
CLIENT = """
import sys
from protocol import live
from protocol.node import Node
from protocol.settings import NetworkSettings
class Idle(Node):
    run, role, name, incarnation = "t", "agent", "a", 1
sys.exit(live.run(Idle(), NetworkSettings(mode="client", seeds=(sys.argv[1],))))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_ends_a_client_that_waits_for_its_router(number: int, code: int) -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute:
        words = [sys.executable, "-c", CLIENT, f"tcp/127.0.0.1:{mute.getsockname()[1]}"]
        with subprocess.Popen(words, cwd=ROOT, stderr=subprocess.DEVNULL) as client:
            try:
                connection, _ = mute.accept()  # so it has begun to open its session
                client.send_signal(number)
                assert client.wait(10) == code
                connection.close()
            finally:
                client.kill()


class Session:
    """As much of a session as a driver needs to close it."""

    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize("cancelled", [False, True])
def test_who_waits_for_a_router_is_told_where_to_look_and_a_session_that_opens_after_the_end_is_closed_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, cancelled: bool
) -> None:
    session, begun, there = Session(), threading.Event(), threading.Event()

    def wait_for_router(*_: object) -> Session:
        begun.set()
        assert there.wait(20)
        return session

    monkeypatch.setattr(live, "open_session", wait_for_router)
    monkeypatch.setattr(live, "ALONE_SECONDS", 0.02)

    async def scene() -> None:
        driver = live.Driver(Scribe("a"), NetworkSettings(mode="client", seeds=("tcp/127.0.0.1:9",)))
        serving = asyncio.create_task(driver.serve())
        await until(begun.is_set)
        await until(lambda: "does anybody listen at tcp/127.0.0.1:9" in caplog.text)
        if cancelled:
            serving.cancel()
        else:
            driver.stop(7, "for the test")
        ended = await asyncio.wait_for(asyncio.gather(serving, return_exceptions=True), 5.0)
        assert isinstance(ended[0], asyncio.CancelledError) if cancelled else ended == [7]
        there.set()
        await until(lambda: session.closed)

    asyncio.run(scene())
