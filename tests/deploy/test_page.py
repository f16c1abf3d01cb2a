"""The page's server in one event loop with its browsers: greetings, frames, clicks, and whom it refuses."""

import asyncio
import socket
import struct
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import msgspec
import pytest

from deploy.__main__ import app
from deploy.live.control import Answer, ControlServer
from deploy.page import source as page_source
from deploy.page.address import Address, address_of
from deploy.page.picture import Picture
from deploy.page.server import Client, PageServer
from deploy.page.source import LiveSource
from deploy.recording.observers import Observers
from deploy.scenario import resolve
from deploy.scoring.scorer import Score, Scorer
from deploy.simulation import Simulation
from deploy.storage.run_directory import RunDirectory
from protocol.endpoints import free_port
from protocol.node import Gone
from protocol.settings import BadSetting


class Played:
    """A simulation that has been played for some ticks, as a source; a click moves it on."""

    def __init__(self, ticks: int = 12) -> None:
        self.simulation = Simulation(resolve("quick", {"run.seconds": 60.0}))
        self.picture = Picture(self.simulation.scenario)
        self.jumps = 0
        self.period = 0.1
        self.asked: list[dict[str, Any]] = []
        self.simulation.scorer.on_event = self.picture.see
        self.play(ticks)

    def play(self, tick: int) -> None:
        while (self.picture.truth is None or self.picture.truth.tick < tick) and self.simulation.bus.step():
            pass

    def scores(self) -> Sequence[Score]:
        return self.simulation.scorer.scores

    def score(self) -> Score | None:
        return self.scores()[-2]

    def beside(self) -> None:
        return None

    def about(self, may_act: bool) -> dict[str, Any]:
        return {"source": "live", "verbs": ["kill"] if may_act else []}

    def extra(self) -> dict[str, Any]:
        return {}

    async def ask(self, request: dict[str, Any]) -> str:
        self.asked.append(request)
        if request.get("verb") == "fail":
            raise BadSetting("nobody to fail")
        if "to" in request:
            self.play(request["to"])
        return "done"

    async def run_while_shown(self) -> None:
        await asyncio.sleep(3600)


@asynccontextmanager
async def served(source: Played, address: Address | None = None) -> AsyncIterator[tuple[PageServer, str, aiohttp.ClientSession]]:
    server = PageServer(source, address or Address("127.0.0.1", free_port(), True))
    url = server.bind()
    await server.open()
    async with aiohttp.ClientSession() as session:
        try:
            yield server, url, session
        finally:
            await server.close()


async def frame_of(ws: aiohttp.ClientWebSocketResponse) -> dict[str, Any]:
    """The next frame, whatever texts come before it."""
    while True:
        message = await ws.receive(timeout=20.0)
        if message.type == aiohttp.WSMsgType.BINARY:
            length = struct.unpack_from("<I", message.data)[0]
            found: dict[str, Any] = msgspec.json.decode(message.data[4 : 4 + length])
            return found
        assert message.type == aiohttp.WSMsgType.TEXT


def test_a_browser_is_greeted_and_shown_the_present_moment_even_when_nothing_moves() -> None:
    async def scene() -> None:
        async with served(Played()) as (_, url, session), session.ws_connect(f"{url}ws") as ws:
            hello = await ws.receive_json(timeout=20.0)
            assert (hello["type"], hello["arena"], hello["verbs"]) == ("hello", [25.0, 25.0], ["kill"])
            assert len(hello["curves"]["time"]) == 12
            assert (await frame_of(ws))["tick"] == 10

    asyncio.run(scene())


def test_frames_follow_the_picture_and_clicks_are_answered() -> None:
    async def scene() -> None:
        source = Played()
        async with served(source) as (_, url, session), session.ws_connect(f"{url}ws") as ws:
            assert (await frame_of(ws))["tick"] == 10
            await ws.send_json({"verb": "go", "to": 20})
            assert await ws.receive_json(timeout=20.0) == {"type": "answer", "ok": True, "text": "done"}
            assert (await frame_of(ws))["tick"] == 18
            await ws.send_json({"verb": "fail"})
            assert await ws.receive_json(timeout=20.0) == {"type": "answer", "ok": False, "text": "nobody to fail"}
            for garbage in ("no json", "[1]"):
                await ws.send_str(garbage)
                assert not (await ws.receive_json(timeout=20.0))["ok"]

    asyncio.run(scene())


