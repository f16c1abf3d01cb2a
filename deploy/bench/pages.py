"""`covey bench page`: does a swarm in lockstep run slower while somebody looks at it? Runs with and without a page, in turns."""

import asyncio
import json
import os
import resource
import statistics
import sys
import tempfile

import aiohttp

from deploy.bench.processes import TEAMS
from deploy.bench.timing import Row
from deploy.swarm.processes import ROOT

AGENTS, SECONDS, PAIRS = 48, 20.0, 3


def measure(pairs: int = PAIRS, agents: int = AGENTS, seconds: float = SECONDS) -> list[Row]:
    """A row for every run, the order turned round from pair to pair, and last what the page costs in the median of the pairs."""
    rows: list[Row] = []
    ratios: dict[str, list[float]] = {"ticks per s": [], "CPU of everybody, s": []}
    for pair in range(pairs):
        found = {page: asyncio.run(run(page, agents, seconds)) for page in ((False, True) if pair % 2 else (True, False))}
        rows += [found[False], found[True]]
        for name, values in ratios.items():
            values.append(found[True][name] / found[False][name])
    share = {name: 100.0 * (statistics.median(values) - 1.0) for name, values in ratios.items()}
    return [*rows, {"what": "with the page, %", **share}]


async def run(page: bool, agents: int, seconds: float) -> Row:
    """One run in lockstep; with a page there is one browser that takes every frame and draws nothing."""
    words = ["up", "efficacy", "--team", TEAMS[agents], "--lockstep", "--seconds", str(seconds), "--run", "bench", "--json"]
    with tempfile.TemporaryDirectory() as folder:
        before = _children_seconds()
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-m", "deploy", *words, *(["--page", "0"] if page else [])),
            cwd=ROOT,
            env={**os.environ, "COVEY_RUNS": folder, "PYTHONPATH": str(ROOT)},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        assert process.stdout is not None
        assert process.stderr is not None
        looking = asyncio.create_task(_look(process.stderr))
        output = await process.stdout.read()
        await process.wait()
    result = json.loads(output.splitlines()[-1])
    return {
        "what": f"{agents} agents, {'page and browser' if page else 'no page'}",
        "ticks per s": result["ticks"] / result["wall_s"],
        "CPU of everybody, s": _children_seconds() - before,
        "frames": await looking,
        "load": os.getloadavg()[0],
    }


async def _look(lines: asyncio.StreamReader) -> int:
    """Read what the command says to its end, and look at the page of which it speaks; the number of frames."""
    browser: asyncio.Task[int] | None = None
    async for line in lines:
        if line.startswith(b"page: "):
            browser = asyncio.create_task(_take_frames(line.split()[1].decode()))
    return await browser if browser is not None else 0


async def _take_frames(url: str) -> int:
    async with aiohttp.ClientSession() as session:
        while True:
            try:
                async with session.ws_connect(f"{url}ws", max_msg_size=0) as socket:
                    return sum([message.type == aiohttp.WSMsgType.BINARY async for message in socket])
            except aiohttp.ClientConnectorError:
                await asyncio.sleep(0.05)  # the port is taken before anybody answers there


def _children_seconds() -> float:
    """CPU time of all processes that this one has started and that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
