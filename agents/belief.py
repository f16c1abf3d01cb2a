"""The replicated PHD: what one agent holds, and how it merges what the others say they own.

The owner of a cell is the authority for what is in it; everybody else keeps copies and moves them with the same keyed noise. A
belief is stamped with the tick of the round after which it holds. Nothing is ever handed over: a particle that crosses a border
lands in exactly one cell, and the particles of a dead agent live on in the copies (docs/journey.md).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agents.arithmetic import Arithmetic
from agents.claims import NO_CLAIM, Claim, end_to_end, make_claim
from agents.config import AgentConfig
from agents.particles import NONE, Particles, canonical, join, select
from agents.step import Step
from agents.words import Words, particles_of
from protocol.keys import order
from protocol.messages import Gossip

MOST_COPIES = 6000  # a backstop against growth without bound: so many copies,
MOST_TIMES = 4.0  # or so many times what a fresh draw of their mass would have


class Share(NamedTuple):
    """What one agent owned after a round: its claim, its particles, and the hash of the diagram that its cell was cut from."""

    owner: str
    claim: Claim
    particles: Particles
    view: int


def share_of(gossip: Gossip) -> Share:
    """What a gossip says its sender owns."""
    names = gossip.claim_names
    claim = make_claim(names, gossip.claim, tuple(order(name) for name in names)) if names else NO_CLAIM
    particles = Particles(gossip.states.astype(float), np.full(len(gossip.ids), gossip.weight), gossip.ids)
    return Share(gossip.sender, claim, particles, gossip.view)


class Round(NamedTuple):
    """What a round knew of the particles outside the own cell, as far as copies are made of it."""

    step: Step
    arithmetic: Arithmetic
    told: Words | Particles  # everything that counted, one tick before
    polygon: np.ndarray  # the own cell
    claim: Claim
    horizon: float = math.inf  # m from the cell: copies farther away are given up


@dataclass
class Copies:
    """What an agent holds of what others own, after a round.

    `near` is what it corrected around its own cell. The rest is what it was told in that round, one step on: it is only computed
    when somebody falls silent, because fresh claims replace it otherwise.
    """

    near: Particles
    round: Round | None = None

    def all(self) -> Particles:
        """Every copy, at the stamp of the belief."""
        if self.round is not None:
            step, arithmetic, told, polygon, claim, horizon = self.round
            copies = arithmetic.outlying(self.near, particles_of(told), polygon, claim, horizon, step)
            self.near, self.round = worth_keeping(copies, step.config.filter.particles_per_target), None
        return self.near


def worth_keeping(copies: Particles, per_target: int) -> Particles:
    """All copies; the heaviest if they are more than `MOST_COPIES` and than `MOST_TIMES` as many as their mass is drawn with, at
    `per_target` for an expected target. Whatever the number of targets, only what is much lighter than a drawn particle is given up."""
    most = max(MOST_COPIES, math.ceil(MOST_TIMES * per_target * float(copies.weights.sum())))
    if len(copies.weights) <= most:
        return copies
    heaviest = np.argsort(-copies.weights, kind="stable")[:most]
    return select(copies, np.sort(heaviest))


@dataclass
class Belief:
    """An agent's belief after the round `stamp`: what it owns, and its copies of everything else."""

    stamp: int
    mine: Share
    copies: Copies
    everyone: frozenset[str] = frozenset()  # whose generators made the diagram that `mine` was cut from
    acquainted: frozenset[str] | None = None  # of what others I knew then, if I hear but a part of all

    def merge(self, words: Words, tick: int, arithmetic: Arithmetic, config: AgentConfig) -> Words | Particles:
        """Everything at `stamp` that counts, given what all say in the round `tick`, myself included; an id may occur twice.

        Copies count where no fresh claim lies. Where two claims overlap (the views differed), both count within `timing.overlap` m
        of the border, and deeper the smaller power distance wins. When all cut the same diagram their claims tile the arena; somebody
        of whom I did not know has cut another one, whatever he says.
        """
        # A diagram of nobody, which all newcomers share, claims nothing: their copies count.
        strangers = set() if self.acquainted is None else words.everyone - self.acquainted - {self.mine.owner}
        agreed = self.mine.view != 0 and words.claimed == (tick - 1, self.mine.view) and not strangers
        if agreed and self.everyone and self.everyone <= words.everyone:
            return words
        shares = [share_of(gossip) for gossip in words.gossips if gossip.claim_tick == tick - 1 and gossip.sender != self.mine.owner]
        shares.insert(0, self.mine)
        claims = end_to_end([share.claim for share in shares])
        views = [~share.view if share.owner in strangers else share.view for share in shares]
        told, sizes = join([share.particles for share in shares]), [len(share.particles.ids) for share in shares]
        kept = arithmetic.undisputed(told.states, sizes, claims, views, config.timing.overlap)
        copies = self.copies.all()
        free = arithmetic.unclaimed(copies.states, claims, config.arena)
        return arithmetic.unite(told, kept, copies, free)

    def awake(self, step: Step, arithmetic: Arithmetic) -> "Belief":
        """This belief as a copy of the tick before `step.tick`, for an agent that missed rounds: nothing in it is claimed any more."""
        if self.stamp >= step.tick - 1:
            return self
        particles = canonical(join([self.mine.particles, self.copies.all()]))
        for missed in range(self.stamp + 1, step.tick):
            particles = arithmetic.predict(particles, step._replace(tick=missed))
        return Belief(step.tick - 1, Share(self.mine.owner, NO_CLAIM, NONE, 0), Copies(particles))


def start(prior: Particles, name: str) -> Belief:
    """The belief before the first round: everybody holds the prior, nobody owns anything."""
    return Belief(stamp=-1, mine=Share(name, NO_CLAIM, NONE, 0), copies=Copies(prior))
