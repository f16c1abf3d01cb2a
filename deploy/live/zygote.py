"""The zygote: a process that has imported all modules and compiled functions and forks one agent process per request.

Each child is a process of its own: its own Zenoh session, log, process group, random streams and end. The zygote opens no session
and starts no thread. It ends with its supervisor, and its children with it; `--spawn exec` does without it.

The supervisor sends requests and hears messages whenever they come, each a JSON object. It waits only for the end of an agent that it
replaces, and not for long.

    {"number": 3, "words": [...]}   to the zygote: fork a child with this command line; its stdin and its log come along
    {"ready": true}                 from it: everything has been imported, and compiled
    {"forked": 3, "pid": 4711}      the child of request 3
    {"failed": 3}                   there is no child of request 3; the reason stands in the log that came along
    {"ended": 4711, "code": -9}     a child has ended
"""

import contextlib
import errno
import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

from deploy.installation import ROOT, command

PROGRAM = command("deploy.live.zygote")
EXIT_UNFORKED = 1  # of a child that could not be forked
END_SECONDS = 2.0  # for the zygote to end by itself once its children have
WAIT_SECONDS = 10.0  # at most for the zygote to tell the end of a child, in which the supervisor does nothing else


@dataclass
class Forked:
    """A child of the zygote, with the part of the interface of subprocess.Popen that the supervisor uses."""

    stdin: Any  # the only write end of its stdin
    zygote: "Zygote"
    pid: int | None = None  # None until the zygote has told it
    returncode: int | None = None
    signals: list[int] = field(default_factory=list)  # that were sent before the pid was known

    def poll(self) -> int | None:
        """The exit code, negative for a signal; None while it runs."""
        self.zygote.collect()
        return self.returncode

    def wait(self) -> int:
        """Wait for the end; the exit code. Raises TimeoutError when the zygote does not tell it: it may be stopped."""
        end = time.monotonic() + WAIT_SECONDS
        while self.poll() is None:
            if time.monotonic() > end:
                raise TimeoutError(errno.ETIMEDOUT, self.zygote.silence())
            time.sleep(0.005)
        assert self.returncode is not None
        self.stdin.close()
        return self.returncode

    def set_pid(self, pid: int) -> None:
        """Note the pid, and deliver the signals that have been waiting for it."""
        self.pid = pid
        for number in self.signals:
            self.send_signal(number)

    def send_signal(self, number: int) -> None:
        """Send a signal unless it has ended."""
        if self.returncode is None and self.pid is None:
            self.signals.append(number)
        elif self.returncode is None and self.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)


class Zygote:
    """The supervisor's end: starts the zygote, requests children, receives their exit codes. Only `close` waits."""

    def __init__(self, environment: dict[str, str], log: Path) -> None:
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._requests: dict[int, Forked] = {}  # by number: children of which the pid is not known
        self._children: dict[int, Forked] = {}  # by pid
        self._number = 0
        self.is_ready = False
        self.is_gone = False
        with log.open("ab") as output:
            self._process = subprocess.Popen(
                [*PROGRAM, str(theirs.fileno())],
                cwd=ROOT,
                env=environment,
                stdin=subprocess.PIPE,  # its end reports a supervisor that died before the zygote asked for a signal
                stdout=output,
                stderr=output,
                pass_fds=[theirs.fileno()],
                process_group=0,
            )
        theirs.close()

    def fileno(self) -> int:
        """For event loops: readable when there is something to collect."""
        return self._channel.fileno()

    def fork(self, words: list[str], log: Path) -> Forked:
        """A new agent process with this command line; raises OSError when the zygote is gone."""
        if self.is_gone:
            raise OSError("the zygote has ended")
        self._number += 1
        request = json.dumps({"number": self._number, "words": words}).encode()
        read, write = os.pipe()
        try:
            with log.open("ab") as output:
                socket.send_fds(self._channel, [request], [read, output.fileno()])
        except OSError:
            os.close(write)
            raise
        finally:
            os.close(read)
        child = self._requests[self._number] = Forked(os.fdopen(write, "wb"), self)
        return child

    def collect(self) -> None:
        """Read the messages of the zygote. Its end means the end of all its children."""
        try:
            while not self.is_gone and select.select([self._channel], [], [], 0.0)[0]:
                data = self._channel.recv(4096)
                if not data:
                    raise ConnectionResetError
                self._hear(json.loads(data))
        except OSError:
            self.is_gone = True
            for child in (*self._children.values(), *self._requests.values()):
                child.returncode = -signal.SIGKILL
            self._children.clear()
            self._requests.clear()

    def _hear(self, message: dict[str, int]) -> None:
        if "ready" in message:
            self.is_ready = True
        elif "forked" in message:
            child = self._children[message["pid"]] = self._requests.pop(message["forked"])
            child.set_pid(message["pid"])
        elif "failed" in message:
            self._requests.pop(message["failed"]).returncode = EXIT_UNFORKED
        elif "ended" in message:
            self._children.pop(message["ended"]).returncode = message["code"]

    def silence(self) -> str:
        """The complaint that it does not answer."""
        pid = self._process.pid
        return (
            f"the process that prepares agents has not answered for {WAIT_SECONDS:.0f} s; `kill -CONT {pid}` lets it go on if it is stopped"
        )

    def kill(self) -> None:
        """End it at once, and with it its children."""
        self._process.kill()

    def close(self) -> None:
        """End the zygote; the children must have ended before, or they go with it."""
        for child in (*self._children.values(), *self._requests.values()):
            child.stdin.close()
        self._channel.close()
        if self.is_ready:  # else it compiles and reads no message
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(END_SECONDS)
        self._process.kill()
        self._process.communicate()