def test_a_jump_of_the_source_greets_everybody_again() -> None:
    async def scene() -> None:
        source = Played()
        async with served(source) as (_, url, session), session.ws_connect(f"{url}ws") as ws:
            await frame_of(ws)
            source.jumps += 1
            while (message := await ws.receive(timeout=20.0)).type != aiohttp.WSMsgType.TEXT:
                pass
            assert msgspec.json.decode(message.data)["type"] == "hello"

    asyncio.run(scene())


def test_a_browser_that_cannot_be_greeted_is_let_go_with_a_line_and_another_one_later_is_served(caplog: pytest.LogCaptureFixture) -> None:
    class Broken(Played):
        is_broken = True

        def about(self, may_act: bool) -> dict[str, Any]:
            if self.is_broken:
                raise ZeroDivisionError("in a footprint")
            return super().about(may_act)

    async def scene() -> None:
        source = Broken()
        async with served(source) as (_, url, session):
            async with session.ws_connect(f"{url}ws") as ws:
                assert (await ws.receive(timeout=20.0)).type == aiohttp.WSMsgType.CLOSE
            assert "ZeroDivisionError: in a footprint" in caplog.text
            source.is_broken = False
            async with session.ws_connect(f"{url}ws") as ws:
                assert (await ws.receive_json(timeout=20.0))["type"] == "hello"

    asyncio.run(scene())


def test_a_browser_that_takes_nothing_has_one_frame_waiting_and_counts_the_others() -> None:
    client = Client(None, asyncio.Event())  # type: ignore[arg-type]
    for number in range(5):
        client.offer(bytes([number]))
    assert (client.frame, client.dropped) == (b"\x04", 4)


def test_the_page_its_parts_the_moment_one_agent_and_the_metrics_can_be_fetched() -> None:
    async def scene() -> None:
        async with served(Played()) as (_, url, session):
            for path, kind in (("", "text/html"), ("page.css", "text/css"), ("main.js", "text/javascript"), ("icon.svg", "image/svg+xml")):
                async with session.get(url + path) as answer:
                    assert (answer.status, answer.content_type) == (200, kind)
                    assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
            async with session.get(f"{url}api/frame") as answer:
                assert (await answer.json())["tick"] == 10
            async with session.get(f"{url}api/agent/s1") as answer:
                assert (await answer.json())["name"] == "s1"
            async with session.get(f"{url}metrics") as answer:
                assert 'covey_tick{run="covey"} 12.0' in await answer.text()
            for path in ("api/agent/nobody", "no.html", "..%2fserver.py", "server.py"):
                async with session.get(url + path) as answer:
                    assert answer.status == 404, path

    asyncio.run(scene())


def test_the_page_loads_nothing_from_elsewhere() -> None:
    from deploy.page.server import STATIC

    texts = {file.name: file.read_text(encoding="utf-8") for file in STATIC.iterdir() if file.suffix in (".html", ".css", ".js")}
    assert {"index.html", "page.css", "main.js"} <= set(texts)
    assert [name for name, text in texts.items() if "://" in text.replace('"wss" : "ws"}://${location.host}', "")] == []


