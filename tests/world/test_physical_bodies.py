"""Robots of mass on wheels that slip, integrated by MuJoCo."""

import itertools
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from deploy.cli.scenario_checks import check_scenario
from deploy.scenario import resolve
from protocol.geometry import wrap_angle
from protocol.messages import Command
from protocol.settings import BadSetting, LimitSettings
from world.physical_bodies import QPOS, PhysicalBodies, _yaws
from world.platform import Physical

ROOT = Path(__file__).resolve().parents[2]
LIMITS = LimitSettings(speed=2.0, turn_rate=5.0, radius=0.25)
DT = 0.25


def robots(*places: tuple[float, float, float], dt: float = DT) -> PhysicalBodies:
    bodies = PhysicalBodies(dt, LIMITS)
    for number, pose in enumerate(places, 1):
        bodies.place(f"s{number}", pose)
    return bodies


def order(velocity: tuple[float, float], turn_rate: float = 0.0) -> Command:
    return Command(sender="s1", incarnation=1, tick=0, velocity=velocity, turn_rate=turn_rate)


def test_a_body_that_comes_late_stands_at_once_where_it_would_have_stood() -> None:
    bodies = Physical((5.0, 5.0, 1.0), DT, LIMITS), Physical((5.0, 5.0, 1.0), DT, LIMITS)
    for body in bodies:
        body.drive((1.0, 0.0), 0.0)
        body.read(8)
        body.stop()
    moved = []
    bodies[0]._bodies.move = lambda commands, move=bodies[0]._bodies.move: (moved.append(commands), move(commands))  # type: ignore
    late = bodies[0].read(100_000)[0]
    for tick in range(9, 60):
        patient = bodies[1].read(tick)[0]
    assert len(moved) == 16 and math.dist(late, patient) < 1e-3


def test_a_robot_needs_time_to_reach_its_speed_and_then_keeps_it() -> None:
    bodies, xs = robots((0.0, 0.0, 0.0)), [0.0]
    for _ in range(10):
        bodies.move({"s1": order((1.0, 0.0))})
        xs.append(bodies.poses["s1"][0])
    steps = [after - before for before, after in itertools.pairwise(xs)]
    assert 0.05 < steps[0] < 0.22  # inertia
    assert all(0.225 < step < 0.252 for step in steps[2:])  # a little slip
    assert abs(bodies.poses["s1"][1]) < 1e-3


def test_a_robot_without_a_command_brakes_within_half_a_metre_and_stands() -> None:
    bodies = robots((0.0, 0.0, 0.0))
    for _ in range(8):
        bodies.move({"s1": order((2.0, 0.0))})
    braking = bodies.poses["s1"][0]
    bodies.move({})
    bodies.move({})
    assert 0.02 < bodies.poses["s1"][0] - braking < 0.5
    there = bodies.poses["s1"]
    for _ in range(8):
        bodies.move({})
    assert math.dist(bodies.poses["s1"][:2], there[:2]) < 0.02


def test_it_goes_sideways_by_turning_while_its_turret_turns_as_commanded() -> None:
    bodies = robots((0.0, 0.0, 0.0))
    for _ in range(12):
        bodies.move({"s1": order((0.0, 1.0), turn_rate=0.5)})
    x, y, heading = bodies.poses["s1"]
    assert 2.2 < y < 3.0 and abs(x) < 0.3
    assert abs(wrap_angle(heading - 0.5 * 3.0)) < 0.15


def test_casters_do_not_drag_so_a_robot_turns_by_a_right_angle_within_half_a_second() -> None:
    bodies = robots((0.0, 0.0, 0.0), dt=0.02)
    for _ in range(25):
        bodies.move({"s1": order((0.0, 2.0))})
    assert bodies._data.qvel[1] > 1.2 and abs(float(_yaws(bodies._data.qpos.reshape(-1, QPOS))[0]) - math.pi / 2.0) < 0.35


def test_robots_that_nobody_keeps_apart_touch_and_do_not_pass_through_each_other() -> None:
    bodies = robots((0.0, 0.0, 0.0), (2.0, 0.02, math.pi))
    least = math.inf
    for _ in range(12):
        bodies.move({"s1": order((1.0, 0.0)), "s2": order((-1.0, 0.0))})
        least = min(least, math.dist(bodies.poses["s1"][:2], bodies.poses["s2"][:2]))
    assert bodies.touches > 0 and 0.48 < least < 0.55


