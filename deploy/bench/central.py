"""The centralised reference: one filter with all detections, all cells, and bodies that follow, with the agents' own kernels and
without agents or messages. It is what a simulation's speed is compared with."""

import math
from typing import NamedTuple

import numpy as np

from agents.arithmetic import Arithmetic
from agents.births import background_births, prior
from agents.capacity import SensorFacts, place, power_radius, unused_capacity
from agents.cells import Cell
from agents.claims import Claim
from agents.control import Lloyd, Situation
from agents.particles import NONE, Particles, join
from agents.step import Step
from agents.words import Announced, Words, announced
from deploy.scenario import Scenario, agent_config, world_config
from protocol.fields import pack
from protocol.geometry import rectangle
from protocol.messages import Command, Gossip
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
    announced: Announced


class Central:
    """One run; `tick` plays a tick and returns its OSPA, m."""

    def __init__(self, scenario: Scenario, arithmetic: Arithmetic) -> None:
        self._scenario, self._arithmetic = scenario, arithmetic
        config, self._config = world_config(scenario), agent_config(scenario)
        run, arena = scenario.run, scenario.arena
        sensors = {name: sensor_of(scenario, sensor_class) for name, sensor_class in scenario.members.items()}
        clutter = scenario.detection.clutter
        carried = {name: announced(name, sensor, clutter) for name, sensor in sensors.items()}
        self._team = [Member(name, sensor, carried[name].facts, carried[name]) for name, sensor in sensors.items()]
        self._targets = Targets(config.targets, arena, run.dt, run.seed)
        self._bodies, self._detector = Bodies(run.dt, scenario.limits), Detector(scenario.detection, run.seed)
        for member in self._team:
            self._bodies.place(member.name, start_pose(member.name, config.bodies, arena, run.seed))
        mass = scenario.filter.prior_density * arena.width * arena.height
        self._particles = prior(self._config.dice, round(scenario.filter.particles_per_target * mass), scenario.filter, arena)
        self._unused = [member.facts.capability for member in self._team]
        self._corners, self._tick, self._law = rectangle(arena.width, arena.height), 0, Lloyd()

    def tick(self) -> float:
        """Detect, predict, correct, divide, draw, drive."""
        scenario, arithmetic, step = self._scenario, self._arithmetic, Step(self._config, self._tick)
        words = self._scans()
        run = scenario.run
        born = background_births(self._config.dice, self._tick, run.dt, scenario.filter, scenario.birth, scenario.arena)
        near, _ = arithmetic.gather(self._particles, born, self._corners, (0.0, 0.0), 0.0, step)
        updated = arithmetic.update(near, words, self._corners, step)
        points, radii = words.points, words.radii
        owned, commands = [], {}
        cells = arithmetic.cut_all(points, radii, self._corners)
        for index, (member, cell) in enumerate(zip(self._team, cells)):
            own = arithmetic.take(updated, _claim(cell, points, radii), scenario.arena)
            commands[member.name] = self._command(member, cell, own)
            owned.append(arithmetic.resample(own, member.name, step))
            self._unused[index] = self._capacity(member, updated)
        self._particles = join(owned) if owned else NONE
        estimates = arithmetic.estimate_targets(updated, scenario.extraction)
        score, _ = errors(self._targets.positions, estimates)
        self._bodies.move(commands)
        self._targets.step()
        self._tick += 1
        return score

    def _scans(self) -> Words:
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
                cod=place(member.facts.cod_offset, pose),
                power_radius=power_radius(unused),
                unused=unused,
                detections_bytes=pack(scan, "<f4"),
            )
            for member, pose, scan, unused in zip(self._team, poses, scans, self._unused)
        ]
        return Words(said, [member.announced for member in self._team], "power")

    def _capacity(self, member: Member, updated: Particles) -> float:
        load, detected = self._arithmetic.in_view(updated, member.sensor, self._bodies.poses[member.name])
        return unused_capacity(member.facts.capability, detected, load, self._scenario.capacity)

    def _command(self, member: Member, cell: Cell, own: Particles) -> Command:
        scenario, pose = self._scenario, self._bodies.poses[member.name]
        mass, east, north = self._arithmetic.moments(own)
        velocity, turn_rate = self._law.command(
            Situation(
                name=member.name,
                seed=self._config.dice,
                tick=self._tick,
                dt=scenario.run.dt,
                pose=pose,
                driven=place(member.facts.cod_offset, pose),
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
    bounds = np.array(cell.bounds, dtype=int)
    generators = np.column_stack([points[bounds], radii[bounds]])
    return Claim(tuple(map(str, cell.bounds)), generators, bounds < bounds[0] if len(bounds) else np.empty(0, dtype=bool))


def play(scenario: Scenario, arithmetic: Arithmetic) -> float:
    """Mean OSPA, m, of the last 80 % of a run."""
    central = Central(scenario, arithmetic)
    scores = [central.tick() for _ in range(scenario.run.ticks)]
    return math.fsum(scores[len(scores) // 5 :]) / max(1, len(scores) - len(scores) // 5)
