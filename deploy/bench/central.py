"""The centralised reference: one filter with all detections, all cells, and bodies that follow, with the agents' own kernels and
without agents or messages. It is what a simulation's speed is compared with."""

import math
from typing import NamedTuple

import numpy as np

from agents.backend import Backend
from agents.compiled import claim_kernels, extraction_kernels, particle_kernels
from agents.compiled.label_kernels import stamp_of
from agents.coverage.capacity import SensorFacts, power_radius, to_world, unused_capacity
from agents.coverage.cells import Cell
from agents.coverage.control import Lloyd, Situation
from agents.gossip.table import AnnouncedSensor, GossipTable, announced_sensor
from agents.tracking import phd
from agents.tracking.births import prior
from agents.tracking.claims import NO_CLAIM, Claim
from agents.tracking.particles import NO_PARTICLES, Particles, join
from agents.tracking.step import Step
from agents.tracking.tracker import RegionInput
from deploy.scenario import Scenario, agent_config, world_config
from protocol.fields import pack
from protocol.geometry import rectangle
from protocol.messages import Command, Gossip
from protocol.random_streams import random_key
from protocol.sensing import SensorModel
from protocol.settings import sensor_of
from world.bodies import Bodies, start_pose
from world.detector import Detector, sightings
from world.score import errors
from world.targets import Targets


class Member(NamedTuple):
    """A sensor of the team."""

    name: str
    sensor: SensorModel
    facts: SensorFacts
    announced_sensor: AnnouncedSensor


