"""The goals that search and track chooses, and the utilisation that it announces, beside formulas written from its page."""

import math

import msgspec
import numpy as np
import pytest

from agents.config import SearchSettings
from agents.coverage.control import Surroundings
from agents.coverage.search_plan import Memory, PlanInput, Task, bin_values, decide, mark_view, unserved_shares
from agents.tracking.particles import NO_PARTICLES, unlabelled
from protocol.messages import Gossip
from protocol.sensing import SENSOR_CLASSES
from tests.agents.gossip_table import table
from tests.oracle.search_goal import Bin, bins, candidates, utilisation, worth_of

SIDE, PLACE = 60.0, (31.0, 28.0)


def known(seed: int) -> tuple[Task, Memory]:
    """A sensor among partners, with particles that move, and bins that were seen at any time within 10 s."""
    rng = np.random.default_rng(seed)
    sensor, settings = SENSOR_CLASSES["ACFG"[seed % 4]], SearchSettings(bin=(1.0, 2.0, 3.0)[seed % 3], sharing=(1.0, 0.5)[seed % 2])
    states, goal = np.column_stack([rng.uniform(0.0, SIDE, (60, 2)), rng.normal(0.0, 2.0, (60, 2))]), (33.0, 30.0)
    density = unlabelled(states, rng.uniform(0.0, 0.4, 60), np.arange(1, 61, dtype=np.uint64))
    partners = np.column_stack([rng.uniform(15.0, 45.0, (4, 2)), [0.0, 0.7, 2.0, 30.0], [8.0, 8.0, 10.0, 25.0], [1.0, 0.0, 1.0, 0.0]])
    partners[0, :2] = goal  # a tie, where its reach is the own one
    gossip = Gossip(sender="s1", incarnation=1, tick=4, pose=(*PLACE, 0.0), cod=PLACE, power_radius=1.0, unused=1.0)
    around = Surroundings(density, NO_PARTICLES, table([gossip], sensor), partners, goal, bool(seed % 2))
    numbers = PlanInput(100.0, 0.25, *PLACE, 1.0, 0.0, sensor.reach, sensor.angle, 4.0, SIDE, SIDE, 2.0, 5.0, float(around.is_open), *goal)
    bins_along = math.ceil(SIDE / settings.bin)
    seen = 100.0 - rng.uniform(0.0, 10.0, (bins_along, bins_along))
    return Task(numbers, settings, sensor, 0.0, around), Memory(seen, np.empty(0, dtype=np.uint64), np.empty(0))


def judged(task: Task, seen: np.ndarray) -> list[Bin]:
    """The bins as the oracle values them."""

    def last(x: float, y: float) -> float:
        side = task.settings.bin
        return float(seen[int(y // side), int(x // side)]) if 0.0 <= x < SIDE and 0.0 <= y < SIDE else -math.inf

    density = task.surroundings.density
    particles = [(*state, weight) for state, weight in zip(density.states.tolist(), density.weights.tolist())]
    partners = [tuple(row) for row in task.surroundings.partners.tolist()]
    return bins(particles, partners, last, task.numbers._asdict(), msgspec.structs.asdict(task.settings))


@pytest.mark.parametrize("seed", range(24))
def test_no_place_is_worth_more_than_the_goal_and_the_utilisation_is_that_of_the_page(seed: int) -> None:
    task, memory = known(seed)
    own, search = task.numbers._asdict(), msgspec.structs.asdict(task.settings)
    worth = judged(task, mark_view(memory.seen, task.surroundings.table, task.numbers.now, task.settings.bin))
    intent = decide(task, memory).intent
    best = max(worth_of(place, worth, own, search) for place in candidates(own, search))
    assert best > 0.0 and worth_of(intent.goal, worth, own, search) == pytest.approx(best, rel=1e-9)
    assert intent.utilisation == pytest.approx(utilisation(worth, own, search), rel=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_partners_leave_of_each_bin_what_the_page_says(seed: int) -> None:
    task, memory = known(seed)
    x, y, *theirs = np.array(judged(task, memory.seen)).T
    side = task.settings.bin
    rows, columns = (y // side).astype(int), (x // side).astype(int)
    left = unserved_shares(task, x, y, task.settings.sharing)
    for found, share, expected in zip(bin_values(task, memory.seen), left, theirs):
        assert found[rows, columns] * share == pytest.approx(expected, rel=1e-9)