def test_foreign_host_names_and_foreign_pages_are_refused() -> None:
    async def scene() -> None:
        async with served(Played()) as (_, url, session):
            for headers in ({"Host": "evil.example"}, {"Host": "evil.example:80"}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
                async with session.get(url, headers=headers) as answer:
                    assert answer.status == 403, headers
                with pytest.raises(aiohttp.WSServerHandshakeError):
                    await session.ws_connect(f"{url}ws", headers=headers)
            async with session.get(url, headers={"Origin": url.rstrip("/")}) as answer:
                assert answer.status == 200

    asyncio.run(scene())


def test_a_page_that_others_can_reach_only_shows() -> None:
    async def scene() -> None:
        source = Played()
        address = Address("0.0.0.0", free_port(), True)
        near = f"http://127.0.0.1:{address.port}/ws"
        async with served(source, address) as (_, _, session), session.ws_connect(near) as ws:
            assert (await ws.receive_json(timeout=20.0))["verbs"] == []
            await frame_of(ws)
            for request in ({"verb": "kill", "who": "s1"}, {"drag": 1, "to": [1, 1]}):
                await ws.send_json(request)
                assert "only shows" in (await ws.receive_json(timeout=20.0))["text"]
        assert source.asked == []

    asyncio.run(scene())


def test_browsers_are_told_when_the_run_is_over() -> None:
    async def scene() -> None:
        async with served(Played()) as (server, url, session), session.ws_connect(f"{url}ws") as ws:
            await frame_of(ws)
            await server.close()
            assert await ws.receive_json(timeout=20.0) == {"type": "bye"}

    asyncio.run(scene())


def test_a_port_that_is_taken_is_an_error_when_it_was_asked_for_and_otherwise_another_is_found() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(BadSetting, match=f"--page 127.0.0.1:{port}: .* take another port"):
            PageServer(Played(3), Address("127.0.0.1", port, True)).bind()
        server = PageServer(Played(3), Address("127.0.0.1", port, False))
        assert f":{port}/" not in server.bind()
        asyncio.run(server.close())


def test_page_is_a_port_or_host_and_port() -> None:
    assert address_of(False) is None
    assert address_of(True) == Address("127.0.0.1", 8737, False)
    assert address_of("8080") == Address("127.0.0.1", 8080, True)
    assert address_of("0.0.0.0:80") == Address("0.0.0.0", 80, True)
    assert address_of("[::1]:80") == Address("::1", 80, True)
    assert address_of("8080").is_loopback and address_of("[::1]:80").is_loopback  # type: ignore[union-attr]
    for wrong in ("quick", "80000", "host:", ""):
        with pytest.raises(BadSetting, match="should be a port"):
            address_of(wrong)


@pytest.mark.parametrize(
    ("words", "page"),
    [
        ([], True),
        (["--page"], True),
        (["--no-page"], False),
        (["--page", "0"], "0"),
        (["--page", "1"], "1"),
        (["--page=[::1]:0"], "[::1]:0"),
    ],
)
def test_zero_is_a_free_port_and_not_a_no(words: list[str], page: bool | str) -> None:
    _, bound, _ = app.parse_args(["demo", *words])
    assert bound.arguments.get("page", True) == page
    address = address_of(page)
    assert (address is None) == (page is False)


def test_what_cannot_be_shown_is_logged_once_however_often_a_browser_asks(caplog: pytest.LogCaptureFixture) -> None:
    class Broken(Played):
        def about(self, may_act: bool) -> dict[str, Any]:
            raise ZeroDivisionError("a greeting that always fails")

    async def scene() -> None:
        async with served(Broken()) as (_, url, session):
            for _ in range(3):
                async with session.ws_connect(f"{url}ws") as ws:
                    assert (await ws.receive(timeout=20.0)).type == aiohttp.WSMsgType.CLOSE

    asyncio.run(scene())
    assert [record.message[:28] for record in caplog.records] == ["a browser could not be shown"]


def test_links_can_be_cut_from_the_page_where_the_scenario_allows_link_faults() -> None:
    for allowed in (True, False):
        scenario = resolve("quick", {"network.link_faults": allowed})
        source = LiveSource(Scorer(scenario), Picture(scenario), RunDirectory("some"))
        assert ("partition" in source.about(True)["verbs"], "heal" in source.about(True)["verbs"]) == (allowed, allowed)
        assert "kill" in source.about(True)["verbs"]
        assert source.about(False)["verbs"] == []


def watched(
    ticks: int, directory: RunDirectory | None = None, has_ended: Callable[[], bool] = lambda: False
) -> tuple[Simulation, PageServer]:
    """A simulation of 12 ticks with a page beside it, played for some of them."""
    simulation = Simulation(resolve("quick", {"run.seconds": 3.0, "run.dt": 0.25, "team.composition": "3E"}))
    server = PageServer(LiveSource(simulation.scorer, Picture(simulation.scenario), directory), Address("127.0.0.1", 0, True))
    Observers(simulation.scorer, None, server, has_ended)
    while simulation.scorer.truth is None or simulation.scorer.truth.tick < ticks - 1:
        simulation.bus.step()
    simulation.bus.step(simulation.bus.now)
    return simulation, server


def states(server: PageServer) -> list[str]:
    return [known.state for known in server.source.picture.agents.values()]


def leave(simulation: Simulation, *tokens: tuple[str, str]) -> None:
    for role, name in tokens:
        simulation.scorer.handle(Gone(role, name, 1), simulation.bus.now)  # type: ignore[arg-type]


@pytest.mark.parametrize("first", [("world", "world"), ("body", "s1")])
def test_who_leaves_after_the_last_tick_of_the_world_is_no_dead_on_the_page(first: tuple[str, str]) -> None:
    simulation, server = watched(12)
    leave(simulation, first, ("agent", "s1"), ("agent", "s2"))
    assert states(server) == ["alive"] * 3
    assert server.is_frozen


def test_who_leaves_after_the_run_has_been_scored_is_no_dead_on_the_page() -> None:
    simulation, server = watched(6)
    simulation.scorer.finish(simulation.bus.now)
    leave(simulation, ("agent", "s1"), ("world", "world"))
    assert states(server) == ["alive"] * 3
    assert server.is_frozen


def test_who_is_dismissed_because_the_run_is_ended_early_is_no_dead_on_a_page_outside() -> None:
    simulation, server = watched(6, has_ended=lambda: True)
    leave(simulation, ("world", "world"), ("agent", "s1"), ("agent", "s2"))
    assert states(server) == ["alive"] * 3
    assert server.is_frozen


def test_a_world_that_dies_in_the_middle_is_not_the_end_of_the_page() -> None:
    simulation, server = watched(6)
    leave(simulation, ("world", "world"), ("agent", "s1"))
    assert states(server) == ["dead", "alive", "alive"]
    assert not server.is_frozen


def test_a_frame_says_that_the_run_is_over_and_how_fast_it_went() -> None:
    async def scene() -> None:
        simulation, server = watched(12)
        url = server.bind()
        await server.open()
        try:
            async with aiohttp.ClientSession() as session, session.ws_connect(f"{url}ws") as ws:
                first = await frame_of(ws)
                assert "over" not in first and first["tick_rate"][1:] == [None, 0, 0]
                for tick in range(20, 23):
                    simulation.scorer.tick_rate.tick(time.monotonic() - 0.25 * (22 - tick), tick)
                simulation.scorer.finish(simulation.bus.now)
                last = await frame_of(ws)
                assert last["over"] is True
                await asyncio.sleep(0.3)
                async with session.get(f"{url}api/frame") as answer:
                    assert (await answer.json())["tick_rate"] == last["tick_rate"]  # no tick is missing after the last one
        finally:
            await server.close()

    asyncio.run(scene())


def test_a_paused_agent_whose_token_goes_is_paused_on_the_page_until_it_is_killed() -> None:
    simulation, server = watched(6)
    simulation.scorer.note_fault("pause", "pause s1, s2", "s1,s2")
    leave(simulation, ("agent", "s1"))
    assert states(server) == ["paused", "paused", "alive"]
    simulation.scorer.note_fault("kill", "kill s1", "s1")
    simulation.scorer.note_fault("resume", "resume s2", "s2")
    assert states(server) == ["dead", "alive", "alive"]
    assert [kill.name for kill in simulation.scorer.result(0.0).kills] == ["s1"]


def test_faults_stand_once_on_the_page_of_the_supervisor_and_on_one_outside_and_both_show_its_tick_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path))
    monkeypatch.setattr(page_source, "STATE_PERIOD", 0.01)
    directory = RunDirectory("r")
    directory.path.mkdir(parents=True)
    (supervised, inside), (_, outside) = watched(6, directory), watched(6, directory)
    for verb, who in (("pause", "s1"), ("resume", "s1"), ("partition", "")):
        supervised.scorer.note_fault(verb, f"{verb} {who}", who)

    async def scene() -> None:
        asked = 0

        async def answer(request: dict[str, Any]) -> Answer:
            nonlocal asked
            asked += 1
            swarm = {"waiting": "", "tick_rate": {"ticks_per_s": 4.0, "asked_per_s": 4.0, "skipped": 53, "late": 22}}
            return {"ok": "", "data": {"swarm": swarm, "processes": [], "faults": supervised.scorer.faults}}

        control = ControlServer(directory, answer)
        await control.open()
        pages = [asyncio.create_task(server.source.run_while_shown()) for server in (inside, outside)]
        while asked < 4:
            await asyncio.sleep(0.01)
        for page in pages:
            page.cancel()
        await control.close()

    asyncio.run(scene())
    for server in (inside, outside):
        assert [one.kind for one in server.source.picture.happenings] == ["paused", "heard", "partition"]
        assert server.source.extra()["tick_rate"] == [4.0, 4.0, 53, 22]
