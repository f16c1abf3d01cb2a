"""The live driver: one node, one process, asyncio and Zenoh. No other file of agents, world and their observers imports zenoh.

Zenoh's threads only apply the rate limit and the faults of links, and append to the inbox. Decoding, the node and its timers run in the
event loop. Every message names its Zenoh session, so the quarantine excludes a sender of garbage and not the agent of the key.
"""

import asyncio
import contextlib
import ctypes
import json
import logging
import math
import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import Future, InvalidStateError
from typing import Any

os.environ.setdefault(  # read by zenoh when it is imported: fewer threads, less CPU
    "ZENOH_RUNTIME", "(rx: (handover: app), acc: (handover: app), tx: (handover: app), net: (handover: app), app: (worker_threads: 1))"
)

import zenoh

from protocol import codec, keys
from protocol.access import common_name, secured
from protocol.arrival_queue import Arrival, ArrivalQueue, DelayQueue
from protocol.endpoints import check_endpoints, check_files, check_owner, endpoint_error, on_any_port
from protocol.link_faults import LiveLink
from protocol.liveliness_tokens import ALONE_SECONDS, Tokens
from protocol.message import Message
from protocol.node import NO_EFFECTS, Effect, Event, Node, Reopen, Started, Stop, Subscribe, Timer, Unsubscribe, Warn
from protocol.reception import Reception
from protocol.sender_limits import RateLimiter
from protocol.settings import BadSetting, NetworkSettings
from protocol.so_linger import Sockets
from protocol.stdin import follow_stdin
from protocol.zenoh_settings import session_values

CLOSE_SECONDS = 2.0
SO_LINGER_SHARE = 0.25  # of the lease between two passes over new sockets; links live for the lease at least
RETRY_SECONDS = 0.5  # between attempts to open a session anew
MOST_TRIES = 4  # on the same port, then on any port
SETTLE_SECONDS = 2.0  # in which a new session sees again the tokens that the old one saw
SLICE = 64  # messages between two passes over the timers

log = logging.getLogger(__name__)
_kept = threading.local()


def keep_thread_state() -> None:
    """Keep the state that Python has made for the calling thread of Zenoh; without this, each callback makes a new one and frees it."""
    if not hasattr(_kept, "state"):
        _kept.state = ctypes.pythonapi.PyGILState_Ensure()  # never released: the interpreter keeps a state that is in use


def session_config(settings: NetworkSettings, own: keys.Token | None = None) -> zenoh.Config:
    """The Zenoh configuration of the participant with that token."""
    config = zenoh.Config()
    for key, value in {**session_values(settings), **secured(settings, own)}.items():
        config.insert_json5(key, json.dumps(value))
    return config


def open_session(settings: NetworkSettings, own: keys.Token | None = None) -> zenoh.Session:
    """A Zenoh session; raises BadSetting in one line when the endpoints or certificates cannot be used. Blocks."""
    check_endpoints(settings)
    check_files(settings, common_name(own))
    check_owner(settings, common_name(own))
    try:
        return zenoh.open(session_config(settings, own))
    except zenoh.ZError as error:
        raise endpoint_error(settings, str(error)) from None


def open_for(result: Future[zenoh.Session], settings: NetworkSettings, own: keys.Token) -> None:
    """Set the result to a session that is opened now; if it has been cancelled meanwhile, close the session again."""
    try:
        session = open_session(settings, own)
    except Exception as error:
        with contextlib.suppress(InvalidStateError):
            result.set_exception(error)
        return
    try:
        result.set_result(session)
    except InvalidStateError:
        with contextlib.suppress(zenoh.ZError):
            session.close()


