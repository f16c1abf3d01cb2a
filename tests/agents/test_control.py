"""Control laws: where the control point goes, what the limits leave of it, both readings of the heading, and the baselines."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.config import AgentConfig, ControlSettings
from agents.coverage.control import (
    STAND,
    ControlInput,
    ControlLaw,
    Lloyd,
    RandomWalk,
    Situation,
    Static,
    UniformDensity,
    approach,
)
from agents.coverage.laws import CONTROL_LAWS, control_law
from agents.tracking.particles import NO_PARTICLES, Particles
from protocol.geometry import EMPTY, rectangle, wrap_angle
from protocol.sensing import SENSOR_CLASSES, Pose
from protocol.settings import BadSetting, LimitSettings

COD_AHEAD = 2.0 * 8.0 * math.sin(math.pi / 8.0) / (3.0 * math.pi / 8.0)  # of class C, m
places = st.tuples(st.floats(-50.0, 150.0), st.floats(-50.0, 150.0))


def situation(
    centroid: tuple[float, float] | None = (50.0, 50.0),
    pose: Pose = (50.0, 50.0, 0.0),
    control_point: tuple[float, float] | None = None,
    cell: np.ndarray = EMPTY,
    heading: str = "centroid",
    name: str = "s1",
    tick: int = 0,
) -> Situation:
    """An agent of class C with a step of 0.5 s; driven by its COD unless said."""
    cod = pose[0] + COD_AHEAD * math.cos(pose[2]), pose[1] + COD_AHEAD * math.sin(pose[2])
    return Situation(
        name=name,
        seed=1,
        tick=tick,
        dt=0.5,
        pose=pose,
        control_point=control_point or cod,
        cell=cell,
        centroid=centroid,
        particles=NO_PARTICLES,
        sensor=SENSOR_CLASSES["C"],
        limits=LimitSettings(),
        heading=heading,
        arena=(100.0, 60.0),
    )


class Spin:
    """A law of the user's own."""

    def command(self, situation: Situation) -> ControlInput:
        return (0.0, 0.0), 1.0


class Reckless:
    """A law that asks for more than a body can do, with its heading."""

    def command(self, situation: Situation) -> ControlInput:
        return (30.0, -40.0), -100.0


class Scribbler:
    """A law that writes into what it is given."""

    def command(self, situation: Situation) -> ControlInput:
        for array in (situation.generators, situation.cell, *situation.particles):
            array[...] = 0
        return (0.0, 0.0), 0.0


def test_a_law_that_writes_into_its_situation_changes_neither_the_filter_nor_other_agents() -> None:
    config = AgentConfig(control=ControlSettings(mode=f"{__name__}:Scribbler"))
    particles = Particles(np.ones((2, 4)), np.ones(2), np.ones(2, np.uint64), np.ones(2, np.uint64))
    here = situation(cell=np.ones((4, 2)))._replace(generators=np.ones((3, 3)), particles=particles)
    control_law(config).command(here)
    assert all((array == 1).all() for array in (here.generators, here.cell, *here.particles))


class NoLaw:
    """It has no method command."""


def test_a_goal_within_one_step_is_reached_by_the_control_point() -> None:
    velocity, _ = approach(situation(control_point=(10.0, 20.0)), (10.6, 19.2))
    assert velocity == pytest.approx((1.2, -1.6))  # 1 m in 0.5 s is the limit of 2 m/s


@pytest.mark.parametrize("law", [Lloyd(), UniformDensity()])
def test_who_commands_every_fourth_tick_is_there_and_turned_at_the_fourth(law: ControlLaw) -> None:
    """The goal lies .3 m north of the control point and of the sensor: to be reached in 4 steps of .5 s, and no sooner."""
    goal = (50.0, 30.0)
    start = (goal[0], goal[1] - 0.3)
    here = situation(centroid=goal, pose=(*start, 0.0), control_point=start, cell=rectangle(100.0, 60.0))._replace(ticks=4)
    velocity, turn = law.command(here)
    assert velocity == pytest.approx((0.0, 0.3 / (4 * 0.5)))
    assert turn == pytest.approx(0.5 * math.pi / (4 * 0.5))


def test_a_goal_farther_away_is_approached_at_the_limit() -> None:
    velocity, _ = approach(situation(control_point=(10.0, 20.0)), (40.0, 60.0))
    assert velocity == pytest.approx((1.2, 1.6))


@given(places, places, st.floats(-math.pi, math.pi), st.sampled_from(["centroid", "literal"]))
def test_no_command_exceeds_the_limits(goal: tuple[float, float], place: tuple[float, float], heading: float, reading: str) -> None:
    velocity, turn = approach(situation(pose=(*place, heading), heading=reading), goal)
    assert math.hypot(*velocity) <= 2.0 * (1.0 + 1e-12)
    assert abs(turn) <= 5.0


