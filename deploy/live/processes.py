"""One child process of a run: started, paused, resumed, killed, and looked at. Nothing here waits.

A child ends with its supervisor whatever happens. Its stdin is a pipe that only the supervisor holds, and it asks the kernel for SIGKILL
when the thread that started it ends. So children are started from the main thread only.
"""

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from deploy.installation import ROOT, command, environment
from deploy.live.zygote import Forked, Zygote
from deploy.scenario import Scenario, world_names
from deploy.storage.run_directory import RunDirectory

Spawn = Literal["zygote", "exec"]  # how agents are started
State = Literal["running", "awake", "paused", "dead"]

CRASHES = (1, *(-number for number in (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGILL, signal.SIGFPE)))
LAST_BYTES = 1 << 16  # of a log, in which the cause of an end is looked for
LARGEST_INCARNATION = 2**63 - 1
EXIT_FENCED = 3  # of an agent that has met a younger process of its name


@dataclass
class Child:
    """A process of the run under its name, through all its incarnations."""

    name: str
    package: str  # agents or world: what it runs
    directory: RunDirectory
    arguments: list[str]  # endpoints, and the sensor of an agent
    incarnation: int = 0
    paused: bool = False
    log_begin: int = 0  # byte of its log at which the newest incarnation begins
    returncode: int | None = None  # of the newest incarnation; negative: the signal that ended it
    ended_at: float | None = None  # Unix time, for people only
    seen_stopped: bool = False  # since the last signal that was sent from here
    body_of: str = ""  # the agent whose body it is; empty: it is none
    process: subprocess.Popen[bytes] | Forked | None = field(default=None, repr=False)
    unwritten: bytes = field(default=b"", repr=False)  # the rest of a line for which its pipe had no room
    next_line: bytes = field(default=b"", repr=False)  # to be written after that
    zygote: Zygote | None = field(default=None, repr=False)  # forks it; None: it is executed

    @property
    def has_started(self) -> bool:
        """Whether it has ever been started: it is no dead process before."""
        return self.incarnation > 0

    @property
    def is_running(self) -> bool:
        """Whether the process exists and has not been seen to end; a paused one is running."""
        return self.process is not None

    def is_in(self, state: State) -> bool:
        """Whether it is in a state; `awake` is running and not paused."""
        return {
            "running": self.is_running,
            "awake": self.is_running and not self.paused,
            "paused": self.paused,
            "dead": self.has_started and not self.is_running,
        }[state]

    @property
    def token(self) -> tuple[str, str]:
        """Role and name of its liveliness token."""
        return ("body", self.body_of) if self.body_of else (self.package.removesuffix("s"), self.name)

    @property
    def pid(self) -> int | None:
        """Its process id while it runs and as soon as it is known."""
        return self.process.pid if self.process else None

    def start(self, *extra: str, newest: int = 0) -> None:
        """Start the next incarnation; raises OSError, and nothing has changed but its number.

        `newest`: the largest incarnation that is known of its name. Peers refuse a smaller one than they have heard.
        """
        assert self.process is None
        self.incarnation = min(max(self.incarnation, newest), LARGEST_INCARNATION - 1) + 1
        log = self.directory.log(self.name)
        self.log_begin = log.stat().st_size if log.exists() else 0
        self._fork(extra)
        self.paused, self.seen_stopped, self.returncode, self.ended_at = False, False, None, None

    def _fork(self, extra: Sequence[str]) -> None:
        """Let the zygote fork the process, or execute it; raises OSError when neither is possible."""
        config = self.directory.agents if self.package == "agents" else self.directory.config
        halt = str(self.directory.log(self.name).with_suffix(".halt"))
        halted = ["--keep-halt", halt] if self.package == "world" else []
        own = ["--body", self.body_of, "--keep", halt] if self.body_of else ["--name", self.name, *halted]
        words = [*own, "--config", str(config), "--supervised"]
        words += ["--incarnation", str(self.incarnation), *self.arguments, *extra]
        if self.zygote is not None:
            with contextlib.suppress(OSError):  # a zygote that has died: the child is executed instead
                self.process = self.zygote.fork(words, self.directory.log(self.name))
                return
        with self.directory.log(self.name).open("ab") as log:
            self.process = subprocess.Popen(
                [*command(self.package), *words],
                cwd=ROOT,
                env=child_environment(),
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                process_group=0,  # Ctrl-C in the terminal is the supervisor's alone
            )

    def poll(self) -> bool:
        """Notice the end of the process; True when it has ended since the last look."""
        if self.process is None or self.process.poll() is None:
            return False
        if self.process.stdin is not None:
            self.process.stdin.close()
        self.returncode, self.ended_at = self.process.returncode, time.time()
        self.process, self.paused, self.seen_stopped, self.unwritten, self.next_line = None, False, False, b"", b""
        return True

    def send(self, number: signal.Signals) -> None:
        """Send a signal if it runs."""
        if self.process is not None:
            self.process.send_signal(number)
            self.seen_stopped = False
            self.paused = number == signal.SIGSTOP or (self.paused and number != signal.SIGCONT)

    def look(self) -> Literal["pause", "resume", ""]:
        """Notice a SIGSTOP or SIGCONT that was not sent from here, on Linux.

        A SIGSTOP sent from here counts as obeyed from the start: on a busy machine the kernel shows it later.
        """
        stopped = self.pid is not None and is_stopped(self.pid)
        if stopped == self.seen_stopped:
            return ""
        self.seen_stopped = stopped
        if stopped == self.paused:
            return ""
        self.paused = stopped
        return "pause" if stopped else "resume"

    def tell(self, line: str) -> None:
        """Write a line to its standard input, which says all anew: of those for which its full pipe has no room the newest waits."""
        self.next_line = line.encode() + b"\n"
        self.write_what_waits()

    def write_what_waits(self) -> None:
        """Write as much of the waiting lines as its pipe has room for, each line whole in the end."""
        if self.process is None or self.process.stdin is None:
            self.unwritten = self.next_line = b""
            return
        number = self.process.stdin.fileno()
        os.set_blocking(number, False)
        with contextlib.suppress(OSError):  # the pipe is full, or has no reader any more
            while self.unwritten or self.next_line:
                if not self.unwritten:
                    self.unwritten, self.next_line = self.next_line, b""
                self.unwritten = self.unwritten[os.write(number, self.unwritten) :]

    def end(self) -> str:
        """How it ended, for people: `killed by SIGKILL`, `exit code 2`; empty while it runs."""
        if self.returncode is None:
            return ""
        if self.returncode < 0:
            return f"killed by {signal.Signals(-self.returncode).name}"
        return f"exit code {self.returncode}{': a younger process of this name has taken over' if self.returncode == EXIT_FENCED else ''}"

    @property
    def crashed(self) -> bool:
        """Whether it ended by an exception or a crash of its own: neither done, nor stopped, nor killed."""
        return self.returncode in CRASHES

    def last_log_line(self) -> str:
        """Why it ended, from its log since its own start: its last exception, or the complaint after it, which is no JSON.

        Without both its last message.
        """
        try:
            with self.directory.log(self.name).open("rb") as log:
                begin = max(self.log_begin, log.seek(0, os.SEEK_END) - LAST_BYTES)
                log.seek(begin)
                lines = log.read().decode(errors="replace").splitlines()
        except OSError:
            return ""
        whole = [line for line in lines[begin > self.log_begin :] if line.strip()]
        reasons = [line for line in whole if not line.startswith("{") or '"exception"' in line] or whole
        return _message(reasons[-1]) if reasons else ""


