"""Loading the compiled loops before they are needed, and telling the user when they must be compiled first."""

import contextlib
import fcntl
import os
import sys
import time
from collections.abc import Iterator
from typing import Literal

import numpy as np

from agents.agent import Agent
from agents.config import AgentConfig, TimingSettings
from agents.numba_cache import compiled_before, tidy
from protocol.codec import encode
from protocol.keys import message_key
from protocol.messages import Beacon, Gossip, Hello, Observation
from protocol.node import Alive, Effect, Received, Started, Timer
from protocol.settings import ArenaSettings, convert

NAMES = ("s1", "s2")
ROUNDS = 24
LOST = (4, 5)  # ticks in which nobody hears the other
SKIPPED = (8, 9)  # ticks that s2 does not see
LATE = 1e3  # s after which every open round closes
LONGEST = 90.0  # s to wait while somebody else compiles


def announce() -> None:
    """Say what the very first start on a machine spends its time on."""
    if not compiled_before():
        print("covey: compiling the particle loops, once on this machine; some 40 s", file=sys.stderr, flush=True)


def warm() -> None:
    """Let two agents play a few rounds, good ones and bad ones, so that every compiled loop is in memory; the first time compiles them.

    What only a fault calls for must be among them, or the first fault on a machine makes all agents compile, and be silent for it.
    Of several who begin at once one compiles, and the others wait and load what it has left on disk.
    """
    interests: tuple[Literal["all", "neighbours"], ...] = ("all", "neighbours")
    with _one_by_one():
        for interest in interests:
            arena, timing = ArenaSettings(width=30.0, height=30.0), TimingSettings(interest=interest)
            _play(AgentConfig(members=dict.fromkeys(NAMES, "A"), arena=arena, timing=timing))
        _measure()
        tidy()
    convert({"members": {"s1": "A"}}, AgentConfig, "")  # what is looked up about its types once is looked up for all who are forked


@contextlib.contextmanager
def _one_by_one() -> Iterator[None]:
    """After the others on this machine who are at it, but those who take too long, for they may have been stopped."""
    from agents.update_kernels import update

    descriptor = os.open(str(update.stats.cache_path), os.O_RDONLY)  # the folder in which numba keeps what it has compiled
    try:
        patience = time.monotonic() + LONGEST
        while time.monotonic() < patience:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(0.05)
        yield
    finally:
        os.close(descriptor)


def _play(config: AgentConfig) -> None:
    from agents.fast import FAST

    pair = [Agent(config, name, 1, FAST) for name in NAMES]
    for agent, other in (pair, pair[::-1]):
        agent.handle(Alive("agent", other.name, 1), 0.0)
        _tell(other, agent.handle(Started(), 0.0))
    for tick in range(ROUNDS):
        said = [(agent, agent.handle(Received(_seen(agent.name, tick)), LATE * tick)) for agent in pair if _sees(agent, tick)]
        for agent, effects in said:
            if tick not in LOST:
                _tell(pair[agent is pair[0]], effects)
        for agent in pair:
            agent.handle(Timer(), LATE * (tick + 0.5))


def _measure() -> None:
    """Distances from read-only polygons and to parts of arrays, as only a crowd asks for them."""
    from agents import cell_kernels

    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    cell_kernels.distances(square, np.zeros((3, 3))[:, :2])
    square.flags.writeable = False
    cell_kernels.distances(square, np.zeros((3, 2)))


def _sees(agent: Agent, tick: int) -> bool:
    return agent.name == NAMES[0] or tick not in SKIPPED


def _tell(agent: Agent, effects: list[Effect]) -> None:
    for effect in effects:
        if isinstance(effect, Gossip) and agent.hear_all([message_key(agent.run, effect)], [encode(effect)], 0.0) is not None:
            continue
        if isinstance(effect, Hello | Beacon | Gossip):
            agent.handle(Received(effect), 0.0)


def _seen(name: str, tick: int) -> Observation:
    """One detection at (0, 10) m, from within the arena."""
    pose = (1.0 + 10.0 * (name == NAMES[1]), 10.0, 3.0)
    detection = bytes(4) + b"\x00\x00\x20\x41"
    return Observation(sender="world", incarnation=1, recipient=name, tick=tick, time=0.0, pose=pose, detections_bytes=detection)
