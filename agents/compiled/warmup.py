"""Loading the compiled functions before they are needed; the first time on a machine compiles them."""

import contextlib
import fcntl
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from agents.agent import Agent
from agents.backend import PLAIN, Backend
from agents.compiled.cache import check_place, compiled_before, is_switched_off, loops_on_disk, note_complete, tidy
from agents.config import AgentConfig, ControlSettings, TimingSettings
from protocol.messages import Beacon, Gossip, Hello, Observation
from protocol.node import Alive, Effect, Started, Timer, received
from protocol.settings import ArenaSettings, convert

NAMES = ("s1", "s2")
SLOWEST_TO_COMPILE = ("update_regions",)  # functions of the backend that take as long to compile as all others together
ROUNDS = 24
LOST = (4, 5)  # ticks in which the agents do not hear each other
SKIPPED = (8, 9)  # ticks that s2 does not see
TICK_SECONDS = 1e3  # between two ticks: every open round closes before the next
LONGEST = 90.0  # s to wait for the next loop while another process compiles

log = logging.getLogger(__name__)


def warm() -> None:
    """Let two agents play a few rounds, good ones and bad ones, so that every compiled loop is in memory; the first time compiles them.

    What only a fault calls for must be among them, or the first fault on a machine makes all agents compile, and be silent for it.
    Of several processes that begin at once one compiles, and the others wait and load what it has left on disk. Raises BadSetting when
    what is compiled cannot be kept.
    """
    if not compiled_before():
        check_place()
    from agents.compiled.backend import FAST

    if not is_switched_off():
        with _one_by_one():
            if not compiled_before() and len(os.sched_getaffinity(0)) > 1:
                _compile_on_two_cores(FAST)
            _play_all(FAST)
            note_complete()
            tidy()
    convert({"members": {"s1": "A"}}, AgentConfig, "")  # types are inspected once here, and not again in every forked child


def _compile_on_two_cores(fast: Backend) -> None:
    """Leave the loops on disk: one half is compiled here, the other by a second process, which ends with this one.

    The half that is compiled here is longer. So the second process begins with a part of it, which is found on disk when its turn comes.
    """
    top = Path(__file__).resolve().parents[__name__.count(".")]  # the folder that the rooms are imported from, or the package around them
    other = subprocess.Popen([sys.executable, "-m", __name__], cwd=top, stdin=subprocess.PIPE)
    try:
        _play_all(PLAIN._replace(**{name: getattr(fast, name) for name in SLOWEST_TO_COMPILE}))
        _wait_for(other)
    finally:
        other.kill()
        other.communicate()


def _wait_for(other: subprocess.Popen[bytes]) -> None:
    """Wait until the second process has ended, or hangs; what it leaves is compiled here afterwards."""
    for _ in _while_loops_come():
        if other.poll() is not None:
            return
    log.warning("the second process that compiles has made no loop for %g s: it is ended, and its part compiled here", LONGEST)


def main() -> None:
    """Be the second process: compile a part of the first half, and then everything else."""
    from agents.compiled.backend import FAST
    from agents.compiled.extraction_kernels import estimate_targets
    from protocol.process import die_with_parent

    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the first process, and thereby this one
    estimate_targets(np.zeros((1, 4)), np.ones(1), np.zeros(1, np.uint64), 1.0, 0.5, 0.5, np.uint64(0))
    _play_all(FAST._replace(**{name: getattr(PLAIN, name) for name in SLOWEST_TO_COMPILE}))


@contextlib.contextmanager
def _one_by_one() -> Iterator[None]:
    """Hold the cache folder alone, after other processes that compile. A process without progress may be stopped and is not waited for."""
    from agents.compiled.correction_kernels import correct

    descriptor = os.open(str(correct.stats.cache_path), os.O_RDONLY)  # the folder in which numba keeps what it has compiled
    try:
        for _ in _while_loops_come():
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
        yield
    finally:
        os.close(descriptor)


def _while_loops_come() -> Iterator[None]:
    """Pass 20 times a second, until no process has compiled another loop for `LONGEST` s."""
    done, end = 0, time.monotonic() + LONGEST
    while time.monotonic() < end:
        yield
        time.sleep(0.05)
        if loops_on_disk() > done:
            done, end = loops_on_disk(), time.monotonic() + LONGEST


def _play_all(backend: Backend) -> None:
    played: tuple[tuple[Literal["all", "neighbours"], str], ...]
    played = ("all", "lloyd"), ("neighbours", "lloyd"), ("all", "search-and-track")
    for interest, law in played:
        arena, timing = ArenaSettings(width=15.0, height=15.0), TimingSettings(interest=interest)  # in some round both hear the same
        control = ControlSettings(mode=law)
        _play(AgentConfig(members=dict.fromkeys(NAMES, "A"), arena=arena, timing=timing, control=control), backend)


def _play(config: AgentConfig, backend: Backend) -> None:
    pair = [Agent(config, name, 1, backend) for name in NAMES]
    for agent, other in (pair, pair[::-1]):
        agent.handle(Alive("agent", other.name, 1), 0.0)
        _tell(other, agent.handle(Started(), 0.0))
    for tick in range(ROUNDS):
        said = [(agent, agent.handle(received(_seen(agent.name, tick)), TICK_SECONDS * tick)) for agent in pair if _sees(agent, tick)]
        for agent, effects in said:
            if tick not in LOST:
                _tell(pair[agent is pair[0]], effects)
        for agent in pair:
            agent.handle(Timer(), TICK_SECONDS * (tick + 0.5))


def _sees(agent: Agent, tick: int) -> bool:
    return agent.name == NAMES[0] or tick not in SKIPPED


def _tell(agent: Agent, effects: list[Effect]) -> None:
    for effect in effects:
        if isinstance(effect, Hello | Beacon | Gossip):
            agent.handle(received(effect), 0.0)


def _seen(name: str, tick: int) -> Observation:
    """One detection at (0, 10) m, from within the arena."""
    pose = (1.0 + 10.0 * (name == NAMES[1]), 10.0, 3.0)
    detection = bytes(4) + b"\x00\x00\x20\x41"
    return Observation(sender="world", incarnation=1, recipient=name, tick=tick, time=0.0, pose=pose, detections_bytes=detection)


if __name__ == "__main__":
    main()
