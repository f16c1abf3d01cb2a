"""The zygote: a process that has imported everything, compiled loops included, and forks one agent process per request.

Each child is a process of its own: its own Zenoh session, log, process group, random streams and end. The zygote opens no session
and starts no thread. It ends with its supervisor, and its children with it; `--spawn exec` does without it.
"""

import contextlib
import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parents[2]
ANSWER_SECONDS = 120.0  # that the zygote may take to import, and on the very first start to compile


@dataclass
class Forked:
    """A forked child, with the part of subprocess.Popen's face that the supervisor uses."""

    pid: int
    stdin: Any  # the only write end of its stdin
    zygote: "Zygote"
    returncode: int | None = field(default=None)

    def poll(self) -> int | None:
        """The exit code, negative for a signal; None while it runs."""
        self.zygote.collect()
        return self.returncode

    def wait(self) -> int:
        """Wait for the end; the exit code."""
        while self.poll() is None:
            time.sleep(0.005)
        assert self.returncode is not None
        self.stdin.close()
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal unless it has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)


class Zygote:
    """The supervisor's end: starts the zygote, asks for children, hears of their ends."""

    def __init__(self, environment: dict[str, str], log: Path) -> None:
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._children: dict[int, Forked] = {}
        self._ready = False
        with log.open("ab") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "deploy.swarm.zygote", str(theirs.fileno())],
                cwd=ROOT,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                pass_fds=[theirs.fileno()],
                process_group=0,
            )
        theirs.close()

    def fileno(self) -> int:
        """For event loops: readable when a child has ended."""
        return self._channel.fileno()

    def wait_until_ready(self) -> None:
        """Wait until everything has been imported; at once when it has."""
        with contextlib.suppress(OSError):
            if not self._ready:
                self._answer("ready")
            self._ready = True

    def fork(self, words: list[str], log: Path) -> Forked:
        """A new agent process with this command line; raises OSError when the zygote is gone."""
        read, write = os.pipe()
        try:
            with log.open("ab") as output:
                socket.send_fds(self._channel, [json.dumps(words).encode()], [read, output.fileno()])
            pid = self._answer("forked")
        except OSError:
            os.close(write)
            raise
        finally:
            os.close(read)
        child = self._children[pid] = Forked(pid, os.fdopen(write, "wb"), self)
        return child

    def _answer(self, to: str) -> int:
        """The value of the first message that holds `to`; other messages are noted on the way."""
        end = time.monotonic() + ANSWER_SECONDS
        while time.monotonic() < end:
            if select.select([self._channel], [], [], 1.0)[0]:
                message = self._receive()
                if to in message:
                    return message[to]
        raise OSError("the zygote does not answer")

    def collect(self) -> None:
        """Hear who has ended; if the zygote itself has, all its children have."""
        try:
            while select.select([self._channel], [], [], 0.0)[0]:
                self._receive()
        except OSError:
            for child in self._children.values():
                child.returncode = -signal.SIGKILL
            self._children.clear()

    def _receive(self) -> dict[str, int]:
        data = self._channel.recv(4096)
        if not data:
            raise OSError("the zygote has ended")
        message: dict[str, int] = json.loads(data)
        if "ended" in message and message["ended"] in self._children:
            self._children.pop(message["ended"]).returncode = message["code"]
        return message

    def close(self) -> None:
        """End the zygote; the children must have ended before, or they go with it."""
        for child in self._children.values():
            child.stdin.close()
        self._channel.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(2.0)
        self._process.kill()
        self._process.wait()


def serve(channel: socket.socket) -> None:
    """Fork on request and report ends, until the supervisor goes."""
    awake, waker = socket.socketpair()
    for end in (awake, waker):
        end.setblocking(False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.set_wakeup_fd(waker.fileno())
    gc.collect()
    channel.send(json.dumps({"ready": 1}).encode())
    gc.freeze()  # so that collections in a child do not copy the pages of what was imported
    while True:
        ready, _, _ = select.select([channel, awake], [], [])
        if awake in ready:
            awake.recv(4096)
            _report(channel)
        if channel in ready:
            data, descriptors, _, _ = socket.recv_fds(channel, 65536, 2)
            if not data:
                return
            pid = os.fork()
            if pid == 0:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                os.setpgid(0, 0)  # Ctrl-C in the terminal is the supervisor's alone
                for end in (channel, awake, waker):
                    end.close()
                _be_agent(json.loads(data), descriptors)
            with contextlib.suppress(OSError):
                os.setpgid(pid, pid)  # here as well as in the child, so that it holds whoever comes first
            for descriptor in descriptors:
                os.close(descriptor)
            channel.send(json.dumps({"forked": pid}).encode())


def _report(channel: socket.socket) -> None:
    """Reap and tell who has ended."""
    with contextlib.suppress(ChildProcessError):
        while True:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                return
            channel.send(json.dumps({"ended": pid, "code": os.waitstatus_to_exitcode(status)}).encode())


def _be_agent(words: list[str], descriptors: list[int]) -> NoReturn:
    """In the child: become the agent process that `python -m agents` would be."""
    from agents.__main__ import build
    from agents.config import AgentConfig
    from agents.fast import FAST
    from protocol import process

    stdin, output = descriptors
    for source, target in ((stdin, 0), (output, 1), (output, 2)):
        os.dup2(source, target)
    for descriptor in descriptors:
        os.close(descriptor)
    sys.argv = ["agents", *words]
    process.main("agents", AgentConfig, lambda config, name, incarnation: build(config, name, incarnation, FAST))


def main() -> None:
    """Import, warm up, serve."""
    from protocol.process import die_with_parent  # and with it zenoh, which the children need; no session is opened here

    channel = socket.socket(fileno=int(sys.argv[1]))
    die_with_parent()
    from deploy.swarm.warm import warm

    warm()
    if os.environ.get("COVEY_ROUNDS") == "empty":  # the reference of `covey bench live`
        from deploy.bench import empty

        empty.install()
    serve(channel)
    os._exit(0)


if __name__ == "__main__":
    main()