def is_stopped(pid: int) -> bool:
    """Whether the kernel says that a process is stopped (state T); False where there is no /proc."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[0] == "T"
    except OSError:
        return False


def _message(line: str) -> str:
    """What a line of a log says: the last line of its exception where it has one; a line that is no record says itself."""
    try:
        record = json.loads(line) if line.startswith("{") else None
    except ValueError:
        record = None
    if record is None:
        return line
    exception = str(record.get("exception", "")).strip().splitlines()
    return exception[-1] if exception else str(record.get("message", line))


def packages(scenario: Scenario) -> dict[str, str]:
    """The processes of a run, and the package that each runs."""
    return {**dict.fromkeys(world_names(scenario), "world"), **dict.fromkeys(scenario.members, "agents")}


def process_rows(children: Mapping[str, Child], members: Mapping[str, str], agents: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Every process as `ps` shows it, with the scorer's figures of agents; agents that were not started here come last."""
    scored = {agent["name"]: agent for agent in agents}
    rows: list[dict[str, Any]] = []
    for name, child in children.items():
        state = "paused" if child.paused else "running" if child.is_running else "dead" if child.has_started else "waiting"
        row: dict[str, Any] = {"name": name, "class": members.get(name, ""), "state": state, "pid": child.pid}
        row |= {"incarnation": child.incarnation, "end": child.end(), "ended_at": child.ended_at}
        rows.append({**scored.pop(name, {}), **row})
    guest = {"class": "", "state": "guest", "pid": None, "end": "", "ended_at": None}
    return rows + [{**agent, **guest} for agent in scored.values() if agent["alive"]]


def child_environment() -> dict[str, str]:
    """The environment of children: they look for a user's own modules in the user's folder, after ours; numpy uses one thread."""
    return {**environment(), "COVEY_MODULES": os.getcwd(), "OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