class Driver:
    """Drives one node over one Zenoh session inside a running event loop."""

    def __init__(self, node: Node, settings: NetworkSettings, link: LiveLink | None = None) -> None:
        self.counts: Counter[str] = Counter()  # sent, sent_bytes, received, rejected, quarantined, flooded, failed_puts, reopened
        self._node = node
        self._settings = settings
        # Faults of links count from the arrival on: with them no message waits for others of its kind.
        self._inbox = ArrivalQueue(coalesced_keys=node.coalesced_keys if link is None else "")
        self._delays = None if link is None else DelayQueue(link, self._inbox)
        self._delay_timer: asyncio.TimerHandle | None = None
        self._rate_limiter = RateLimiter(settings.most_per_second)
        self._own = keys.Token(node.run, node.role, node.name, node.incarnation)
        self._tokens = Tokens(self._own, [keys.all_tokens(node.run)] if node.sees_all_tokens else [])
        self._reception = Reception(self._tokens, self.counts)
        self._reopening: asyncio.Task[None] | None = None
        self._sockets = Sockets()
        self._wanted: Counter[str] = Counter()  # expression -> how often the node subscribed
        self._subscribers: dict[str, Any] = {}
        self._publishers: dict[str, tuple[Any, Any]] = {}
        self._declared: list[Any] = []  # kept, because Zenoh undeclares objects without references
        self._session: zenoh.Session | None = None
        self._left = 0  # sessions that this driver has left
        self._next_pass: asyncio.Handle | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._timer_at: float | None = None
        self._loop = asyncio.get_running_loop()
        self._stopped: asyncio.Future[int] = self._loop.create_future()

    async def open(self) -> None:
        """Open the session, unless `stop` comes first; raises BadSetting when the endpoints cannot be used.

        A client waits for its router without a limit, in a thread of its own: asyncio would join the threads of its pool.
        """
        result = Future[zenoh.Session]()
        threading.Thread(target=open_for, args=(result, self._settings, self._own), daemon=True).start()
        opened = asyncio.wrap_future(result)
        either: tuple[asyncio.Future[Any], ...] = (opened, self._stopped)
        try:
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
        finally:
            if not result.cancel():
                self._session = await opened

    async def serve(self) -> int:
        """Run until the node or `stop` ends it; returns the exit code. Raises what `open` and the node raise."""
        self._loop.call_later(ALONE_SECONDS, self._tokens.warn_if_alone, self._settings.seeds)
        if self._session is None:
            await self.open()
        try:
            if not self._stopped.done():
                self._begin()
            return await self._stopped
        finally:
            self._disarm()
            if self._delay_timer is not None:
                self._delay_timer.cancel()
            if self._reopening is not None:
                self._reopening.cancel()
                await asyncio.wait([self._reopening])
            await self._close()
            log.info("left the run", extra={"counts": dict(self.counts), "unread": self.unread})

    def _begin(self) -> None:
        self._clear_so_linger()
        self._declare()
        self._handle_all([Started()])

    def stop(self, code: int, reason: str) -> None:
        """End `serve` with this exit code; the first call counts."""
        if not self._stopped.done():
            log.info("stopping: %s", reason)
            self._stopped.set_result(code)

    @property
    def unread(self) -> int:
        """Messages that the node has not received, because newer ones of the same key came before it had the time."""
        return self._inbox.dropped

    def _clear_so_linger(self) -> None:
        """Take SO_LINGER off new sockets, now and periodically, so that a dead link does not block the others."""
        self._sockets.clear_so_linger()
        if not self._stopped.done():
            self._loop.call_later(SO_LINGER_SHARE * self._settings.lease, self._clear_so_linger)

    def _declare(self) -> None:
        """Subscribe to the tokens of all participants if the node sees all, and declare the own token.

        What the node subscribes to at `Started` follows: a peer that sees the token may speak before this node hears it.
        """
        assert self._session is not None
        liveliness, everybody = self._session.liveliness(), self._node.sees_all_tokens
        self._declared = [
            *([liveliness.declare_subscriber(keys.all_tokens(self._node.run), self._token_callback(), history=True)] if everybody else []),
            liveliness.declare_token(keys.token_key(*self._own)),
        ]

    async def _close(self, declared: list[Any] | None = None) -> None:
        """Close the session within `CLOSE_SECONDS`; release the `declared` objects afterwards.

        It takes a thread of its own, because asyncio waits for the threads of its pool without a limit.
        """
        session, self._session = self._session, None
        if session is None:
            return
        self._left += 1
        closed = asyncio.Event()

        def close(held: Any = declared) -> None:
            with contextlib.suppress(zenoh.ZError, RuntimeError):
                try:
                    session.close()
                finally:
                    self._loop.call_soon_threadsafe(closed.set)

        threading.Thread(target=close, daemon=True).start()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(closed.wait(), CLOSE_SECONDS)

    # ------------------------------------------------------------------ Zenoh's threads

    def _on_sample(self, sample: zenoh.Sample) -> None:
        keep_thread_state()
        key, origin = str(sample.key_expr), sample.source_info
        if self._rate_limiter.admits(key, origin, self._loop.time()):
            self._arrive(Arrival(key, sample.payload.to_bytes(), origin))
        else:
            self.counts["flooded"] += 1

    def _token_callback(self) -> Callable[[zenoh.Sample], None]:
        """What takes the tokens of this session, until it is left: what it says later is not what the next one sees."""
        left = self._left

        def on_token(sample: zenoh.Sample) -> None:
            if left == self._left:
                self._arrive(Arrival(str(sample.key_expr), token=sample.kind == zenoh.SampleKind.PUT))

        return on_token

    def _arrive(self, arrival: Arrival) -> None:
        """Put an arrival into the inbox; where links have faults, by way of its link, whose delay counts from now."""
        if self._inbox.add(arrival) if self._delays is None else self._delays.add(arrival, self._loop.time()):
            with contextlib.suppress(RuntimeError):  # the loop has been closed
                self._loop.call_soon_threadsafe(self._drain)

    # ------------------------------------------------------------------ the event loop

    def _drain(self) -> None:
        self._release_delayed()
        self._receive(self._inbox.take(SLICE, self._node.most_observations))

    def _drain_all(self) -> None:
        self._drain()
        for _ in range(math.ceil(len(self._inbox) / SLICE)):
            self._drain()

    def _release_delayed(self) -> None:
        """Let what is due on faulty links into the inbox, and set a timer to the next."""
        if self._delays is None:
            return
        due = self._delays.release(self._loop.time())
        if self._delay_timer is not None:
            self._delay_timer.cancel()
        self._delay_timer = None if due == math.inf else self._loop.call_at(due, self._drain)

    def _receive(self, arrivals: list[Arrival]) -> None:
        self._handle_all(self._reception.events(arrivals, self._loop.time()))

    def _handle_all(self, events: Iterable[Event]) -> None:
        """Hand the node events, then tell the inbox how many coalesced messages wake the node now; they may be there already."""
        for event in events:
            self._handle(event)
        if self._next_pass is not None:  # one is enough
            self._next_pass.cancel()
        self._next_pass = self._loop.call_soon(self._drain) if self._inbox.finish_pass(self._node.wake_up_count) else None

    def _handle(self, event: Event) -> None:
        """Hand the node an event. An exception in the node ends the process."""
        if self._stopped.done():
            return
        try:
            effects = self._node.handle(event, self._loop.time())
            for effect in effects:
                self._carry_out(effect)
            if effects is not NO_EFFECTS or self._timer is None:
                self._arm()
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """End `serve` with an error; after the end it is only logged."""
        if self._stopped.done():
            log.error("an error after the end", exc_info=error)
        else:
            self._stopped.set_exception(error)

    def _carry_out(self, effect: Effect) -> None:
        if isinstance(effect, Message):
            self._put(keys.message_key(self._node.run, effect), codec.encode(effect))
        elif isinstance(effect, Subscribe):
            self._subscribe(effect.expression)
        elif isinstance(effect, Unsubscribe):
            self._unsubscribe(effect.expression)
        elif isinstance(effect, Stop):
            self.stop(effect.code, effect.reason)
        elif isinstance(effect, Warn):
            log.warning(effect.text)
        elif isinstance(effect, Reopen) and self._delays is None and (self._reopening is None or self._reopening.done()):
            # not with injected link faults: silence proves nothing then
            log.warning("opening the session anew: %s", effect.reason)
            self._reopening = self._loop.create_task(self._reopen())

    async def _reopen(self) -> None:
        """Leave the network and join it again. An exception that is none of the network's ends the process."""
        try:
            await self._join_again()
        except Exception as error:
            self._fail(error)

    async def _join_again(self) -> None:
        """Open another session with the same subscriptions, unless `stop` comes first; messages sent meanwhile are lost."""
        await self._leave()
        tries = 0
        while not self._declared:
            try:
                await self.open()
                if self._stopped.done():
                    return
                for expression in self._wanted:
                    self._listen(expression)
                self._declare()
            except (BadSetting, zenoh.ZError) as error:  # the old session may still hold the port
                log.warning("could not open the session anew: %s", error)
                tries += 1
                self._settings = on_any_port(self._settings) if tries == MOST_TRIES else self._settings
                await self._leave()
                await asyncio.sleep(RETRY_SECONDS)
        self.counts["reopened"] += 1
        await asyncio.sleep(SETTLE_SECONDS)
        self._handle_all(self._tokens.take_lost())

    async def _leave(self) -> None:
        """Close the session: its tokens must be seen again by the next one. All that it has brought is taken before they are suspected."""
        await self._close(self._take_declared())
        self._drain_all()
        self._tokens.suspect_all()

    def _take_declared(self) -> list[Any]:
        """What the session has declared; the next one begins without any."""
        declared = [self._publishers, self._subscribers, self._declared]
        self._publishers, self._subscribers, self._declared = {}, {}, []
        return declared

    def _put(self, key: str, payload: bytes) -> None:
        if self._session is None:
            return
        try:
            if key not in self._publishers:
                publisher = self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
                self._publishers[key] = publisher, zenoh.SourceInfo(publisher.id, 0)
            publisher, source = self._publishers[key]
            publisher.put(payload, source_info=source)
        except zenoh.ZError as error:
            self.counts["failed_puts"] += 1
            log.warning("could not publish under %s: %s", key, error)
            return
        self.counts["sent"] += 1
        self.counts["sent_bytes"] += len(payload)

    def _subscribe(self, expression: str) -> None:
        self._wanted[expression] += 1
        if keys.is_of_tokens(expression):
            self._tokens.follow(expression)
        self._listen(expression)

    def _listen(self, expression: str) -> None:
        if self._session is None or expression in self._subscribers:
            return
        # An indirect callback runs in a thread of its own, which costs a switch for every message. A direct one runs in the thread that
        # reads the sockets and must return soon: see `_arrive`.
        if keys.is_of_tokens(expression):
            callback = zenoh.handlers.Callback(self._token_callback(), indirect=False)
            self._subscribers[expression] = self._session.liveliness().declare_subscriber(expression, callback, history=True)
        else:
            callback = zenoh.handlers.Callback(self._on_sample, indirect=False)
            self._subscribers[expression] = self._session.declare_subscriber(expression, callback, allowed_origin=zenoh.Locality.REMOTE)

    def _unsubscribe(self, expression: str) -> None:
        self._wanted[expression] -= 1
        if self._wanted[expression] <= 0:
            del self._wanted[expression]
            if expression in self._subscribers:
                self._subscribers.pop(expression).undeclare()
            if keys.is_of_tokens(expression):  # a later subscription reports these tokens again
                self._tokens.forget(expression)

    def _arm(self) -> None:
        """Set the timer to the node's deadline; a deadline in the past fires as soon as the loop is free."""
        deadline = self._node.deadline()
        if deadline == self._timer_at:
            return
        self._disarm()
        if deadline is not None:
            self._timer_at = deadline
            self._timer = self._loop.call_at(deadline, self._fire)

    def _disarm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._timer_at = None

    def _fire(self) -> None:
        self._timer = self._timer_at = None
        self._drain_all()  # earlier arrivals come before the timer
        self._handle_all([Timer()])


def ending_signals() -> list[signal.Signals]:
    """The signals that ask a process to end; SIGHUP (a closed terminal) unless it is ignored, as under `nohup`."""
    return [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN else [])]


def run(
    node: Node,
    network: NetworkSettings,
    *,
    watch_stdin: bool = False,
    on_line: Callable[[str], None] | None = None,
    link: LiveLink | None = None,
) -> int:
    """Drive a node until it stops; blocks.

    Return the node's exit code; 129 after SIGHUP, 130 after SIGINT, 143 after SIGTERM or the end of stdin.
    """
    return asyncio.run(_run(node, network, watch_stdin, on_line, link))


async def _run(
    node: Node, network: NetworkSettings, watch_stdin: bool, on_line: Callable[[str], None] | None, link: LiveLink | None
) -> int:
    driver = Driver(node, network, link)
    loop = asyncio.get_running_loop()
    for number in ending_signals():
        loop.add_signal_handler(number, driver.stop, 128 + number, number.name)
    if watch_stdin:
        follow_stdin(driver.stop, on_line)
    return await driver.serve()