class Central:
    """One run; `tick` plays a tick and returns its OSPA, m."""

    def __init__(self, scenario: Scenario, backend: Backend) -> None:
        self._scenario, self._backend = scenario, backend
        config, self._config = world_config(scenario), agent_config(scenario)
        run, arena = scenario.run, scenario.arena
        sensors = {name: sensor_of(scenario, sensor_class) for name, sensor_class in scenario.members.items()}
        clutter = scenario.detection.clutter
        carried = {name: announced_sensor(name, sensor, clutter) for name, sensor in sensors.items()}
        self._team = [Member(name, sensor, carried[name].facts, carried[name]) for name, sensor in sensors.items()]
        self._targets = Targets(config.targets, arena, run.dt, run.seed)
        self._bodies, self._detector = Bodies(run.dt, scenario.limits), Detector(scenario.detection, run.seed)
        for member in self._team:
            self._bodies.place(member.name, start_pose(member.name, config.bodies, arena, run.seed))
        mass = scenario.filter.prior_density * arena.width * arena.height
        self._particles = prior(self._config.shared_seed, round(scenario.filter.particles_per_target * mass), scenario.filter, arena)
        self._unused = [member.facts.capability for member in self._team]
        self._corners, self._tick, self._law = rectangle(arena.width, arena.height), 0, Lloyd()

    def tick(self) -> float:
        """Detect, predict, correct, divide, draw, drive."""
        scenario, backend, step = self._scenario, self._backend, Step(self._config, self._tick)
        words = self._scans()
        first = self._team[0]
        everywhere = RegionInput("", 0, first.sensor, self._bodies.poses[first.name], self._corners, NO_CLAIM)
        updated = backend.update_regions(words, self._particles, backend.background_births(step), [everywhere], step)[0].updated
        points, radii = words.generators[:, :2], words.generators[:, 2]
        owned, commands = [], {}
        cells = backend.cut_cells(range(len(radii)), words.generators, self._corners)
        for index, (member, cell) in enumerate(zip(self._team, cells)):
            claim = _claim(cell, points, radii)
            mine = claim_kernels.owned(updated.states, claim.generators, claim.wins_ties, scenario.arena.width, scenario.arena.height)
            own = Particles(*particle_kernels.take(*updated, mine))
            commands[member.name] = self._command(member, cell, own)
            owned.append(_drawn(own, member.name, step))
            self._unused[index] = self._capacity(member, updated, words.table[index])
        self._particles = join(owned) if owned else NO_PARTICLES
        settings = scenario.extraction
        estimates = extraction_kernels.estimate_targets(
            updated.states,
            updated.weights,
            updated.labels,
            settings.bin,
            settings.threshold,
            settings.beside,
            np.uint64(stamp_of(np.uint64(self._tick))),  # as in `update_regions`, or everything is compiled again
        )[0][:, :2]
        score, _ = errors(self._targets.positions, estimates)
        self._bodies.move(commands)
        self._targets.step()
        self._tick += 1
        return score

    def _scans(self) -> GossipTable:
        poses, names = [self._bodies.poses[member.name] for member in self._team], [member.name for member in self._team]
        sensors, targets = [member.sensor for member in self._team], self._targets
        seen = sightings(sensors, poses, targets.positions)
        scans = self._detector.scans(sensors, poses, names, targets.positions, targets.ids, self._tick, seen)
        said = [
            Gossip(
                sender=member.name,
                incarnation=1,
                tick=self._tick,
                pose=pose,
                cod=to_world(member.facts.cod_offset, pose),
                power_radius=power_radius(unused),
                unused=unused,
                detections_bytes=pack(scan, "<f4"),
            )
            for member, pose, scan, unused in zip(self._team, poses, scans, self._unused)
        ]
        return GossipTable(said, [member.announced_sensor for member in self._team], self._config)

    def _capacity(self, member: Member, updated: Particles, row: np.ndarray) -> float:
        load, detected = particle_kernels.in_view(updated.states, updated.weights, row)
        return unused_capacity(member.facts.capability, detected, load, self._scenario.capacity)

    def _command(self, member: Member, cell: Cell, own: Particles) -> Command:
        scenario, pose = self._scenario, self._bodies.poses[member.name]
        mass, east, north = particle_kernels.first_moments(own.states, own.weights)
        velocity, turn_rate = self._law.command(
            Situation(
                name=member.name,
                seed=self._config.shared_seed,
                tick=self._tick,
                dt=scenario.run.dt,
                pose=pose,
                control_point=to_world(member.facts.cod_offset, pose),
                cell=cell.polygon,
                centroid=(east / mass, north / mass) if mass > 0.0 else None,
                particles=own,
                sensor=member.sensor,
                limits=scenario.limits,
                heading=scenario.control.heading,
                arena=(scenario.arena.width, scenario.arena.height),
            )
        )
        return Command(sender=member.name, incarnation=1, tick=self._tick, velocity=velocity, turn_rate=turn_rate)


def _claim(cell: Cell, points: np.ndarray, radii: np.ndarray) -> Claim:
    bounds = np.array(cell.bounding, dtype=int)
    generators = np.column_stack([points[bounds], radii[bounds]])
    return Claim(tuple(map(str, cell.bounding)), generators, bounds < bounds[0] if len(bounds) else np.empty(0, dtype=bool))


def _drawn(own: Particles, owner: str, step: Step) -> Particles:
    """Compiled `phd.resample`."""
    filters, tick = step.config.filter, step.tick
    mass = particle_kernels.first_moments(own.states, own.weights)[0]
    if mass <= 0.0:
        return NO_PARTICLES
    count, salt = phd.sample_size(mass, filters), np.uint64(random_key(filters.seed, "split", tick))
    states, ids, labels = particle_kernels.resample(*own, mass, count, phd.sample_offset(filters.seed, owner, tick), salt)  # type: ignore[arg-type]
    return Particles(states, np.full(len(ids), mass / count), ids, labels)


def play(scenario: Scenario, backend: Backend) -> float:
    """Mean OSPA, m, of the last 80 % of a run."""
    central = Central(scenario, backend)
    scores = [central.tick() for _ in range(scenario.run.ticks)]
    return math.fsum(scores[len(scores) // 5 :]) / max(1, len(scores) - len(scores) // 5)
