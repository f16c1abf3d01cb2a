"""A zygote that can fork no more, or is stopped, costs the one process, not the swarm. Both ends of it run in the test's process."""

import errno
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from deploy.live import zygote as zygotes
from deploy.live.zygote import Zygote


class NoProcess:
    """In place of the zygote's process: keeps its end of the channel."""

    pid = 4711

    def __init__(self, words: list[str], pass_fds: list[int], **options: Any) -> None:
        self.channel = socket.socket(fileno=os.dup(pass_fds[0]))


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    """What serving changes in a process is put back."""
    handler = signal.getsignal(signal.SIGCHLD)
    yield
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, handler)


def test_a_fork_that_fails_ends_that_child_alone_and_the_reason_stands_in_its_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "Popen", NoProcess)
    zygote = Zygote({}, tmp_path / "zygote.log")

    def fork() -> int:
        raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", fork)
    children = [zygote.fork(["--name", name], tmp_path / f"{name}.log") for name in ("s1", "s2")]
    zygote._channel.shutdown(socket.SHUT_WR)
    zygotes.serve(zygote._process.channel)  # type: ignore[attr-defined]
    assert [child.poll() for child in children] == [1, 1]
    assert zygote.is_ready and not zygote.is_gone
    for child in children:
        child.stdin.close()
    assert (tmp_path / "s2.log").read_text() == "agents: the process could not be forked: Resource temporarily unavailable\n"


def test_a_zygote_that_is_stopped_does_not_hold_up_whoever_replaces_an_agent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The supervisor waited for ever, and could only be killed."""
    monkeypatch.setattr(subprocess, "Popen", NoProcess)
    monkeypatch.setattr(zygotes, "WAIT_SECONDS", 0.05)
    child = Zygote({}, tmp_path / "zygote.log").fork(["--name", "s1"], tmp_path / "s1.log")
    with pytest.raises(TimeoutError, match="`kill -CONT 4711` lets it go on"):
        child.wait()
    assert child.poll() is None
    child.stdin.close()
