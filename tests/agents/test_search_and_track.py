"""Search and track by numbers worked by hand: what is worth seeing, who leaves what to whom, where an agent goes and looks."""

import math
from typing import Any

import numpy as np
import pytest

from agents.agent import Agent
from agents.backend import PLAIN
from agents.compiled.backend import FAST
from agents.config import AgentConfig, ControlSettings, SearchSettings
from agents.coverage.control import Surroundings
from agents.coverage.laws import control_law
from agents.coverage.search_and_track import SearchAndTrack
from agents.coverage.search_plan import (
    SECTORS,
    Memory,
    PlanInput,
    Task,
    bin_values,
    decide,
    mark_view,
    no_memory,
    sector_of,
    unserved_shares,
    window_values,
    worth_at,
)
from agents.round import context_of
from agents.tracking.particles import NO_PARTICLES, Particles, unlabelled
from protocol.codec import decode, encode
from protocol.fields import Malformed
from protocol.message import Vector
from protocol.messages import Command, Gossip, Observation
from protocol.node import Started, received
from protocol.sensing import SENSOR_CLASSES, Pose, WedgeSensor
from tests.agents.gossip_table import table

NARROW = SENSOR_CLASSES["C"]  # 45 degrees, 8 m: the circle that it serves has a radius of 6.5 m
NOBODY = np.empty((0, 5))


def particles(*rows: tuple[float, ...]) -> Particles:
    """Particles of rows x, y, weight or x, y, weight, vx, vy; ids 1, 2, ..."""
    states = np.array([(x, y, *(motion or (0.0, 0.0))) for x, y, _, *motion in rows]).reshape(-1, 4)
    return unlabelled(states, np.array([row[2] for row in rows]), np.arange(1, len(rows) + 1, dtype=np.uint64))


def gossip(name: str, pose: Pose) -> Gossip:
    """A gossip of an agent of class C that scanned."""
    return Gossip(sender=name, incarnation=1, tick=4, pose=pose, cod=pose[:2], power_radius=1.0, unused=1.0)


def task(
    density: Particles = NO_PARTICLES,
    around: Particles = NO_PARTICLES,
    partners: np.ndarray = NOBODY,
    is_open: bool = False,
    goal: tuple[float, float] = (50.0, 50.0),
    settings: SearchSettings = SearchSettings(),
    sensor: WedgeSensor = NARROW,
    now: float = 1.0,
    arena: tuple[float, float] = (100.0, 100.0),
) -> Task:
    """What an agent at (50, 50) knows that faces east, in an arena of 100 x 100 m or another, with a step of 0.25 s."""
    numbers = PlanInput(
        now, 0.25, 50.0, 50.0, 1.0, 0.0, sensor.reach, sensor.angle, 5.0, *arena, 2.0, 5.0, 1.0 if is_open else 0.0, goal[0], goal[1]
    )
    own = table([gossip("s1", (50.0, 50.0, 0.0))], NARROW)
    return Task(numbers, settings, sensor, 0.0, Surroundings(density, around, own, partners, goal, is_open))


def seen(at: float) -> np.ndarray:
    """All bins of the arena in view at a time."""
    return np.full((50, 50), at)


def test_it_is_a_law_that_scenarios_name_and_gets_the_backend_of_its_agent() -> None:
    config = AgentConfig(control=ControlSettings(mode="search-and-track"), search=SearchSettings(weight=3.0), members={"s1": "A"})
    assert type(control_law(config)) is SearchAndTrack
    assert type(context_of(config, "s1", "A", PLAIN).law) is SearchAndTrack


def test_bins_with_their_centre_in_a_field_of_view_are_seen_now() -> None:
    """East of the sensor: (55, 51) lies 5.1 m away, 11 degrees off; (59, 51) beyond 8 m; (45, 51) behind."""
    after = mark_view(seen(-7.0), task().surroundings.table, 1.0, 2.0)
    assert [after[25, 27], after[25, 29], after[25, 22]] == [1.0, -7.0, -7.0]


