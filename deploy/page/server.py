"""The server of the page. It listens on loopback by default and keeps one frame per browser.

Each frame is encoded once for all browsers. A newer frame replaces one that still waits for a slow browser. Requests with a foreign host
name or from a foreign page are refused, so that no other web site can see the swarm or kill agents.
"""

import asyncio
import contextlib
import logging
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from aiohttp import WSMsgType, web
from aiohttp.typedefs import Handler

from deploy.page.address import LOOPBACK, Address
from deploy.page.frames import belief, frame, greeting, moment
from deploy.page.metrics import CONTENT_TYPE, PageFigures, metrics_page
from deploy.page.source import Source
from protocol.endpoints import free_port
from protocol.settings import BadSetting

IDLE_PERIOD = 0.5  # s between two frames of one tick, for figures such as messages per second
SEND_SECONDS = 20.0  # a browser that takes nothing for so long is let go
MOST_CLIENTS = 64
STATIC = Path(__file__).parent / "static"
TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; connect-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}

log = logging.getLogger(__name__)


@dataclass(eq=False)
class Client:
    """One browser."""

    socket: web.WebSocketResponse
    wake: asyncio.Event
    frame: bytes | None = None  # the one that waits
    roster_version: int = -1
    dropped: int = 0

    def offer(self, data: bytes) -> None:
        """Let a frame wait in place of the one that waits now."""
        self.dropped += self.frame is not None
        self.frame = data
        self.wake.set()


