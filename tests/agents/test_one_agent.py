"""One agent alone, by what it hears and says: what its settings and its sensor must come to, in closed form.

The agent owns the whole arena, so that cell, centroid and capacity need no diagram.
"""

import math
from typing import Any

import pytest

from agents.agent import Agent
from agents.backend import PLAIN, Backend
from agents.config import AgentConfig, BirthSettings, CapacitySettings, ControlSettings, FilterSettings, PartitionSettings, TimingSettings
from deploy.simulation import compiled
from protocol.message import Message
from protocol.messages import Command, Gossip, Observation
from protocol.node import received
from protocol.observer_messages import Estimate
from protocol.settings import ArenaSettings, LimitSettings, RunSettings, SensorSettings

WIDTH, HEIGHT, DT = 40.0, 30.0, 0.5
POSE = (8.0, 5.0, 0.3)
RADIUS, HALF, PROBABILITY = 10.0, math.radians(30.0), 0.8
SENSOR = SensorSettings(angle=60.0, radius=RADIUS, prob_detection=PROBABILITY)
CAPABILITY = PROBABILITY * HALF * RADIUS**2  # (6): p_d times the area of the wedge
OFFSET = 2.0 * RADIUS * math.sin(HALF) / (3.0 * HALF)  # (14): of the COD, along the heading
COD = POSE[0] + OFFSET * math.cos(POSE[2]), POSE[1] + OFFSET * math.sin(POSE[2])
EMPTY = {"filter": FilterSettings(prior_density=0.0), "birth": BirthSettings(measurement=False)}  # nothing is believed anywhere
BACKENDS = pytest.mark.parametrize("backend", [PLAIN, compiled()], ids=["plain", "compiled"])


def play(backend: Backend = PLAIN, ticks: int = 1, **sections: Any) -> list[Message]:
    """What one agent says in some ticks in which it sees nothing and its body stands still."""
    config = AgentConfig(
        run=RunSettings(dt=DT, clock="lockstep"),
        arena=ArenaSettings(width=WIDTH, height=HEIGHT),
        members={"s1": "own"},
        sensors={"own": SENSOR},
        **sections,
    )
    agent, said = Agent(config, "s1", backend=backend), []
    for tick in range(ticks):
        observation = Observation(sender="world", incarnation=1, recipient="s1", tick=tick, time=DT * tick, pose=POSE)
        said += [effect for effect in agent.handle(received(observation), DT * tick) if isinstance(effect, Message)]
    return said


def last(said: list[Message], kind: type[Message]) -> Any:
    return [message for message in said if isinstance(message, kind)][-1]


def turned(bearing: float, limit: float = 5.0) -> float:
    """The turn rate towards a bearing, rad/s."""
    return max(-limit, min(limit, (bearing - POSE[2]) / DT))


def test_it_says_its_cod_and_the_power_radius_of_all_its_capability() -> None:
    gossip = last(play(**EMPTY), Gossip)
    assert gossip.cod == pytest.approx(COD, abs=1e-12)
    assert gossip.unused == pytest.approx(CAPABILITY, rel=1e-12)
    assert gossip.power_radius == pytest.approx(math.sqrt(CAPABILITY / math.pi), rel=1e-12)


@BACKENDS
@pytest.mark.parametrize("mode", ["literal", "expected", "static", "saturating"])
def test_the_unused_capacity_is_that_of_the_mode_and_is_said_in_the_next_gossip(backend: Backend, mode: Any) -> None:
    """p_d is constant, so that the integral of p_d v is p_d times the load (11)."""
    said = play(backend, 2, capacity=CapacitySettings(mode=mode, limit=3.0), filter=FilterSettings(prior_density=0.01))
    first, gossip = next(message for message in said if isinstance(message, Estimate)), last(said, Gossip)
    right = {
        "literal": CAPABILITY - PROBABILITY,
        "expected": CAPABILITY - PROBABILITY * first.load,
        "static": CAPABILITY,
        "saturating": CAPABILITY * (1.0 - first.load / 3.0),
    }
    assert 0.01 < first.load < 1.0
    assert first.unused == gossip.unused == pytest.approx(right[mode], rel=1e-12)
    assert gossip.power_radius == pytest.approx(math.sqrt(right[mode] / math.pi), rel=1e-12)


def test_the_first_load_is_what_an_empty_scan_leaves_of_the_prior() -> None:
    """v (1 - p_d) / (1 - p_d r) over the wedge, r = 0.0025 targets in 25 m^2; the particles are a random sample of 2000 in view."""
    said = play(filter=FilterSettings(prior_density=1e-4, particles_per_target=500000, position_noise=0.0, speed=1e-6))
    left = (1.0 - PROBABILITY) / (1.0 - PROBABILITY * 25e-4)
    assert last(said, Estimate).load == pytest.approx(1e-4 * HALF * RADIUS**2 * left, rel=0.05)


@pytest.mark.parametrize(("kind", "control_point"), [("power", COD), ("voronoi-cod", COD), ("voronoi", POSE[:2])])
def test_without_any_mass_the_control_point_goes_to_the_middle_of_the_cell(kind: Any, control_point: tuple[float, float]) -> None:
    """(17), (18), at 2 m/s; plain Voronoi drives the sensor itself, the others its COD."""
    command = last(play(partition=PartitionSettings(kind=kind), **EMPTY), Command)
    dx, dy = 0.5 * WIDTH - control_point[0], 0.5 * HEIGHT - control_point[1]
    assert command.velocity == pytest.approx((2.0 * dx / math.hypot(dx, dy), 2.0 * dy / math.hypot(dx, dy)), abs=1e-9)


@pytest.mark.parametrize(("heading", "seen_from"), [("centroid", POSE[:2]), ("literal", COD)])
def test_it_faces_the_middle_of_the_cell_as_seen_from_the_point_that_the_setting_names(
    heading: Any, seen_from: tuple[float, float]
) -> None:
    command = last(play(control=ControlSettings(heading=heading), **EMPTY), Command)
    bearing = math.atan2(0.5 * HEIGHT - seen_from[1], 0.5 * WIDTH - seen_from[0])
    assert command.turn_rate == pytest.approx(turned(bearing), abs=1e-9)


def test_a_body_is_driven_no_faster_than_its_limits() -> None:
    command = last(play(limits=LimitSettings(speed=0.5, turn_rate=0.1), **EMPTY), Command)
    assert math.hypot(*command.velocity) == pytest.approx(0.5) and command.turn_rate == pytest.approx(0.1)


def test_what_lies_within_one_step_is_reached_in_one_step() -> None:
    """The velocity is the way to go over dt, whatever dt is."""
    command = last(play(limits=LimitSettings(speed=1e6, turn_rate=1e6), **EMPTY), Command)
    bearing = math.atan2(0.5 * HEIGHT - POSE[1], 0.5 * WIDTH - POSE[0])
    assert command.velocity == pytest.approx(((0.5 * WIDTH - COD[0]) / DT, (0.5 * HEIGHT - COD[1]) / DT), abs=1e-9)
    assert command.turn_rate == pytest.approx(turned(bearing, 1e6), abs=1e-9)


@pytest.mark.parametrize("every", [1, 3])
def test_estimates_come_every_so_many_rounds(every: int) -> None:
    said = play(ticks=7, timing=TimingSettings(estimate_every=every), **EMPTY)
    assert [message.tick for message in said if isinstance(message, Estimate)] == list(range(0, 7, every))