def test_mass_in_bins_seen_lately_is_a_track_and_older_mass_counts_twentyfold() -> None:
    """Standing particles; bins seen 5 s ago, then 5.25 s ago."""
    held = task(particles((21.0, 31.0, 0.5)), now=10.0)
    watched_mass, values = bin_values(held, seen(5.0))
    assert (watched_mass[15, 10], values[15, 10]) == (0.5, 0.0)
    watched_mass, values = bin_values(held, seen(4.75))
    assert (watched_mass[15, 10], values[15, 10]) == (0.0, 10.0)


def test_mass_is_expected_where_it_will_be_and_what_leaves_counts_only_in_a_closed_arena() -> None:
    """2 m/s for 2.25 s: from 21 to 25.5 m; from 98 m to 102.5 m, or back at 97.5 m."""
    moving = particles((21.0, 31.0, 0.5, 2.0, 0.0), (98.0, 51.0, 1.0, 2.0, 0.0))
    watched_mass, _ = bin_values(task(moving), seen(1.0))
    assert (watched_mass[15, 12], watched_mass[25, 48], watched_mass.sum()) == (0.5, 1.0, 1.5)
    watched_mass, values = bin_values(task(moving, is_open=True), seen(1.0))
    assert watched_mass.sum() == 0.5
    assert values.sum() == pytest.approx(196 * 0.06)  # the bins of the border


@pytest.mark.parametrize(
    ("place", "velocity", "bin"),
    [((20.0, 19.0), (0.0, 2.0), (8, 10)), ((20.0, 1.0), (0.0, -2.0), (1, 10)), ((39.0, 9.0), (2.0, 0.0), (4, 18))],
)
def test_what_meets_a_wall_of_an_oblong_arena_comes_back(
    place: tuple[float, float], velocity: tuple[float, float], bin: tuple[int, int]
) -> None:
    """40 x 20 m: 4.5 m on from 1 m before a wall is 3.5 m before it."""
    moving = task(particles((*place, 1.0, *velocity)), arena=(40.0, 20.0))
    watched_mass, _ = bin_values(moving, np.full((10, 20), 1.0))
    assert watched_mass[bin] == watched_mass.sum() == 1.0


def test_a_particle_whose_way_was_in_view_is_a_track() -> None:
    """It left the last bins in view 2.5 s ago, at 31 m."""
    view = seen(-100.0)
    view[15, 15] = 0.0
    watched_mass, _ = bin_values(task(particles((36.0, 31.0, 1.0, 2.0, 0.0))), view)
    assert watched_mass.sum() == 1.0


def test_a_partner_with_a_smaller_cost_leaves_what_it_cannot_serve() -> None:
    """Radius 6.5 m. At the partner's goal its cost is -1, the own one 13.5; it serves all that is to be found there.

    Utilisation 2 means that it holds half of the tracks. A place 12.5 m from it and 10 m from here is nearer here.
    """
    partner = np.array([[70.0, 50.0, 2.0, 8.0, 0.0]])
    tracks, values = unserved_shares(task(partners=partner), np.array([70.0, 57.5]), np.array([50.0, 50.0]), 1.0)
    assert tracks.tolist() == [0.5, 1.0]
    assert values.tolist() == [0.0, 1.0]
    outside, _ = unserved_shares(task(partners=partner), np.array([70.0]), np.array([62.5]), 1.0)  # 6 m outside of its circle
    assert outside[0] == pytest.approx(1.0 - 0.5 * 0.4 * math.exp(-1.0))


def test_the_earlier_name_serves_a_place_where_the_costs_are_equal() -> None:
    both = np.array([50.0]), np.array([56.0])
    for first, left in ((1.0, 0.0), (0.0, 1.0)):
        partner = np.array([[50.0, 62.0, 0.0, 8.0, first]])
        assert unserved_shares(task(partners=partner), *both, 1.0)[0].tolist() == [left]


