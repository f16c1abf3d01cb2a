"""`echo`, `hz`, `ls`, `record` and `watch --page`: commands that listen to a running swarm from outside."""

import asyncio
import contextlib
import logging
import math
import os
import sys
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from rich.table import Table

from deploy.cli.listener import KeyedPayload, Listener, Rates, expression, kinds, swarm_to_watch
from deploy.cli.message_text import block, plain_line, printable
from deploy.cli.terminal import table_console
from deploy.live.control import ask
from deploy.page.address import address_of
from deploy.page.picture import Picture
from deploy.page.source import LiveSource
from deploy.recording.observers import Observers, open_recorder, recording_path
from deploy.recording.recorder import RecorderNode
from deploy.scenario import Scenario
from deploy.scoring.result import Fault
from deploy.scoring.scorer import Scorer
from deploy.storage.run_directory import RunDirectory
from protocol import live
from protocol.keys import order
from protocol.settings import BadSetting

LOOK_PERIOD = 1.0  # s between two looks whether the run still runs
FAULTS_PERIOD = 0.5  # s between two requests for the list of ordered faults
PLAIN_PERIOD = 2.0  # s between two tables of rates


def own_name(role: str) -> str:
    """A name that is unique among watchers."""
    return f"{role}-{os.getpid()}"


def _until_interrupted(work: Coroutine[Any, Any, int]) -> int:
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    return asyncio.run(work)


def echo(key: str, count: int | None, run: str | None) -> int:
    """Print the messages under a key: blocks in a terminal, JSON lines elsewhere."""
    directory, scenario = swarm_to_watch(run)
    show = block if sys.stdout.isatty() else plain_line
    left = count if count is not None else -1

    def on_heard(heard: KeyedPayload, now: float) -> bool:
        nonlocal left
        print(show(heard), flush=True)
        left -= 1
        return left != 0

    if count is not None and count < 1:
        raise BadSetting(f"--count {count}: should be 1 or more")

    def on_silence(keys: list[str]) -> None:
        where = f"; written are {printable(kinds(keys))}" if keys else ", nor under any other key"
        print(f"covey: nothing is said under {key} so far{where}; still listening, Ctrl-C ends it", file=sys.stderr, flush=True)

    node = Listener(scenario.run.name, own_name("echo"), expression(key, scenario.run.name), on_heard, on_silence=on_silence)
    return _listen(node, directory, scenario)


def check_seconds(seconds: float | None) -> None:
    """Refuse a time to listen that never ends or has already."""
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise BadSetting(f"--seconds {seconds:g}: should be more than 0")


def hz(key: str, seconds: float | None, run: str | None) -> int:
    """Print the message rates and sizes under a key every two seconds."""
    check_seconds(seconds)
    directory, scenario = swarm_to_watch(run)
    rates, console = Rates(), table_console()
    shown_at = time.monotonic()

    def on_heard(heard: KeyedPayload, now: float) -> bool:
        nonlocal shown_at
        rates.note(heard, now)
        if time.monotonic() - shown_at >= PLAIN_PERIOD:
            shown_at = time.monotonic()
            console.print(rates_table(rates))
        return True

    node = Listener(scenario.run.name, own_name("hz"), expression(key, scenario.run.name), on_heard, seconds)
    code = _listen(node, directory, scenario)
    console.print(rates_table(rates))
    return code


def ls(seconds: float, run: str | None) -> int:
    """Print the live processes and all keys with messages, after listening for some seconds."""
    check_seconds(seconds)
    directory, scenario = swarm_to_watch(run)
    rates, console = Rates(), table_console()
    own = own_name("ls")
    node = Listener(scenario.run.name, own, expression("**", scenario.run.name), rates.note, seconds)
    code = _listen(node, directory, scenario)
    console.print(f"run {scenario.run.name}: {scenario.run.scenario}, {len(scenario.members)} agents")
    for role in ("world", "body", "agent", "monitor", "recorder", "operator"):
        names = sorted((name for kind, name, _ in node.tokens if kind == role and name != own), key=order)
        if names:
            console.print(f"{role + 's' * (len(names) > 1)}: {', '.join(names)}", soft_wrap=True)
    console.print(rates_table(rates))
    return code


