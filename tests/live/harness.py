"""The `covey` command in a folder of the test's own, and a look at what it runs. The folder is where COVEY_RUNS says."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deploy.swarm.control import ControlClient
from deploy.swarm.rundir import find_running
from protocol.settings import BadSetting

ROOT = Path(__file__).parents[2]
BOUND = 60.0  # s; reached only when something hangs


class Covey:
    """The command line, as a user has it in one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[subprocess.Popen[str]] = []
        self.pids: set[int] = set()
        self._environment = {**os.environ, "PYTHONPATH": str(ROOT)}

    def start(self, *words: str) -> subprocess.Popen[str]:
        """The command, running."""
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "deploy", *words],
            cwd=self.folder,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
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
            client = ControlClient(find_running(None))
            data = client.ask("status")["data"]
            client.close()
        except BadSetting:
            return None
        self.pids |= {row["pid"] for row in data["processes"] if row["pid"]}
        return data

    def wait(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The first status that fulfils the condition."""
        end = time.monotonic() + BOUND
        while time.monotonic() < end:
            data = self.status()
            if data is not None and condition(data):
                return data
            time.sleep(0.05)
        raise AssertionError(f"not reached: {data}")

    def running(self) -> dict[str, Any]:
        """The status once all processes run and the world's time has begun."""
        return self.wait(lambda data: data["swarm"]["tick"] >= 1 and all(row["state"] == "running" for row in data["processes"]))

    def wait_until_gone(self) -> None:
        """Return when none of the processes that `status` has shown exists any more."""
        end = time.monotonic() + BOUND
        while any(exists(pid) for pid in self.pids):
            assert time.monotonic() < end, f"orphans: {[pid for pid in self.pids if exists(pid)]}"
            time.sleep(0.02)


def exists(pid: int) -> bool:
    """Whether a process of that id runs our code and is no zombie."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False
    return b"run.toml" in words


def rows(data: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The processes of a status by name."""
    return {row["name"]: row for row in data["processes"]}