def test_a_track_is_worth_most_at_the_distance_of_the_cod() -> None:
    """COD 5 m ahead: 1 there, 1 - .4 on top of the sensor, 1 - .4 at the edge of the circle, .4 / e 6 m outside of it."""
    one, nothing = np.array([1.0]), np.array([0.0])
    worth = [worth_at(task(), (50.0, 50.0), np.array([50.0 + apart]), np.array([50.0]), one, nothing) for apart in (5.0, 0.0, 6.5, 12.5)]
    assert worth == pytest.approx([1.0, 0.6, 0.6, 0.4 * math.exp(-1.0)])
    assert worth_at(task(), (50.0, 50.0), np.array([52.0]), np.array([50.0]), nothing, one) == 1.0


def test_it_goes_towards_old_mass_and_announces_the_place_and_the_load() -> None:
    """Mass out of view 14 m to the west: a goal 4 m to the west, reached in 2 s at 2 m/s."""
    decision = decide(task(particles((36.0, 50.0, 1.0))), no_memory(100.0, 100.0, 2.0))
    assert decision.intent.goal == pytest.approx((46.0, 50.0))
    assert decision.velocity == pytest.approx((-2.0, 0.0))
    assert decision.intent.utilisation == 0.0
    watched = decide(task(particles((53.0, 50.5, 3.0))), Memory(seen(1.0), np.empty(0, np.uint64), np.empty(0)))
    assert watched.intent.utilisation == pytest.approx(3.0 / 1.5)  # a sensor of 45 degrees holds 1.5 targets


def test_it_leaves_to_a_partner_what_the_partner_serves() -> None:
    """The same mass, with a partner whose goal lies there: nothing is worth a step."""
    partner = np.array([[36.0, 50.0, 0.0, 8.0, 0.0]])
    assert decide(task(particles((36.0, 50.0, 1.0)), partners=partner), no_memory(100.0, 100.0, 2.0)).intent.goal == (50.0, 50.0)


def test_it_turns_to_mass_out_of_view_and_not_to_mass_that_a_partner_watches() -> None:
    """Mass 5 m to the north; a turn of 1.25 rad is 14 sectors of 5 degrees."""
    north = particles((50.0, 55.0, 1.0))
    assert 0.25 * decide(task(around=north), no_memory(100.0, 100.0, 2.0)).turn_rate == pytest.approx(math.radians(70.0))
    partner = np.array([[50.0, 55.0, 0.0, 8.0, 0.0]])
    idle = decide(task(around=north, partners=partner), no_memory(100.0, 100.0, 2.0)).turn_rate
    assert 0.25 * idle == pytest.approx(0.9 * math.pi / 4.0)  # the first turn of a sensor that has nothing to look at


def test_of_two_places_it_looks_at_the_one_that_was_out_of_view_for_longer() -> None:
    """Particle 2, 40 degrees to the right, was seen 2 s ago; particle 1, as far to the left, in the last tick."""
    angle = math.radians(40.0)
    both = particles(*((50.0 + 5.0 * math.cos(side), 50.0 + 5.0 * math.sin(side), 1.0) for side in (angle, -angle)))
    memory = Memory(seen(-7.0), both.ids, np.array([0.75, -1.0]))
    assert decide(task(around=both), memory).turn_rate < 0.0


def test_sectors_count_counter_clockwise_from_ahead() -> None:
    angles = np.radians([0.0, 2.0, 5.0, 90.0, 178.0, -178.0, -5.0, -2.0])
    assert sector_of(np.cos(angles), np.sin(angles)).tolist() == [0, 0, 1, 18, 36, 36, 71, 0]


def receive(**fields: Any) -> None:
    """Raise what a receiver of a gossip with these fields raises."""
    gossip = Gossip(sender="s1", incarnation=1, tick=4, pose=(0, 0, 0), cod=(0, 0), power_radius=1.0, unused=1.0, **fields)
    decode("covey/demo/gossip/s1", encode(gossip))