def rates_table(rates: Rates) -> Table:
    """Keys with their rates."""
    table = Table(box=None, title_justify="left")
    for head in ("key", "1/s", "longest gap, ms", "bytes"):
        table.add_column(head, justify="left" if head == "key" else "right", no_wrap=True)
    for key, rate, gap, size in rates.rows():
        table.add_row(printable(key), "" if rate is None else f"{rate:.1f}", "" if gap is None else f"{1000.0 * gap:.0f}", f"{size:.0f}")
    return table


def record(file: Path | None, run: str | None) -> int:
    """Record a running swarm from outside until Ctrl-C or until it ends."""
    directory, scenario = swarm_to_watch(run)
    path = recording_path(file if file is not None else True, directory.path if directory else Path())
    assert path is not None
    recorder = open_recorder(path, scenario)

    async def work() -> int:
        driver = live.Driver(RecorderNode(recorder, scenario, own_name("recorder")), scenario.network)
        faults = asyncio.create_task(_note_faults(directory, recorder.note_fault)) if directory else None
        try:
            return await _serve_while_running(driver, _end_of(directory))
        finally:
            if faults:
                faults.cancel()

    print(f"recording into {path}; Ctrl-C ends it", flush=True)
    try:
        code = _until_interrupted(work())
    finally:
        recorder.close()
    size = f"{recorder.file_bytes / 1e6:.1f} MB" if recorder.messages else "so there is no recording"
    print(f"{recorder.messages} messages, {size}" + (f"; stopped: {recorder.stopped}" if recorder.stopped else ""))
    return code


async def _note_faults(directory: RunDirectory, note: Callable[[Fault], None]) -> None:
    """Poll the supervisor for ordered faults: no message carries a cut between agents."""
    known = 0
    while True:
        with contextlib.suppress(BadSetting):
            faults = [Fault(*fault) for fault in (await ask(directory, "faults"))["data"]]
            for fault in faults[known:]:
                note(fault)
            known = len(faults)
        await asyncio.sleep(FAULTS_PERIOD)


def watch_page(page: bool | str, run: str | None) -> int:
    """Show a running swarm on a page, as a subscriber from outside."""
    from deploy.page.server import PageServer

    directory, scenario = swarm_to_watch(run)
    address = address_of(page)
    assert address is not None
    scorer = Scorer(scenario, own_name("page"))
    server = PageServer(LiveSource(scorer, Picture(scenario), directory), address)
    print(f"page: {server.bind()}", flush=True)
    print(f"run {scenario.run.name}; Ctrl-C ends the page, not the run", flush=True)

    async def work() -> int:
        async with Observers(scorer, None, server, lambda: directory is not None and not directory.control.exists()):
            return await _serve_while_running(live.Driver(scorer, scenario.network), _end_of(directory))

    return _until_interrupted(work())


def _listen(node: Listener, directory: RunDirectory | None, scenario: Scenario) -> int:
    """Drive a listener until it has heard enough, a signal comes or the run has ended; the exit code."""

    async def work() -> int:
        return await _serve_while_running(live.Driver(node, scenario.network), _end_of(directory))

    return _until_interrupted(work())


def _end_of(directory: RunDirectory | None) -> Callable[[], bool]:
    """Whether a run is running; of a swarm on other machines nobody knows when it ends."""
    return directory.is_running if directory else lambda: True


async def _serve_while_running(driver: live.Driver, is_running: Callable[[], bool]) -> int:
    """Drive a node until a signal comes or the run has ended."""
    loop = asyncio.get_running_loop()
    for number in live.ending_signals():
        loop.add_signal_handler(number, driver.stop, 0, "a signal")
    serving = asyncio.create_task(driver.serve())
    while not serving.done():
        await asyncio.wait([serving], timeout=LOOK_PERIOD)
        if not is_running():
            driver.stop(0, "the run has ended")
    return await serving