def serve(channel: socket.socket) -> None:
    """Fork on request and report ends, until the supervisor goes."""
    awake, waker = socket.socketpair()
    for end in (awake, waker):
        end.setblocking(False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.set_wakeup_fd(waker.fileno())
    gc.collect()
    channel.send(json.dumps({"ready": True}).encode())
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
            request = json.loads(data)
            try:
                pid = os.fork()
            except OSError as error:  # its end would be that of all its children
                with contextlib.suppress(OSError):
                    os.write(descriptors[1], f"agents: the process could not be forked: {error.strerror}\n".encode())
                answer = {"failed": request["number"]}
            else:
                if pid == 0:
                    signal.set_wakeup_fd(-1)
                    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                    os.setpgid(0, 0)  # Ctrl-C in the terminal is the supervisor's alone
                    for end in (channel, awake, waker):
                        end.close()
                    _be_agent(request["words"], descriptors)
                with contextlib.suppress(OSError):
                    os.setpgid(pid, pid)  # here as well as in the child: either may run first
                answer = {"forked": request["number"], "pid": pid}
            for descriptor in descriptors:
                os.close(descriptor)
            channel.send(json.dumps(answer).encode())


def _report(channel: socket.socket) -> None:
    """Reap ended children and report them."""
    with contextlib.suppress(ChildProcessError):
        while True:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                return
            channel.send(json.dumps({"ended": pid, "code": os.waitstatus_to_exitcode(status)}).encode())


def _be_agent(words: list[str], descriptors: list[int]) -> NoReturn:
    """In the child: become the agent process that `python -m agents` would be."""
    from agents.__main__ import build
    from agents.compiled.backend import FAST
    from agents.config import AgentConfig
    from protocol import process

    stdin, output = descriptors
    for source, target in ((stdin, 0), (output, 1), (output, 2)):
        os.dup2(source, target)
    for descriptor in descriptors:
        os.close(descriptor)
    sys.argv = ["agents", *words]
    process.main("agents", AgentConfig, lambda config, name, incarnation: build(config, name, incarnation, FAST))


def _warm_up() -> None:
    from agents.compiled.warmup import warm  # loads the agents, after the signal has been asked for

    gc.disable()  # there is hardly any garbage in all that is imported, and looking for it took a tenth of the time
    warm()
    gc.enable()


def main(prepare: Callable[[], None]) -> None:
    """Import, prepare what the agents need, serve."""
    from protocol.process import die_with_parent  # and with it zenoh, which the children need; no session is opened here

    channel = socket.socket(fileno=int(sys.argv[1]))
    die_with_parent()
    prepare()
    serve(channel)
    os._exit(0)


if __name__ == "__main__":
    main(_warm_up)