@pytest.mark.parametrize("goal", [(math.nan, 1.0), (1.0, math.inf), (1.0e7, 1.0)])
def test_a_goal_that_is_no_place_is_refused(goal: tuple[float, float]) -> None:
    with pytest.raises(Malformed, match="goal"):
        receive(goal=goal)


@pytest.mark.parametrize("value", [math.nan, -1.0, math.inf])
def test_a_utilisation_that_is_no_number_is_refused(value: float) -> None:
    with pytest.raises(Malformed, match="goal_utilisation"):
        receive(goal_utilisation=value)


def test_an_agent_without_a_goal_counts_as_one_that_stays() -> None:
    with_goal = Gossip(sender="s2", incarnation=1, tick=4, pose=(3.0, 4.0, 0.0), cod=(0, 0), power_radius=1.0, unused=1.0, goal=(7.0, 8.0))
    assert table([gossip("s1", (1.0, 2.0, 0.0)), with_goal]).plans.tolist() == [[1.0, 2.0, 0.0], [7.0, 8.0, 0.0]]


def test_a_world_of_another_size_and_pace_is_searched_alike() -> None:
    """All lengths times 64 and all times times 4, the side of a bin and the times of the law included: the decision is the same, to the
    last bit."""
    far, long = 64.0, 4.0
    rng = np.random.default_rng(8)
    slow = SearchSettings(bin=2.0 * far, horizon=2.0 * long, stale=5.0 * long)
    large = WedgeSensor(NARROW.angle, NARROW.radius * far, 0.9)
    searched = 0
    for seed in range(20):
        rows = [(*rng.uniform(30.0, 70.0, 2), rng.uniform(0.0, 0.3), *rng.normal(0.0, 1.0, 2)) for _ in range(60)]
        partners = np.column_stack([rng.uniform(35.0, 65.0, (3, 2)), rng.uniform(0.5, 2.0, 3), [8.0, 8.0, 20.0], [1.0, 0.0, 1.0]])
        times = rng.uniform(-9.0, 1.0, (50, 50))
        small_task = task(particles(*rows), particles(*rows), partners, is_open=bool(seed % 2), goal=(51.0, 49.0))
        one = decide(small_task, Memory(times, np.empty(0, dtype=np.uint64), np.empty(0)))
        wide = [(x * far, y * far, weight, vx * far / long, vy * far / long) for x, y, weight, vx, vy in rows]
        numbers = small_task.numbers
        lengths = {name: getattr(numbers, name) * far for name in ("x", "y", "reach", "offset", "width", "height", "goal_x", "goal_y")}
        rates = {"speed": numbers.speed * far / long, "turn_rate": numbers.turn_rate / long}
        large_numbers = numbers._replace(**lengths, **rates, now=numbers.now * long, dt=numbers.dt * long)
        own = table([gossip("s1", (50.0 * far, 50.0 * far, 0.0))], large)
        surroundings = small_task.surroundings._replace(density=particles(*wide), around=particles(*wide))
        farther = partners * [far, far, 1.0, far, 1.0]
        other = decide(
            Task(large_numbers, slow, large, 0.0, surroundings._replace(table=own, partners=farther)),
            Memory(times * long, np.empty(0, dtype=np.uint64), np.empty(0)),
        )
        assert (other.intent.goal[0] / far, other.intent.goal[1] / far, other.intent.utilisation) == (
            *one.intent.goal,
            one.intent.utilisation,
        )
        assert (other.turn_rate * long, other.velocity[0] * long / far) == (one.turn_rate, one.velocity[0])
        assert np.array_equal(other.memory.last, one.memory.last * long)
        searched += one.intent.goal != (50.0, 50.0)
    assert searched > 10


