"""Empty rounds: agents that say as much as real ones and compute nothing. What `covey bench live` compares the live swarm with.

A zygote whose environment names them (`COVEY_ROUNDS=empty`) forks agents that play them. Bodies drive small circles, so that whom an
agent must hear changes as it does in a real run.
"""

import math
from typing import Any

import numpy as np

from agents import agent
from agents.belief import Belief, Copies
from agents.claims import make_claim
from agents.neighbours import Neighbours
from agents.particles import NONE, Particles
from agents.round import AgentContext, RoundResult
from agents.tracker import OwnedState
from protocol.geometry import rectangle
from protocol.keys import order
from protocol.messages import Gossip

PARTICLES = 2250  # of the whole swarm: 30 targets, 75 each
VIEW = 1
BOUNDS = 6  # neighbours that a claim names
SPEED, TURN_RATE = 1.0, 0.2  # m/s, rad/s: circles of 5 m


def install() -> None:
    """From now on the agents of this process play empty rounds."""
    module: Any = agent
    module.play = play


def play(me: AgentContext, last: RoundResult, neighbours: Neighbours, mine: Gossip, heard: dict[str, Gossip]) -> RoundResult:
    """The outcome of a round in which nothing was computed."""
    config = me.config
    names = (me.name, *list(heard)[:BOUNDS])
    bounds = np.array([(*mine.cod, mine.power_radius), *([(0.0, 0.0, 1.0)] * (len(names) - 1))])
    everybody = max(len(config.members), len(neighbours.peers) + 1)
    count = round(PARTICLES / everybody)
    states = np.tile(np.array([*mine.cod, 1.0, 1.0]), (count, 1))
    owned = Particles(states, np.full(count, 1.0 / count), np.arange(1, count + 1, dtype=np.uint64))
    share = OwnedState(me.name, make_claim(names, bounds, tuple(order(name) for name in names)), owned, VIEW)
    side = math.sqrt(config.arena.width * config.arena.height / everybody)
    angle = TURN_RATE * mine.tick * config.run.dt
    return RoundResult(
        belief=Belief(mine.tick, share, Copies(NONE), frozenset((*heard, me.name))),
        unused=last.unused,
        mass=1.0,
        cell=rectangle(side, side) + mine.cod - 0.5 * side,
        targets=np.array([mine.cod]),
        command=((SPEED * math.cos(angle), SPEED * math.sin(angle)), TURN_RATE),
    )