def test_a_wreck_is_an_obstacle_that_can_be_pushed() -> None:
    bodies = robots((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    for _ in range(16):
        bodies.move({"s1": order((1.0, 0.0))})
    x, wreck = bodies.poses["s1"][0], bodies.poses["s2"]
    assert bodies.touches > 0 and 1.05 < wreck[0] < 4.0  # a free one would be at 3.8
    assert math.dist(wreck[:2], bodies.poses["s1"][:2]) > 0.48 and x < 3.7


def test_the_same_commands_give_the_same_poses_to_the_last_bit() -> None:
    def play() -> list[tuple[float, float, float]]:
        bodies = robots((0.0, 0.0, 0.3), (0.9, 0.1, 2.0), (0.5, 0.8, 4.0))
        found = []
        for tick in range(20):
            middle = [sum(axis) / 3.0 for axis in zip(*bodies.poses.values())]
            wanted = {name: (middle[0] - pose[0], middle[1] - pose[1] + 0.1 * tick) for name, pose in bodies.poses.items()}
            bodies.move({name: order(velocity, 0.3) for name, velocity in wanted.items()})
            found += bodies.poses.values()
        assert bodies.touches > 0
        return found

    assert play() == play()


def test_a_guest_that_comes_later_disturbs_nobody() -> None:
    alone, joined = robots((0.0, 0.0, 0.0)), robots((0.0, 0.0, 0.0))
    for tick in range(12):
        if tick == 6:
            joined.place("guest", (5.0, 5.0, 1.0))
        for bodies in (alone, joined):
            bodies.move({"s1": order((1.0, 0.0))})
    assert list(joined.poses) == ["s1", "guest"]
    assert joined.poses["s1"] == pytest.approx(alone.poses["s1"], abs=0.02)
    assert joined.poses["guest"] == pytest.approx((5.0, 5.0, 1.0), abs=1e-3)


def test_a_body_process_has_one_of_its_own() -> None:
    platform = Physical((1.0, 2.0, 0.0), DT, LIMITS)
    assert platform.read(0) == ((1.0, 2.0, 0.0), None)
    platform.drive((1.0, 0.0), 0.0)
    (x, y, _), detections = platform.read(8)
    assert detections is None and 2.6 < x < 3.0 and abs(y - 2.0) < 0.01
    platform.stop()
    there = platform.read(10)[0]
    assert platform.read(14)[0] == pytest.approx(there, abs=0.02)
    platform.put((7.0, 7.0, 0.0))
    assert platform.read(15)[0] == pytest.approx((7.0, 7.0, 0.0), abs=1e-3)


def test_a_body_without_a_size_cannot_be_physical() -> None:
    with pytest.raises(BadSetting, match=r"limits.radius = 0: should be at least 0.05 m with bodies.model = 'mujoco'"):
        PhysicalBodies(DT, LimitSettings())


def covey(program: str, *words: str) -> "subprocess.CompletedProcess[str]":
    settings = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT}/deploy/interface"}
    done = [sys.executable, "-c", program, *words]
    return subprocess.run(done, env=settings, capture_output=True, text=True, timeout=100, check=False)


def test_without_the_package_one_line_says_how_to_get_it() -> None:
    program = "import sys; sys.modules['mujoco'] = None; from deploy.__main__ import main; main()"
    done = covey(program, "simulate", "quick", "--seconds", "2", "--set", "bodies.model=mujoco", "--set", "limits.radius=0.25")
    assert done.returncode == 2
    [line] = done.stderr.splitlines()
    assert "bodies.model = 'mujoco': needs the package mujoco" in line and "COVEY_EXTRAS=mujoco ./covey version" in line


def test_a_scenario_with_bodies_that_cannot_be_made_is_refused_before_anything_starts() -> None:
    with pytest.raises(BadSetting, match=r"limits.radius = 0: should be at least"):
        check_scenario(resolve("quick", {"bodies.model": "mujoco"}))
    with pytest.raises(BadSetting, match="the arena has no room for"):
        check_scenario(resolve("quick", {"limits.radius": 9.0}))


def test_the_package_is_loaded_by_a_world_that_is_asked_for_it_and_by_nobody_else() -> None:
    program = """
import sys
import agents.agent, world.body, world.world
from deploy.scenario import resolve, world_config
world.world.World(world_config(resolve("quick", {})), 1)
print("mujoco" in sys.modules)
world.world.World(world_config(resolve("quick", {"bodies.model": "mujoco", "limits.radius": 0.25})), 1)
print("mujoco" in sys.modules)
"""
    assert covey(program).stdout.split() == ["False", "True"]