@pytest.mark.parametrize("half", [4, 22, 35])
def test_a_wide_window_and_a_wide_turn_are_worth_the_same_to_the_left_and_to_the_right(half: int) -> None:
    held, order = np.random.default_rng(half).random(SECTORS), [*range(-35, 36)]
    mirrored = np.roll(held[::-1], 1)
    assert window_values(held, half, order, 0.5) == pytest.approx(window_values(mirrored, half, order, 0.5)[::-1])


def test_a_command_that_lasts_longer_than_the_horizon_ends_at_the_goal() -> None:
    known = task(particles((58.0, 50.0, 2.0)), settings=SearchSettings(horizon=1.0))
    known = known._replace(numbers=known.numbers._replace(dt=2.0))
    found = decide(known, no_memory(100.0, 100.0, 2.0))
    assert found.intent.goal != (50.0, 50.0)
    assert (50.0 + 2.0 * found.velocity[0], 50.0 + 2.0 * found.velocity[1]) == pytest.approx(found.intent.goal)


def test_a_sensor_that_sees_all_around_need_not_turn() -> None:
    around = WedgeSensor(2.0 * math.pi, 8.0, 0.9)
    assert decide(task(sensor=around), no_memory(100.0, 100.0, 2.0)).turn_rate == 0.0


@pytest.mark.parametrize(("speed", "turn_rate", "name"), [(0.0, 1.0, "C"), (2.0, 1.0, "C"), (4.0, 5.0, "A")])
def test_plain_and_compiled_decisions_agree_when_a_tick_is_long(speed: float, turn_rate: float, name: str) -> None:
    """Up to 8 m in a tick of 2 s, which is eight bins; a body may also stand, and only turn. A has 240 degrees."""
    fast = pytest.importorskip("agents.compiled.backend").FAST
    rng = np.random.default_rng(5)
    for _ in range(60):
        rows = [(*rng.uniform(35.0, 65.0, 2), rng.uniform(0.0, 0.3), *rng.normal(0.0, 1.0, 2)) for _ in range(80)]
        partners = np.column_stack([rng.uniform(35.0, 65.0, (3, 2)), rng.uniform(0.5, 2.0, 3), [8.0, 8.0, 20.0], [1.0, 0.0, 1.0]])
        short = SearchSettings(horizon=1.0, bin=1.0)
        known = task(particles(*rows), particles(*rows), partners, goal=(51.0, 49.0), sensor=SENSOR_CLASSES[name], settings=short)
        known = known._replace(numbers=known.numbers._replace(dt=2.0, turn_rate=turn_rate, speed=speed))
        memory = Memory(rng.uniform(-9.0, 1.0, (100, 100)), np.empty(0, dtype=np.uint64), np.empty(0))
        plain, compiled = decide(known, memory), fast.decide(known, memory)
        assert plain[:3] == compiled[:3]
        assert all(np.array_equal(one, other) for one, other in zip(plain.memory, compiled.memory))


@pytest.mark.parametrize("place", [(50.0, -45.0), (50.0, 145.0), (-45.0, 50.0), (145.0, 50.0), (145.0, 145.0)])
def test_a_body_far_outside_of_the_arena_is_driven_back_by_both_arithmetics(place: Vector) -> None:
    """No bin lies near it then, and no goal has been announced yet."""
    seen = Observation(sender="world", incarnation=1, recipient="s1", tick=0, time=0.0, pose=(*place, 0.0))
    commands = []
    for backend in (PLAIN, FAST):
        agent = Agent(AgentConfig(members={"s1": "A"}, control=ControlSettings(mode="search-and-track")), "s1", 1, backend)
        agent.handle(Started(), 0.0)
        commands += [effect for effect in agent.handle(received(seen), 1.0) if isinstance(effect, Command)]
    assert len(commands) == 2 and commands[0] == commands[1]
    x, y = commands[0].velocity
    assert (50.0 - place[0]) * x + (50.0 - place[1]) * y > 0.0
