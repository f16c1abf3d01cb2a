"""`covey bench start`, `memory`, `live`, `realtime` and `tls`: real processes over loopback, from `covey up` to the first tick and on.

Rates are ticks within a window of wall time. Beside them stands the CPU time per tick of all agents and the world, which a busy machine
disturbs less. The reference of `live` is the same swarm with empty rounds (`deploy.bench.empty`).
"""

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from deploy import installation
from deploy.bench.timing import BenchRow
from deploy.live.certificates import make_keys
from deploy.live.control import ControlClient
from deploy.storage.run_directory import RunDirectory
from protocol.settings import BadSetting

PAGE_TOTAL = "Pss:"
START_SECONDS = 180.0
NAME = "bench"
TEAMS = {16: "A4,B12", 32: "3", 48: "5", 96: "A12,C48,D36", 200: "A25,C100,D75"}
SETTLE, WINDOW = 0.2, 10.0  # wall s: before anything is measured, for each agent, and then


class SwarmReading(NamedTuple):
    """Where a run stands: wall time s, tick, CPU time of world and agents s, rounds that agents skipped and that were late."""

    at: float
    tick: int
    cpu: float
    skipped: int


class Swarm:
    """A swarm that runs for a benchmark."""

    def __init__(self, process: "subprocess.Popen[bytes]", folder: Path, begun: float) -> None:
        self.folder = folder
        self._process = process
        self._log = folder / "logs" / "supervisor.jsonl"
        self.first_tick = self._wait(lambda: self._log.exists() and "the first tick" in self._log.read_text(encoding="utf-8")) - begun
        self._client = ControlClient(RunDirectory(NAME))
        self.first_round = self._wait(lambda: self.status()["swarm"]["tick"] >= 0) - begun

    def _wait(self, done: Any) -> float:
        """Until something is so; when that was."""
        end = time.monotonic() + START_SECONDS
        while not done():
            if time.monotonic() > end or self._process.poll() is not None:
                raise BadSetting(f"bench: the swarm has not started within {START_SECONDS:g} s")
            time.sleep(0.02)
        return time.monotonic()

    @property
    def pid(self) -> int:
        """The process of the supervisor."""
        return self._process.pid

    def ask(self, verb: str, who: str) -> None:
        """Let the supervisor carry out a fault."""
        self._client.ask(verb, who=who)

    def status(self) -> dict[str, Any]:
        """What `covey ps` is told."""
        data: dict[str, Any] = self._client.ask("status")["data"]
        return data

    def mark(self) -> SwarmReading:
        """Where it stands now."""
        data = self.status()
        spent = sum(cpu_of(row["pid"]) for row in data["processes"] if row["pid"])
        return SwarmReading(time.monotonic(), data["swarm"]["tick"], spent, sum(row.get("skipped", 0) for row in data["processes"]))

    def memory(self) -> float:
        """Proportional set size of all agents, MB."""
        return sum(pss(row["pid"]) for row in self.status()["processes"] if row["pid"] and row["name"] != "world") / 1024.0

    def end(self) -> BenchRow:
        """Take it down; its result."""
        self._client.ask("down")
        output, _ = self._process.communicate(timeout=START_SECONDS)
        result: BenchRow = json.loads(output.splitlines()[-1])
        return result

    def deliveries(self, rounds: int) -> float:
        """Messages that an agent received per round, from the logs of a swarm that has ended."""
        received = 0
        for log in (self.folder / "logs").glob("s*.jsonl"):
            for line in log.read_text(encoding="utf-8").splitlines():
                if '"left the run"' in line:
                    received += json.loads(line)["counts"].get("received", 0)
        return received / max(rounds, 1)


