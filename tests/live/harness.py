"""The `covey` command in a folder of the test's own, and a look at what it runs. The folder is where COVEY_RUNS says.

Nothing here measures by waiting: a test waits for a condition, or reads in the recording of a run what happened when.
"""

import contextlib
import fcntl
import json
import math
import os
import signal
import subprocess
import sys
import termios
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from deploy.live.control import ControlClient
from deploy.recording.recording import Recording, event_of
from deploy.recording.rescore import rescore
from deploy.scoring.scorer import Score
from deploy.storage.run_directory import find_running
from protocol.message import Message
from protocol.node import Alive, Event, Gone, messages_of
from protocol.settings import BadSetting

ROOT = Path(__file__).parents[2]
BOUND = 100.0  # s; reached only when something hangs
PATIENT = ("--set", "run.patience=60", "--set", "network.lease=30")  # on a busy machine, too, nobody is given up who only is late
LEDGER = """
[arena]
width = 40.0
height = 40.0
[team]
composition = "L8"
[targets]
count = 0
[detection]
clutter = 0.0
[filter]
lifetime = 0.0
border = "reflect"
prior_density = 0.01
[birth]
background = false
measurement = false
[sensors.L]
angle = 240.0
radius = 8.0
prob_detection = 1e-12
"""  # a swarm whose mass must not change
MASS = 16.0  # expected targets in it


Said = TypeVar("Said", bound=Message)


class Covey:
    """The command line, as a user has it in one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[subprocess.Popen[str]] = []
        self.runs = folder / "runs"
        self._environment = {**os.environ, "PYTHONPATH": str(ROOT), "COVEY_RUNS": str(self.runs)}
        folder.mkdir(exist_ok=True)
        (folder / "ledger.toml").write_text(LEDGER)

    def start(
        self,
        *words: str,
        module: str = "deploy",
        limit: Callable[[], None] | None = None,
        variables: dict[str, str] | None = None,
        terminal: int | None = None,
    ) -> subprocess.Popen[str]:
        """The command, or another module as a program, running; with a `terminal` in front on it, in a session of its own."""
        pipe = subprocess.PIPE if terminal is None else terminal

        def take_terminal() -> None:
            if terminal is not None:
                fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)
            if limit is not None:
                limit()

        process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *words],
            cwd=self.folder,
            env={**self._environment, **(variables or {})},
            preexec_fn=take_terminal,
            start_new_session=terminal is not None,
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
            text=True,
        )
        self.started.append(process)
        return process

    def run(self, *words: str) -> tuple[int, str, str]:
        """Exit code, output and complaints of a command that ends by itself."""
        process = self.start(*words)
        output, complaints = process.communicate(timeout=2.0 * BOUND)
        return process.returncode, output, complaints

    def result(self, *words: str) -> dict[str, Any]:
        """The JSON object at the end of a run."""
        code, output, complaints = self.run(*words, "--json")
        assert code == 0, complaints
        return json.loads(output.splitlines()[-1])

    def status(self) -> dict[str, Any] | None:
        """What `ps --json` would say, None while there is nobody to ask."""
        try:
            data = ControlClient(find_running(None)).ask("status")["data"]
        except BadSetting:
            return None
        return data

    def wait(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The first status that fulfils the condition."""
        end = time.monotonic() + BOUND
        while time.monotonic() < end:
            data = self.status()
            if data is not None and condition(data):
                return data
            time.sleep(0.05)
        raise AssertionError(f"not reached: {data}; {self.last_log_line()}")

    def running(self) -> dict[str, Any]:
        """The status once all processes run and the world's time has begun."""
        return self.wait(lambda data: data["swarm"]["tick"] >= 1 and all(row["state"] == "running" for row in data["processes"]))

    def seeds(self, run: str = "latest") -> tuple[str, ...]:
        """Where the processes of a run can be dialled."""
        return tuple(tomllib.loads((self.runs / run / "run.toml").read_text())["network"]["seeds"])

    def by_hand(self, name: str, incarnation: int, sensor_class: str = "", config: Path | None = None) -> subprocess.Popen[str]:
        """One more agent process of the running swarm, which the supervisor knows nothing of; of a class, if it is no member."""
        sensor = ("--sensor", sensor_class) if sensor_class else ()
        words = ("--name", name, *sensor, "--config", str(config or self.runs / "latest" / "agents.toml"))
        return self.start(*words, "--incarnation", str(incarnation), "--supervised", module="agents")

    def processes(self) -> set[int]:
        """Every process that runs for this test, by the variable that all of them have inherited; no zombies."""
        mark = f"COVEY_RUNS={self.runs}".encode()
        found = set()
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if mark in (folder / "environ").read_bytes().split(b"\0"):
                    found.add(int(folder.name))
        return found  # the environment of a zombie is empty

    def wait_until_gone(self) -> None:
        """Return when no process is left."""
        end = time.monotonic() + BOUND
        while left := self.processes():
            assert time.monotonic() < end, f"orphans: {[Path(f'/proc/{pid}/cmdline').read_text() for pid in left]}"
            time.sleep(0.02)

    def kill_all(self) -> None:
        """End whatever is left, whether it is paused or not."""
        for pid in self.processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def last_log_line(self, run: str = "latest") -> str:
        """The end of every log, for whoever must find out why a test failed."""
        logs = sorted((self.runs / run / "logs").glob("*.jsonl"))
        return "\n".join(f"{log.stem}: {log.read_text(errors='replace')[-300:]}" for log in logs)


class Journal:
    """What a recorded run has said, when (Unix time, s), and how each tick was scored."""

    def __init__(self, covey: Covey, run: str = "latest") -> None:
        recording = Recording(covey.runs / run / "recording.mcap")
        self.heard: list[tuple[float, Event]] = [(entry.published / 1e9, event_of(entry)) for entry in recording.entries()]
        self.scores = {score.tick: score for score in rescore(recording).scores}

    def said(self, kind: type[Said], start: float = 0.0, end: float = math.inf) -> list[tuple[float, Said]]:
        """The messages of one kind that were heard in a span of time."""
        found = [(at, message) for at, event in self.heard if start <= at <= end for message in messages_of(event)]
        return [(at, message) for at, message in found if isinstance(message, kind)]

    def tokens(self, kind: type[Alive] | type[Gone], name: str) -> list[tuple[float, int]]:
        """When a token of that name appeared or vanished, and its incarnation."""
        return [(at, event.incarnation) for at, event in self.heard if isinstance(event, kind) and event.name == name]

    def masses(self, start: int, end: int | None = None) -> list[float]:
        """The mass that all agents own after the ticks from `start` to `end` (excluded), in shares of what it must be."""
        return [score.mass / MASS for tick, score in self.scores.items() if start <= tick < (end or math.inf)]

    def after(self, start: int) -> list[Score]:
        """The scores of the ticks from `start` on."""
        return [score for tick, score in self.scores.items() if tick >= start]


def rows(data: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The processes of a status by name."""
    return {row["name"]: row for row in data["processes"]}
