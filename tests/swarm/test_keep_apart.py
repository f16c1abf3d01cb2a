"""Swarms of bodies with a size: no two of them touch, and none touches a wreck."""

import msgspec
import pytest

from agents.compiled.backend import FAST
from deploy.scenario import resolve
from deploy.simulation import Simulation
from deploy.studies.bodies import Gaps
from tests.swarm.scene import fault
from world.physical_bodies import PhysicalBodies

RADIUS = 0.25
CROWD = {
    "team.composition": "A4,B4",
    "arena.width": 12.0,
    "arena.height": 12.0,
    "targets.border": "reflect",
    "filter.border": "reflect",
    "limits.radius": RADIUS,
}


def crowd(clock: str = "lockstep", seconds: float = 20.0, **settings: object) -> Simulation:
    return Simulation(resolve("quick", {**CROWD, "run.seconds": seconds, **settings}), clock=clock, backend=FAST)  # type: ignore[arg-type]


def least_gap(simulation: Simulation, *deaths: tuple[float, str]) -> float:
    gaps = Gaps()
    simulation.on_truth = gaps.take
    for at, name in deaths:
        simulation.bus.run(at)
        simulation.injector.kill(name)
    simulation.run()
    return gaps.least


def test_points_in_this_arena_meet() -> None:
    assert least_gap(crowd(**{"limits.radius": 0.0})) < 2.0 * RADIUS


@pytest.mark.parametrize("host", ["world", "own"])
@pytest.mark.parametrize("clock", [pytest.param("lockstep", marks=pytest.mark.slow), "realtime"])
def test_bodies_with_a_radius_never_touch_and_a_dead_one_is_an_obstacle(host: str, clock: str) -> None:
    gap = least_gap(crowd(clock, **{"bodies.host": host}), (6.0, "s2"), (9.0, "s5"))
    assert 2.0 * RADIUS <= gap < 2.0


def test_laws_that_ask_for_the_same_place_do_not_bring_bodies_together() -> None:
    assert least_gap(crowd(**{"control.mode": "random"}), (6.0, "s1")) >= 2.0 * RADIUS


@pytest.mark.parametrize("host", ["world", "own"])
@pytest.mark.parametrize("share", [pytest.param(0.6, marks=pytest.mark.slow), 0.15])
def test_the_late_commands_of_starved_agents_bring_no_two_bodies_together(host: str, share: float) -> None:
    """A command is for the places of its tick: who drives on it when it comes drives to where another one is now."""
    given = resolve("quick", {**CROWD, "team.composition": "A8", "run.seconds": 15.0, "control.mode": "random", "bodies.host": host})
    starved = msgspec.structs.replace(given, faults=(fault(2.0, "starve", "100%", share),))
    assert least_gap(Simulation(starved, clock="realtime", backend=FAST)) >= 2.0 * RADIUS


@pytest.mark.slow
def test_robots_of_mass_do_not_touch_either_and_a_run_repeats_to_the_last_bit() -> None:
    transcripts = []
    for _ in range(2):
        simulation = crowd(seconds=15.0, **{"bodies.model": "mujoco"})
        gap = least_gap(simulation, (6.0, "s2"))
        bodies = simulation.world.bodies
        assert isinstance(bodies, PhysicalBodies) and bodies.touches == 0
        assert gap >= 2.0 * RADIUS
        transcripts.append(simulation.scorer.result(0.0, 0, 0).transcript)
    assert transcripts[0] == transcripts[1]


def test_a_partition_keeps_bodies_apart_for_they_sense_each_other() -> None:
    given = resolve("quick", {**CROWD, "run.seconds": 20.0})
    parted = msgspec.structs.replace(given, faults=(fault(4.0, "partition", "s1,s3,s5,s7", seconds=12.0),))
    assert least_gap(Simulation(parted, backend=FAST)) >= 2.0 * RADIUS
