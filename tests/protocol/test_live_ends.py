"""The end of the live driver: while it opens its session, while it opens one anew, and on errors of its own."""

import asyncio
import signal
import socket
import subprocess
import sys
import threading
from functools import partial

import pytest

from protocol import live
from protocol.node import Effect, Reopen, Started, Stop, Subscribe
from protocol.settings import NetworkSettings
from tests.protocol.test_live import ROOT, Scribe, command, until

pytestmark = pytest.mark.live
CLIENT = """
import sys
from protocol import live
from protocol.node import Node
from protocol.node import Effect, Reopen, Started, Stop, Subscribe
from protocol.settings import NetworkSettings
class Idle(Node):
    run, role, name, incarnation = "t", "agent", "a", 1
sys.exit(live.run(Idle(), NetworkSettings(mode="client", seeds=(sys.argv[1],))))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130), (signal.SIGHUP, 129)])
def test_a_signal_ends_a_client_that_waits_for_its_router(number: int, code: int) -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute:
        words = [sys.executable, "-c", CLIENT, f"tcp/127.0.0.1:{mute.getsockname()[1]}"]
        heard = partial(signal.signal, number, signal.SIG_DFL)  # also where the tests run under `nohup`
        with subprocess.Popen(words, cwd=ROOT, stderr=subprocess.DEVNULL, preexec_fn=heard) as client:
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


def test_an_end_while_the_session_is_opened_anew_leaves_no_session_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """`stop` comes in the same pass of the loop as the new session."""

    async def scene() -> None:
        node, session = Scribe("a"), Session()
        driver = live.Driver(node, NetworkSettings())
        serving = asyncio.create_task(driver.serve())
        await until(lambda: node.events == [Started()])

        async def open_and_stop() -> None:
            driver._session = session
            driver.stop(7, "for the test")

        monkeypatch.setattr(driver, "open", open_and_stop)
        driver._carry_out(Reopen("for the test"))
        assert await asyncio.wait_for(serving, 5.0) == 7
        assert driver._reopening is not None and driver._reopening.done()
        assert session.closed and not driver._declared and driver.counts["reopened"] == 0

    asyncio.run(scene())


def test_an_end_while_a_new_session_does_not_open_ends_the_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    async def scene() -> None:
        node, trying = Scribe("a"), asyncio.Event()
        driver = live.Driver(node, NetworkSettings())
        serving = asyncio.create_task(driver.serve())
        await until(lambda: node.events == [Started()])

        async def fail() -> None:
            trying.set()
            raise live.zenoh.ZError("for the test")

        monkeypatch.setattr(driver, "open", fail)
        driver._carry_out(Reopen("for the test"))
        await trying.wait()
        driver.stop(7, "for the test")
        assert await asyncio.wait_for(serving, 5.0) == 7
        assert driver._reopening is not None and driver._reopening.done()

    asyncio.run(scene())


def test_an_error_while_the_session_is_opened_anew_ends_the_driver_and_a_second_order_is_not_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def scene() -> None:
        node = Scribe("a", Reopen("the first"), Reopen("the second"))
        driver = live.Driver(node, NetworkSettings())

        def fail(_: str) -> None:
            raise ZeroDivisionError("while listening")

        monkeypatch.setattr(driver, "_listen", fail)
        driver._wanted["covey/**"] = 1
        with pytest.raises(ZeroDivisionError, match="while listening"):
            await asyncio.wait_for(driver.serve(), 10.0)

    asyncio.run(scene())
    assert "the first" in caplog.text and "the second" not in caplog.text


def test_an_error_after_the_end_is_logged_and_changes_no_code(caplog: pytest.LogCaptureFixture) -> None:
    async def scene() -> None:
        broken: list[Effect] = [Stop(3, "for the test"), Subscribe("covey/ not a key expression //")]
        assert await live.Driver(Scribe("a", *broken), NetworkSettings()).serve() == 3

    asyncio.run(scene())
    assert "an error after the end" in caplog.text


def test_a_session_that_fails_to_close_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "CLOSE_SECONDS", 60.0)

    class Stubborn(Session):
        def close(self) -> None:
            raise live.zenoh.ZError("for the test")

    async def scene() -> None:
        driver = live.Driver(Scribe("a"), NetworkSettings())
        driver._session = Stubborn()  # type: ignore[assignment]
        await asyncio.wait_for(driver._close(), 5.0)

    asyncio.run(scene())


def test_a_key_that_cannot_be_declared_counts_as_a_message_that_was_not_sent() -> None:
    class Full(Session):
        def declare_publisher(self, *_: object, **__: object) -> None:
            raise live.zenoh.ZError("for the test")

    async def scene() -> None:
        driver = live.Driver(Scribe("a"), NetworkSettings())
        driver._session = Full()  # type: ignore[assignment]
        driver._carry_out(command("a", 1))
        assert driver.counts == {"failed_puts": 1}

    asyncio.run(scene())
