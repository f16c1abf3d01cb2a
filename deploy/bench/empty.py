"""Empty rounds: agents that say as much as real ones and compute nothing. `covey bench live` compares the live swarm with them.

`python -m deploy.bench.empty up ...` is the command `covey up ...` with a zygote that forks such agents. Bodies drive small circles, so
that the set of neighbours changes as it does in a real run.
"""

import math
import sys
from typing import Any

import numpy as np

from agents import agent
from agents.compiled.warmup import warm
from agents.membership.peer_table import PeerTable
from agents.round import AgentContext, RoundResult
from agents.tracking.belief import Copies
from agents.tracking.claims import make_claim
from agents.tracking.extraction import TargetEstimates
from agents.tracking.particles import NO_PARTICLES, unlabelled
from agents.tracking.tracker import Belief, OwnedState
from deploy import __main__ as command_line
from deploy.installation import command
from deploy.live import zygote
from protocol.geometry import rectangle
from protocol.messages import Gossip

PARTICLES = 2250  # of the whole swarm: 30 targets, 75 each
VIEW = 1
BOUNDS = 6  # neighbours that a claim names
SPEED, TURN_RATE = 1.0, 0.2  # m/s, rad/s: circles of 5 m


def install() -> None:
    """Let the agents of this process play empty rounds from now on, with the same modules in memory as real ones."""
    warm()
    module: Any = agent
    module.run_round = play


def main() -> None:
    """Be the zygote when the only argument is a descriptor, else the command line that starts such a zygote."""
    if len(sys.argv) == 2 and sys.argv[1].isdecimal():
        zygote.main(install)
        return
    zygote.PROGRAM = command("deploy.bench.empty")
    command_line.main()


def play(me: AgentContext, last: RoundResult, peer_table: PeerTable, mine: Gossip, heard: dict[str, Gossip], *_: object) -> RoundResult:
    """The outcome of a round in which nothing was computed; it takes what `agents.round.run_round` takes."""
    config = me.config
    names = (me.name, *list(heard)[:BOUNDS])
    bounds = np.array([(*mine.cod, mine.power_radius), *([(0.0, 0.0, 1.0)] * (len(names) - 1))])
    everybody = max(len(config.members), len(peer_table.peers) + 1)
    count = round(PARTICLES / everybody)
    states = np.tile(np.array([*mine.cod, 1.0, 1.0]), (count, 1))
    owned = unlabelled(states, np.full(count, 1.0 / count), np.arange(1, count + 1, dtype=np.uint64))
    share = OwnedState(me.name, make_claim(names, bounds), owned, VIEW)
    side = math.sqrt(config.arena.width * config.arena.height / everybody)
    angle = TURN_RATE * mine.tick * config.run.dt
    return RoundResult(
        belief=Belief(mine.tick, share, Copies(NO_PARTICLES), frozenset((*heard, me.name))),
        unused=last.unused,
        mass=1.0,
        cell=rectangle(side, side) + mine.cod - 0.5 * side,
        estimates=TargetEstimates(np.array([mine.cod]), np.zeros((1, 6)), np.ones(1, dtype=np.uint64)),
        command=((SPEED * math.cos(angle), SPEED * math.sin(angle)), TURN_RATE),
    )


if __name__ == "__main__":
    main()
