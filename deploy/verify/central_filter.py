"""The central filter: one PHD filter over the whole arena, fed with the detections that all agents report.

It uses the agents' own functions, but knows no cells while it predicts and corrects. One filter takes every particle and every detection
of a tick, the sensors in the order of their names. Only the draw of new particles goes cell by cell, with the claims that the agents
published and each owner's key. Without loss the union of what the agents own equals it.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from agents.backend import PLAIN, Backend
from agents.config import AgentConfig
from agents.gossip.table import GossipTable, announced_sensor, gossip_table
from agents.tracking import gaussian_belief
from agents.tracking.belief import as_stated
from agents.tracking.births import background_births
from agents.tracking.claims import NO_CLAIM, Claim, owned
from agents.tracking.extraction import estimate_targets
from agents.tracking.gaussians import EMPTY, Mixture
from agents.tracking.labels import renamed
from agents.tracking.particles import NO_PARTICLES, Particles, canonical, join, select
from agents.tracking.phd import predict, resample
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput
from deploy.scenario import Scenario, agent_config
from protocol.geometry import rectangle
from protocol.keys import order
from protocol.messages import Gossip
from protocol.settings import ArenaSettings, sensor_of


class CentralFilter:
    """A PHD over the whole arena; `particles` holds after `tick`, `updated` is what the new ones were drawn from."""

    def __init__(self, scenario: Scenario, particles: Particles, tick: int = -1, backend: Backend = PLAIN) -> None:
        self.config, self._backend = agent_config(scenario), backend
        self._classes = scenario.members
        self.particles, self.tick = particles, tick
        self.updated = particles

    def play(self, gossips: Mapping[str, Gossip], claims: Mapping[str, Claim]) -> None:
        """One tick on: predict, correct with the scans of all `gossips`, draw new particles in each of the `claims`."""
        self.tick += 1
        config, step = self.config, Step(self.config, self.tick)
        born = background_births(step)
        any_sensor = sensor_of(config, next(iter(self._classes.values())))  # its view of the whole is not asked for
        everywhere = RegionInput("", 0, any_sensor, (0.0, 0.0, 0.0), _widely(config.arena), NO_CLAIM)
        [found] = self._backend.update_regions(_all(gossips, self._classes, config), self.particles, born, [everywhere], step)
        self.updated = found.updated
        self.particles = drawn(self.updated, predict(canonical(self.particles), step), claims, step)


class CentralMixture:
    """The same with a Gaussian mixture; `mixture` holds after `tick`."""

    def __init__(self, scenario: Scenario, mixture: Mixture, tick: int = -1) -> None:
        self.config, self._classes = agent_config(scenario), scenario.members
        self.mixture, self.tick = mixture, tick
        self.updated = mixture

    def play(self, gossips: Mapping[str, Gossip], claims: Mapping[str, Claim]) -> None:
        """One tick on, as `CentralFilter.play`: what is kept of the components in each of the `claims`."""
        self.tick += 1
        step, table = Step(self.config, self.tick), _all(gossips, self._classes, self.config)
        _, self.updated = gaussian_belief.filter_step(self.mixture, table, step)
        self.mixture = canonical(join([EMPTY, *(gaussian_belief.take(self.updated, claim, step) for claim in claims.values())]))


def _all(gossips: Mapping[str, Gossip], classes: Mapping[str, str], config: AgentConfig) -> GossipTable:
    """The table of the gossips of a tick."""
    said = [gossips[name] for name in sorted(gossips, key=order)]
    clutter = config.detection.clutter
    sensors = [announced_sensor(gossip.sender, sensor_of(config, classes[gossip.sender]), clutter) for gossip in said]
    return gossip_table(said, sensors, config)


def drawn(updated: Particles, predicted: Particles, claims: Mapping[str, Claim], step: Step) -> Particles:
    """What the owners draw of the particles in their claims, some of which they rename before; `predicted` is before the scans."""
    arena = step.config.arena
    places, parts = estimate_targets(updated, step.config.extraction).positions, [NO_PARTICLES]
    for owner, claim in claims.items():
        mine = owned(updated.states, claim, arena)
        labels = renamed(updated, mine, predicted, places[owned(places, claim, arena)], step.config.extraction.bin)
        found = resample(canonical(select(updated._replace(labels=labels), mine)), owner, step)
        parts.append(as_stated(found, owner, step))
    return canonical(join(parts))


def _widely(arena: ArenaSettings) -> np.ndarray:
    """A polygon that holds everything that can matter: the arena and 1 km around it, counter-clockwise."""
    far = 1000.0
    return rectangle(arena.width + 2.0 * far, arena.height + 2.0 * far) - far


class ParticleDifference(NamedTuple):
    """How far two sets of particles are apart."""

    strangers: int  # ids that only one of them has
    moved: int  # common ids with different states or labels
    weight: float  # the largest difference of weights at common ids, expected targets
    mass: float  # difference of the masses, first minus second, expected targets

    @property
    def exact(self) -> bool:
        """Whether they are the same particle by particle, weights to 1e-9."""
        return self.strangers == 0 and self.moved == 0 and self.weight <= 1e-9


def particle_difference(one: Particles, other: Particles) -> ParticleDifference:
    """Particle by particle; both in ascending order of id."""
    common, first, second = np.intersect1d(one.ids, other.ids, assume_unique=True, return_indices=True)
    moved = np.any(one.states[first] != other.states[second], axis=1) | (one.labels[first] != other.labels[second])
    apart = np.abs(one.weights[first] - other.weights[second])
    return ParticleDifference(
        strangers=len(one.ids) + len(other.ids) - 2 * len(common),
        moved=int(np.count_nonzero(moved)),
        weight=float(apart.max()) if len(common) else 0.0,
        mass=float(one.weights.sum() - other.weights.sum()),
    )


def mixture_difference(one: Mixture, other: Mixture) -> float:
    """The largest difference of a weight, mean or covariance; infinite when ids or labels differ. Both by ascending id."""
    if not (np.array_equal(one.ids, other.ids) and np.array_equal(one.labels, other.labels)):
        return math.inf
    return max([float(np.abs(first - second).max(initial=0.0)) for first, second in zip(one[:3], other[:3])])


def united(owned: Mapping[str, Particles]) -> Particles:
    """Everything that the agents own, in ascending order of id; an id that two of them own occurs twice."""
    everything = join([NO_PARTICLES, *(owned[name] for name in sorted(owned, key=order))])
    return select(everything, np.argsort(everything.ids, kind="stable"))