@contextmanager
def swarm(agents: int, spawn: str, words: list[str], *, empty: bool = False) -> Iterator[Swarm]:
    """A swarm of processes of section IV-B; ended at the latest when the context is left."""
    before = os.environ.get("COVEY_RUNS")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["COVEY_RUNS"] = folder
        program = installation.command("deploy.bench.empty") if empty else installation.command("deploy")
        command = [*program, "up", "efficacy", "--team", TEAMS[agents], "--run", NAME, "--json", "--spawn", spawn]
        process = subprocess.Popen(
            [*command, "--seconds", "1000000", *words],
            cwd=installation.ROOT,
            env=installation.environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        begun = time.monotonic()
        try:
            yield Swarm(process, Path(folder) / NAME, begun)
        finally:
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            os.environ.pop("COVEY_RUNS")
            if before is not None:
                os.environ["COVEY_RUNS"] = before


def run(agents: int, spawn: str, settings: tuple[str, ...] = (), *, empty: bool = False, window: float = WINDOW) -> BenchRow:
    """One lockstep run: s from `covey up` to the first closed round, ticks per s, CPU per tick, messages, memory."""
    words = ["--lockstep", *[word for setting in settings for word in ("--set", setting)]]
    with swarm(agents, spawn, words, empty=empty) as running:
        time.sleep(SETTLE * agents)
        begin = running.mark()
        time.sleep(window)
        end, memory = running.mark(), running.memory()
        result = running.end()
        received = running.deliveries(result["rounds"])
    ticks = max(end.tick - begin.tick, 1)
    return {
        "agents": agents,
        "spawn": spawn,
        "settings": " ".join(settings),
        "rounds": "empty" if empty else "real",
        "first round, s": running.first_round,
        "ticks per s": (end.tick - begin.tick) / (end.at - begin.at),
        "CPU per tick, ms": 1000.0 * (end.cpu - begin.cpu) / ticks,
        "received per agent-round": received,
        "bytes per message": result["bytes"] / max(result["messages"], 1),
        "PSS, MB": memory,
        "load": os.getloadavg()[0],
    }


ROUTER, NEIGHBOURS = ("network.mode=client",), ("timing.interest=neighbours",)


def start() -> Iterator[BenchRow]:
    """From `covey up` to the first closed round, and memory, with both ways to start, and behind a router."""
    for agents in (16, 48):
        for spawn, settings in (("zygote", ()), ("zygote", ROUTER), ("exec", ())):
            yield run(agents, spawn, settings, window=2.0)


def live(agents: tuple[int, ...] = (16, 48, 96)) -> Iterator[BenchRow]:
    """Lockstep rates, each after the same swarm with empty rounds, and the ratio of the two, by rate and by CPU."""
    for number in agents:
        for settings in _choices(number):
            reference, real = (run(number, "zygote", settings, empty=empty) for empty in (True, False))
            real["of the empty rate"] = real["ticks per s"] / max(reference["ticks per s"], 1e-9)
            real["of the empty CPU"] = reference["CPU per tick, ms"] / max(real["CPU per tick, ms"], 1e-9)
            yield from (reference, real)


def _choices(agents: int) -> list[tuple[str, ...]]:
    """Full mesh or router, and the interest; more than 48 agents never form a full mesh."""
    everybody: list[tuple[str, ...]] = [(), ROUTER] if agents <= 48 else [ROUTER]
    return everybody if agents < 48 else [*everybody, (*NEIGHBOURS, *ROUTER)]


def realtime(agents: int = 48, seconds: float = 60.0) -> Iterator[BenchRow]:
    """At 4 Hz for so long, behind a router and linked to everybody: rounds that were skipped, and the CPU that agents and world use."""
    for settings in (ROUTER, ()):
        yield _in_real_time(agents, seconds, settings)


def tls(agents: int = 16, seconds: float = 15.0, turns: int = 3) -> Iterator[BenchRow]:
    """At 4 Hz over plain TCP and over mutual TLS, in turns: the CPU of world and agents, and the ratio of the two."""
    with tempfile.TemporaryDirectory() as folder:
        make_keys(["world", "monitor", *(f"s{number}" for number in range(1, agents + 1))], Path(folder))
        for _ in range(turns):
            plain = _in_real_time(agents, seconds, ())
            secured = _in_real_time(agents, seconds, (), keys=folder)
            secured["of the plain CPU"] = secured["CPU per tick, ms"] / plain["CPU per tick, ms"]
            yield from (plain, secured)


def _in_real_time(agents: int, seconds: float, settings: tuple[str, ...], keys: str = "") -> BenchRow:
    words = [word for setting in settings for word in ("--set", setting)] + (["--keys", keys] if keys else [])
    with swarm(agents, "zygote", words) as running:
        time.sleep(SETTLE * agents)
        begin = running.mark()
        time.sleep(seconds)
        end = running.mark()
        received = running.deliveries(running.end()["rounds"])
    wall = end.at - begin.at
    return {
        "agents": agents,
        "settings": "TLS" if keys else " ".join(settings),
        "wall, s": wall,
        "ticks": end.tick - begin.tick,
        "rounds skipped": end.skipped - begin.skipped,
        "CPU, cores": (end.cpu - begin.cpu) / wall,
        "CPU per tick, ms": 1000.0 * (end.cpu - begin.cpu) / max(end.tick - begin.tick, 1),
        "received per agent-round": received,
        "load": os.getloadavg()[0],
    }


def pss(pid: int) -> int:
    """Proportional set size of a process, kB; 0 when it has gone."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith(PAGE_TOTAL))


def cpu_of(pid: int) -> float:
    """CPU time of a process so far, s; 0 when it has gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
