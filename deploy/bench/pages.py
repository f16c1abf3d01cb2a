"""`covey bench page` and `covey bench replay`: what it costs to look at a swarm of 48 agents.

`page`: the same run in lockstep with nobody's page, with a page and one viewer that draws nothing, and with a page in a real browser on
the same cores, in turns. The same ticks are measured in all, and they are the same to the last bit. `replay`: a recording on the page
at 10 ticks/s and at ten times its speed.
"""

import asyncio
import itertools
import os
import statistics
import subprocess
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import aiohttp

from deploy.bench.browser import Browser, browser, parent
from deploy.bench.processes import TEAMS, Swarm, SwarmReading, cpu_of, swarm
from deploy.bench.timing import BenchRow, cpu_seconds, median_seconds
from deploy.installation import ROOT, command, environment
from deploy.page.frames import frame
from deploy.page.picture import Picture
from deploy.recording.recorder import Recorder
from deploy.recording.recording import RecordedEntry, Recording, event_of
from deploy.scoring.scorer import Scorer
from protocol.endpoints import free_port
from protocol.node import Event
from protocol.settings import BadSetting

AGENTS, PAIRS = 48, 3
FIRST_TICK, TICKS = 40, 80  # those measured: the browser has started before
VIEWERS = ("no page", "a viewer that draws nothing", "Chromium")
LOOK = 0.1  # s between two questions where the run stands
REPLAYED = 120.0  # s of the world
DT = 0.25
COUNTED = 8  # chunks of a recording whose messages are counted
MEASURED = 10.0  # wall s of each speed


def measure(pairs: int = PAIRS, agents: int = AGENTS) -> list[BenchRow]:
    """A row for every run, the order turned round from one time to the next, and last what each viewer costs in the median."""
    rows: list[BenchRow] = []
    for turn in range(pairs):
        rows += [run(viewer, agents) for viewer in (VIEWERS if turn % 2 == 0 else VIEWERS[::-1])]
    return [*rows, *compare(rows)]


def compare(rows: list[BenchRow]) -> list[BenchRow]:
    """The difference that each viewer makes to the run without one, %, in the median of the turns."""
    found = []
    for viewer in VIEWERS[1:]:
        row: BenchRow = {"what": f"{viewer} against {VIEWERS[0]}, %"}
        for name in ("ticks per s", "agents and world, ms per tick", "monitor, ms per tick"):
            with_it, without = ([one[name] for one in rows if one["what"] == what] for what in (viewer, VIEWERS[0]))
            row[name] = 100.0 * (statistics.median(a / b for a, b in zip(with_it, without)) - 1.0)
        found.append(row)
    return found


def run(viewer: str, agents: int = AGENTS) -> BenchRow:
    """One run in lockstep: the rate over some ticks, and the CPU that they took."""
    port = free_port()
    url = f"http://127.0.0.1:{port}/"
    words = ["--lockstep", *(["--page", f"127.0.0.1:{port}"] if viewer != VIEWERS[0] else [])]
    with swarm(agents, "zygote", words) as running, _looking(viewer, url) as looking:
        monitor = parent(next(row["pid"] for row in running.status()["processes"] if row["name"] == "world"))
        begin = _reach(running, FIRST_TICK)
        frames, monitor_began, browser_began = _frames(viewer, url), cpu_of(monitor), looking.cpu() if looking else 0.0
        end = _reach(running, begin.tick + TICKS)
        frames, monitor_used, browser_used = _frames(viewer, url) - frames, cpu_of(monitor), looking.cpu() if looking else 0.0
    ticks, wall = end.tick - begin.tick, end.at - begin.at
    return {
        "what": viewer,
        "ticks per s": ticks / wall,
        "agents and world, ms per tick": 1000.0 * (end.cpu - begin.cpu) / ticks,
        "monitor, ms per tick": 1000.0 * (monitor_used - monitor_began) / ticks,
        "monitor, cores": (monitor_used - monitor_began) / wall,
        "browser, cores": (browser_used - browser_began) / wall,
        "frames per s": frames / wall,
        "load": os.getloadavg()[0],
    }


def _reach(running: Swarm, tick: int) -> SwarmReading:
    """Where the run stands once it has come to a tick."""
    while (mark := running.mark()).tick < tick:
        time.sleep(LOOK)
    return mark


@contextmanager
def _looking(viewer: str, url: str) -> Iterator[Browser | None]:
    """A viewer of the page, if one is wanted; yields the browser if it is one."""
    if viewer == VIEWERS[2]:
        with browser(url) as chromium:
            chromium.until("window.covey && covey.frame")
            yield chromium
        return
    thread = threading.Thread(target=lambda: asyncio.run(_take_frames(url)), daemon=True)
    if viewer == VIEWERS[1]:
        thread.start()
    yield None