class PageServer:
    """Serves one source; `bind`, then `open` in an event loop, then `close`."""

    def __init__(self, source: Source, address: Address) -> None:
        self.source = source
        self.figures = PageFigures()
        self._address = address
        self._socket: socket.socket | None = None
        self._clients: set[Client] = set()
        self._tasks: list[asyncio.Task[None]] = []
        self._runner: web.AppRunner | None = None
        self._jumps = source.jumps
        self._shown: tuple[Any, ...] = ()
        self._version = -1
        self._shown_at = 0.0
        self._at_end: dict[str, Any] | None = None  # what frames say beside the picture once the run is over
        self._failures: set[tuple[str, type]] = set()  # that have been logged

    def bind(self) -> str:
        """Take the port and return the page's address; raises BadSetting when it is taken."""
        host, port, fixed = self._address
        reason = ""
        for number in (port, *([] if fixed else [free_port()])):
            try:
                self._socket = socket.create_server((host, number), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
                break
            except OSError as error:
                reason = error.strerror or str(error)
        if self._socket is None:
            raise BadSetting(f"--page {host}:{port}: {reason}; take another port")
        return f"http://{f'[{host}]' if ':' in host else host}:{self._socket.getsockname()[1]}/"

    async def open(self) -> None:
        """Start to serve."""
        if self._socket is None:
            self.bind()
        assert self._socket is not None
        app = web.Application(middlewares=[self._guard], client_max_size=4096)
        app.router.add_get("/ws", self._websocket)
        app.router.add_get("/metrics", self._metrics)
        app.router.add_get("/api/frame", self._frame)
        app.router.add_get("/api/agent/{name}", self._agent)
        app.router.add_get("/{file:[a-z]*(\\.[a-z]+)?}", self._static)
        self._runner = web.AppRunner(app, access_log=None, handle_signals=False, shutdown_timeout=1.0)
        await self._runner.setup()
        await web.SockSite(self._runner, self._socket).start()
        self._tasks = [asyncio.create_task(self._broadcast()), asyncio.create_task(self._run_source())]

    def freeze(self) -> None:
        """The run is over: what is shown stays, and says so."""
        self._at_end = self._at_end or {**self.source.extra(), "over": True}

    @property
    def is_frozen(self) -> bool:
        """Whether the run is over."""
        return self._at_end is not None

    def _extra(self) -> dict[str, Any]:
        return self._at_end or self.source.extra()

    async def close(self) -> None:
        """Say goodbye to the browsers and stop to serve."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for client in list(self._clients):
            with contextlib.suppress(Exception):
                async with asyncio.timeout(0.5):
                    await client.socket.send_str('{"type":"bye"}')
                    await client.socket.close()
        if self._runner is not None:
            await self._runner.cleanup()
        elif self._socket is not None:
            self._socket.close()

    async def _run_source(self) -> None:
        try:
            await self.source.run_while_shown()
        except BadSetting as error:
            log.error("%s; what is shown stays", error)
        except Exception:
            log.exception("the page's source has failed")

    async def _broadcast(self) -> None:
        """Send a frame to all browsers for each new tick, at most once per period of the source."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            if self._clients:
                try:
                    self._show()
                except Exception as error:
                    self._log_once("a frame could not be drawn", error)
            due = max(due + self.source.period, loop.time() + 0.01)  # what one frame was late the next one is early
            await asyncio.sleep(due - loop.time())

    def _show(self) -> None:
        if self._jumps != self.source.jumps:
            self._jumps = self.source.jumps
            self._greet_again()
        extra, picture, score = self._extra(), self.source.picture, self.source.score()
        happened = picture.happenings[-1].number if picture.happenings else 0
        state = (score.tick if score else picture.time, happened, picture.paused, picture.roster_version, repr(extra))
        now = asyncio.get_running_loop().time()
        if state == self._shown and (picture.version == self._version or now - self._shown_at < IDLE_PERIOD):
            return
        self._shown, self._version, self._shown_at = state, picture.version, now
        data = frame(picture, score, extra, self.source.beside())
        self.figures.frames += 1
        self.figures.frame_bytes += len(data)
        for client in self._clients:
            client.offer(data)

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse foreign host names (DNS rebinding) and foreign pages; say what browsers may load."""
        origin = request.headers.get("Origin")
        if self._address.is_loopback and request.url.host not in LOOPBACK:
            raise web.HTTPForbidden(text="this page is served under 127.0.0.1 or localhost only\n")
        if origin is not None and origin.partition("://")[2] != request.host:
            raise web.HTTPForbidden(text="requests from other pages are refused\n")
        response = await handler(request)
        if not response.prepared:
            response.headers.update(HEADERS)
        return response

    async def _static(self, request: web.Request) -> web.Response:
        file = STATIC / (request.match_info["file"] or "index.html")
        if file.suffix not in TYPES or not file.is_file():
            raise web.HTTPNotFound(text="there is no such page\n")
        return web.Response(body=file.read_bytes(), content_type=TYPES[file.suffix], charset="utf-8")

    async def _metrics(self, request: web.Request) -> web.Response:
        self.figures.clients = len(self._clients)
        text = metrics_page(self.source.picture, self.source.score(), self.figures)
        return web.Response(body=text, headers={"Content-Type": CONTENT_TYPE})

    async def _frame(self, request: web.Request) -> web.Response:
        data = {**moment(self.source.picture, self.source.score()), **self._extra()}
        return web.Response(body=msgspec.json.encode(data), content_type="application/json")

    async def _agent(self, request: web.Request) -> web.Response:
        data = belief(self.source.picture, request.match_info["name"])
        if data is None:
            raise web.HTTPNotFound(text="there is no such agent\n")
        return web.Response(body=msgspec.json.encode(data), content_type="application/json")

    async def _websocket(self, request: web.Request) -> web.WebSocketResponse:
        """One browser: a greeting, frames as fast as it takes them, and its clicks."""
        if len(self._clients) >= MOST_CLIENTS:
            raise web.HTTPServiceUnavailable(text="too many browsers\n")
        ws = web.WebSocketResponse(heartbeat=20.0, compress=False, max_msg_size=4096)
        await ws.prepare(request)
        client = Client(ws, asyncio.Event())
        self._clients.add(client)
        client.wake.set()
        sender = asyncio.create_task(self._send(client))
        try:
            async for message in ws:
                if message.type == WSMsgType.TEXT:
                    await self._answer(client, message.data)
        finally:
            self._clients.discard(client)
            sender.cancel()
            await asyncio.gather(sender, return_exceptions=True)
        return ws

    async def _send(self, client: Client) -> None:
        """Send what waits; a new greeting first whenever the roster has changed."""
        try:
            while not client.socket.closed:
                await client.wake.wait()
                client.wake.clear()
                async with asyncio.timeout(SEND_SECONDS):
                    if client.roster_version != self.source.picture.roster_version:
                        client.roster_version = self.source.picture.roster_version
                        await client.socket.send_str(self._greeting())
                        client.frame = client.frame or frame(self.source.picture, self.source.score(), self._extra(), self.source.beside())
                    data, client.frame = client.frame, None
                    if data is not None:
                        await client.socket.send_bytes(data)
                self.figures.dropped += client.dropped
                client.dropped = 0
        except Exception as error:
            if not isinstance(error, ConnectionError | TimeoutError):
                self._log_once("a browser could not be shown anything, and is let go; it asks again by itself", error)
            await client.socket.close()

    def _log_once(self, what: str, error: Exception) -> None:
        """Log an error that is being handled, unless it has been logged: it comes again with every frame, or whenever a browser asks."""
        if (what, type(error)) not in self._failures:
            self._failures.add((what, type(error)))
            log.exception(what)

    def _greeting(self) -> str:
        return greeting(self.source.picture, self.source.scores(), self.source.about(self._address.is_loopback)).decode()

    async def _answer(self, client: Client, text: str) -> None:
        """Carry out a click, where clicks are allowed, and say what came of it."""
        try:
            request = msgspec.json.decode(text)
            if not isinstance(request, dict):
                raise BadSetting("a request is a JSON object")
            if not self._address.is_loopback and not request.keys().isdisjoint(("verb", "drag")):
                raise BadSetting("this page only shows: it can be reached from other machines")
            answer = {"type": "answer", "ok": True, "text": await self.source.ask(request)}
        except (BadSetting, msgspec.DecodeError) as error:
            answer = {"type": "answer", "ok": False, "text": str(error)}
        with contextlib.suppress(ConnectionError):
            await client.socket.send_str(msgspec.json.encode(answer).decode())

    def _greet_again(self) -> None:
        """Everybody gets a new greeting: a replay has jumped, or its curves have grown."""
        for client in self._clients:
            client.roster_version = -1
            client.wake.set()
