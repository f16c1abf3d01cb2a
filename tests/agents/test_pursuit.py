"""Pursuit: where it looks, where it goes, and what it remembers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.config import AgentConfig, ControlSettings
from agents.coverage.control import STAND, Situation
from agents.coverage.laws import control_law
from agents.coverage.pursuit import STALE_AGE, Pursuit
from agents.tracking.particles import NO_PARTICLES, Particles, unlabelled
from protocol.geometry import EMPTY, rectangle
from protocol.sensing import SENSOR_CLASSES, Pose
from protocol.settings import LimitSettings

NARROW = SENSOR_CLASSES["C"]  # 45 degrees, 8 m
COD_AHEAD = 2.0 * 8.0 * math.sin(math.pi / 8.0) / (3.0 * math.pi / 8.0)  # m


def particles(*rows: tuple[float, float, float]) -> Particles:
    """Particles of rows x, y, weight, ids 1, 2, ..."""
    table = np.array(rows, dtype=float).reshape(-1, 3)
    states = np.column_stack([table[:, :2], np.zeros((len(table), 2))])
    return unlabelled(states, table[:, 2], np.arange(1, len(table) + 1, dtype=np.uint64))


def situation(held: Particles, tick: int = 0, pose: Pose = (50.0, 50.0, 0.0), fields: tuple[Pose, ...] = ()) -> Situation:
    """An agent of class C that holds some particles, a step of 0.5 s; `fields` are poses of sensors of class C that scanned."""
    return Situation(
        name="s1",
        seed=1,
        tick=tick,
        dt=0.5,
        pose=pose,
        control_point=(pose[0], pose[1]),
        cell=rectangle(100.0, 100.0),
        centroid=(50.0, 50.0),
        particles=held,
        sensor=NARROW,
        limits=LimitSettings(),
        heading="centroid",
        arena=(100.0, 100.0),
        nearby_sensors=tuple((NARROW, field) for field in fields),
    )


def test_it_is_a_law_that_scenarios_name() -> None:
    assert type(control_law(AgentConfig(control=ControlSettings(mode="pursuit")))) is Pursuit


def test_who_commands_every_fourth_tick_arrives_at_the_fourth() -> None:
    """Mass 5 m to the left: the COD needs a move and a quarter turn, both within four ticks, and then it lies on the mass."""
    (vx, vy), turn = Pursuit().command(situation(particles((50.0, 55.0, 1.0)))._replace(ticks=4))
    x, y, heading = 50.0 + 4 * 0.5 * vx, 50.0 + 4 * 0.5 * vy, 4 * 0.5 * turn
    assert math.hypot(x - 50.0, y - 55.0) == pytest.approx(COD_AHEAD)
    assert heading == pytest.approx(math.pi / 2.0, abs=math.pi / 8.0)


def test_it_turns_to_the_mass_that_its_footprint_can_hold() -> None:
    """Mass at 90 degrees to the left, 5 m away: within reach of one step at 5 rad/s."""
    _, turn = Pursuit().command(situation(particles((50.0, 55.0, 1.0))))
    assert 0.5 * turn == pytest.approx(math.pi / 2.0, abs=math.pi / 8.0)


def test_of_turns_after_which_its_footprint_holds_as_much_it_takes_the_least() -> None:
    _, turn = Pursuit().command(situation(particles((54.0, 50.0, 1.0))))
    assert turn == 0.0


def test_of_two_places_it_looks_at_the_one_that_was_out_of_sight() -> None:
    """Equal mass left and right; another sensor watches the right one: 0.1 against 0.1 + 1 - exp(-2.5 / 0.5)."""
    held = particles((50.0, 55.0, 1.0), (50.0, 45.0, 1.0))
    _, turn = Pursuit().command(situation(held, fields=((47.0, 45.0, 0.0),)))
    assert turn > 0.0
    _, turn = Pursuit().command(situation(held, fields=((47.0, 55.0, 0.0),)))
    assert turn < 0.0


def test_it_keeps_the_distance_of_the_cod_to_the_centroid() -> None:
    """Nearer it backs off, farther it comes closer, by one step at most; at the distance it stands."""
    for apart, speed in ((COD_AHEAD, 0.0), (COD_AHEAD + 0.5, 1.0), (COD_AHEAD - 0.5, -1.0), (40.0, 2.0), (0.5, -2.0)):
        velocity, _ = Pursuit().command(situation(particles((50.0 + apart, 50.0, 1.0))))
        assert velocity == pytest.approx((speed, 0.0), abs=1e-9)


def test_mass_that_has_been_out_of_sight_for_long_counts_little_in_the_centroid() -> None:
    """Two equal masses at 20 and 80 m; the left one is seen in every tick, the right one never: after 5 s C = (20 + .1 x 80) / 1.1."""
    law, held = Pursuit(), particles((20.0, 50.0, 1.0), (80.0, 50.0, 1.0))
    watched = ((18.0, 50.0, 0.0),)
    early = law.command(situation(held, 0, (50.0, 90.0, 0.0), watched))[0]
    late = early
    for tick in range(1, 2 * int(STALE_AGE) + 1):
        late = law.command(situation(held, tick, (50.0, 90.0, 0.0), watched))[0]
    assert early[0] == pytest.approx(0.0, abs=1e-9)
    assert late[0] / late[1] == pytest.approx(((20.0 + 0.1 * 80.0) / 1.1 - 50.0) / (50.0 - 90.0))


def test_without_mass_it_goes_to_the_middle_of_the_cell_and_without_a_cell_to_that_of_its_voronoi_cell() -> None:
    here = situation(NO_PARTICLES, pose=(10.0, 50.0, 0.0))
    assert Pursuit().command(here)[0] == pytest.approx((2.0, 0.0))
    homeless = here._replace(cell=EMPTY, centroid=None, generators=np.array([[10.0, 50.0], [30.0, 50.0]]), own_generator=0)
    lone = Pursuit().command(homeless)[0]  # x < 20: the middle is (10, 50), where it stands
    assert lone == pytest.approx((0.0, 0.0))
    assert Pursuit().command(homeless._replace(own_generator=1))[0] == pytest.approx((2.0, 0.0))  # (60, 50)
    assert Pursuit().command(here._replace(centroid=None)) == STAND


@given(
    st.lists(st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 100.0), st.floats(0.0, 1.0)), max_size=10),
    st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 100.0), st.floats(-math.pi, math.pi)),
)
def test_no_command_exceeds_the_limits(rows: list[tuple[float, float, float]], pose: Pose) -> None:
    velocity, turn = Pursuit().command(situation(particles(*rows), pose=pose))
    assert math.hypot(*velocity) <= 2.0 * (1.0 + 1e-12) and abs(turn) <= 5.0 * (1.0 + 1e-12)
