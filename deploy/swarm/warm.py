"""Loading the compiled loops before they are needed, and telling the user when they must be compiled first."""

import sys
from pathlib import Path

from agents.agent import Agent
from agents.config import AgentConfig
from protocol.messages import Observation
from protocol.node import Received
from protocol.settings import ArenaSettings

ROUNDS = 4


def compiled_before() -> bool:
    """Whether compiled loops lie on disk beside the sources."""
    return any((Path(__file__).resolve().parents[2] / "agents" / "__pycache__").glob("update_kernels.update-*.nbi"))


def announce() -> None:
    """Say what the very first start on a machine spends its time on."""
    if not compiled_before():
        print("covey: compiling the particle loops, once on this machine; about 20 s", file=sys.stderr, flush=True)


def warm() -> None:
    """Let an agent without a swarm play a few rounds, so that every compiled loop is in memory; the very first time compiles them."""
    from agents.fast import FAST

    config = AgentConfig(members={"s1": "A"}, arena=ArenaSettings(width=20.0, height=20.0))
    agent = Agent(config, "s1", 1, FAST)
    for tick in range(ROUNDS):
        seen = bytes(4) + b"\x00\x00\x20\x41"  # one detection at (0, 10) m
        world = Observation(
            sender="world", incarnation=1, recipient="s1", tick=tick, time=0.0, pose=(1.0, 10.0, 3.0), detections_bytes=seen
        )
        agent.handle(Received(world), 0.0)