async def _take_frames(url: str) -> None:
    """Take every frame until the server goes."""
    async with aiohttp.ClientSession() as session, session.ws_connect(f"{url}ws", max_msg_size=0) as server:
        async for _ in server:
            pass


def _frames(viewer: str, url: str) -> float:
    """How many frames the page has encoded."""
    if viewer == VIEWERS[0]:
        return 0.0
    with urllib.request.urlopen(f"{url}metrics") as answer:
        lines = answer.read().decode().splitlines()
    return next(float(line.split()[-1]) for line in lines if line.startswith("covey_page_frames_total"))


def replay(recording: Path | None = None) -> list[BenchRow]:
    """A recording (of `REPLAYED` s and more) in Chromium at 10 ticks/s and at ten times its speed; by default a simulated one."""
    with tempfile.TemporaryDirectory() as folder:
        if recording is None:
            recording = Path(folder) / "bench.mcap"
            words = f"simulate efficacy --team {TEAMS[AGENTS]} --seconds {REPLAYED} --dt {DT} --record {recording}".split()
            _command(words, folder).communicate()
        parts = costs(Recording(recording), Path(folder))
        process = _command(["replay", str(recording), "--page", "0"], folder)
        try:
            assert process.stdout is not None
            url = process.stdout.readline().split()[-1]
            with browser(url) as chromium:
                chromium.until("window.covey && covey.frame && covey.frame.play.scanned")
                chromium.watch()
                return parts + [_play(chromium, process.pid, speed, min(MEASURED, 0.8 * REPLAYED / speed)) for speed in (10.0 * DT, 10.0)]
        finally:
            process.terminate()
            process.communicate()


def costs(recording: Recording, folder: Path) -> list[BenchRow]:
    """CPU of what a monitor does with a message: decode, score, note for the page, record; and of a frame and a greeting."""
    entries = list(recording.entries(0, COUNTED))
    heard = list(map(event_of, entries))
    scorer, picture, recorder = (
        Scorer(recording.scenario, recorded=True),
        Picture(recording.scenario),
        Recorder(folder / "costs.mcap", recording.scenario),
    )
    parts: dict[str, Callable[[RecordedEntry, Event], object]] = {
        "decode": lambda entry, event: event_of(entry),
        "score": lambda entry, event: scorer.handle(event, 0.0),
        "note for the page": lambda entry, event: picture.see(event, 0.0),
        "record": lambda entry, event: recorder.see(event, 0.0),
    }
    rows: list[BenchRow] = []
    for name, part in parts.items():
        spent = cpu_seconds(lambda part=part: [part(*both) for both in zip(entries, heard)])  # type: ignore[misc]
        rows.append({"what": name, "us per message": 1e6 * spent / len(heard)})
    recorder.close()
    frames = median_seconds(lambda: frame(picture, scorer.scores[-2], {}))
    return [*rows, {"what": "draw up a frame", "ms": 1e3 * frames, "kB": len(frame(picture, scorer.scores[-2], {})) / 1e3}]


def _play(chromium: Browser, server: int, speed: float, seconds: float) -> BenchRow:
    """One speed from the beginning on, for some s of the wall clock."""
    chromium.ask(f"[{{seek: 0}}, {{speed: {speed}}}, {{play: true}}].forEach(covey.send)")
    time.sleep(1.0)
    begin, server_began, browser_began, known = time.monotonic(), cpu_of(server), chromium.cpu(), len(chromium.drawn())
    time.sleep(seconds)
    wall, server_used, browser_used = time.monotonic() - begin, cpu_of(server) - server_began, chromium.cpu() - browser_began
    drawn = chromium.drawn()[known:]
    gaps = [later[0] - earlier[0] for earlier, later in itertools.pairwise(drawn)]
    if not gaps:
        raise BadSetting("bench replay: the page draws nothing")
    return {
        "what": f"replay at {speed:g} x",
        "frames drawn per s": 1000.0 * len(gaps) / sum(gaps),
        "longest gap, ms": max(gaps),
        "world s per s": 1000.0 * (drawn[-1][1] - drawn[0][1]) / sum(gaps),
        "server, cores": server_used / wall,
        "browser, cores": browser_used / wall,
        "load": os.getloadavg()[0],
    }


def _command(words: list[str], folder: str) -> "subprocess.Popen[str]":
    """The `covey` command, running."""
    return subprocess.Popen(
        [*command("deploy"), *words],
        cwd=ROOT,
        env={**environment(), "COVEY_RUNS": folder},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