@given(places, st.floats(-math.pi, math.pi))
def test_the_heading_turns_the_short_way_to_the_goal(goal: tuple[float, float], heading: float) -> None:
    """A bang-bang turn that stops at the goal: at most 5 rad/s, and exactly there when it can be reached within the step."""
    pose = (40.0, 30.0, heading)
    _, turn = approach(situation(pose=pose), goal)
    wanted = wrap_angle(math.atan2(goal[1] - 30.0, goal[0] - 40.0) - heading)
    assert turn == pytest.approx(max(-5.0, min(5.0, wanted / 0.5)), abs=1e-9)


def test_both_readings_of_the_heading() -> None:
    """The sensor stands 3 m west of the goal, its COD 1 m north of the goal: from the sensor it lies east, from the COD south."""
    facing = situation(pose=(47.0, 50.0, 0.5), control_point=(50.0, 51.0))
    assert approach(facing, (50.0, 50.0))[1] == pytest.approx(-0.5 / 0.5)
    assert approach(facing._replace(heading="literal"), (50.0, 50.0))[1] == pytest.approx((-math.pi / 2.0 - 0.5) / 0.5)


def test_a_goal_under_the_sensor_turns_nothing() -> None:
    assert approach(situation(pose=(50.0, 50.0, 1.0)), (50.0, 50.0))[1] == 0.0


def test_lloyd_drives_to_the_centroid_and_stands_without_one() -> None:
    here = situation(centroid=(50.0, 50.0), control_point=(49.5, 50.0))
    assert Lloyd().command(here)[0] == pytest.approx((1.0, 0.0))
    assert Lloyd().command(here._replace(centroid=None)) == STAND


def test_uniform_density_drives_to_the_centroid_of_the_area_whatever_the_targets_do() -> None:
    here = situation(centroid=(0.0, 0.0), control_point=(50.0, 29.5), cell=rectangle(100.0, 60.0))
    assert UniformDensity().command(here)[0] == pytest.approx((0.0, 1.0))
    assert UniformDensity().command(here._replace(cell=EMPTY)) == STAND


def test_static_never_moves() -> None:
    assert Static().command(situation()) == ((0.0, 0.0), 0.0)


def test_the_random_walk_keeps_a_goal_for_twenty_seconds_and_its_goals_fill_the_arena() -> None:
    law = RandomWalk()

    def goal(name: str, tick: int) -> tuple[float, float]:
        """Two bearings meet at the goal: the command from two control points."""
        lines = []
        for x in (-1000.0, 1e-9):
            (vx, vy), _ = law.command(situation(name=name, tick=tick, control_point=(x, -1000.0)))
            lines.append((x, vx / vy))
        (x1, m1), (x2, m2) = lines
        height = (x2 - x1) / (m1 - m2)
        return x1 + m1 * height, height - 1000.0

    first = [goal("s1", tick) for tick in (0, 20, 39)]
    assert first[1] == pytest.approx(first[0], abs=1e-6) and first[2] == pytest.approx(first[0], abs=1e-6)
    assert goal("s1", 40) != pytest.approx(first[0], abs=1e-3) and goal("s2", 0) != pytest.approx(first[0], abs=1e-3)
    many = np.array([goal("s1", 40 * leg) for leg in range(400)])
    assert (many >= -1e-6).all() and (many <= [100.0 + 1e-6, 60.0 + 1e-6]).all()
    assert many.mean(axis=0) == pytest.approx([50.0, 30.0], abs=4.5 * 100.0 / math.sqrt(12 * 400))


def test_laws_by_name_and_of_ones_own() -> None:
    for name, law in CONTROL_LAWS.items():
        assert type(control_law(AgentConfig(control=ControlSettings(mode=name)))) is law
    assert control_law(AgentConfig(control=ControlSettings(mode=f"{__name__}:Spin"))).command(situation()) == ((0.0, 0.0), 1.0)
    velocity, turn_rate = control_law(AgentConfig(control=ControlSettings(mode=f"{__name__}:Reckless"))).command(situation())
    assert velocity == pytest.approx((1.2, -1.6)) and turn_rate == -LimitSettings().turn_rate


def test_a_law_that_cannot_be_had_is_refused_with_what_there_is() -> None:
    with pytest.raises(BadSetting, match=r"control\.mode = 'loyd': known are lloyd, "):
        control_law(AgentConfig(control=ControlSettings(mode="loyd")))
    with pytest.raises(BadSetting, match="the class has no method command"):
        control_law(AgentConfig(control=ControlSettings(mode=f"{__name__}:NoLaw")))
    with pytest.raises(BadSetting, match="has no Nothing"):
        control_law(AgentConfig(control=ControlSettings(mode=f"{__name__}:Nothing")))
