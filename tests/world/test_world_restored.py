"""A world that goes on from a Truth which was kept."""

import msgspec
import numpy as np
import pytest

from protocol.messages import Hello, Observation
from protocol.node import Alive, Gone, Started, Timer, received
from protocol.observer_messages import Truth
from protocol.sensing import SENSOR_CLASSES
from protocol.settings import BadSetting
from tests.world.stage import command, config, feed, hello, of_kind, started
from world.config import WorldConfig
from world.world import World


def run_on(settings: WorldConfig, ticks: int) -> tuple[World, list[Truth]]:
    world, effects = started(settings)
    truths = of_kind(Truth, effects)
    for tick in range(ticks):
        truths += of_kind(Truth, feed(world, command("s1", tick), command("s2", tick)))
    return world, truths


def test_a_restored_world_goes_on_two_ticks_later_with_the_same_targets() -> None:
    _, truths = run_on(config(), 8)
    world = World(config(), 2, truths[4])
    feed(world, Started(), Alive("agent", "s1", 1), Alive("agent", "s2", 1), hello("s1"), now=50.0)
    (truth,) = of_kind(Truth, feed(world, hello("s2"), now=50.0))
    assert (truth.tick, truth.time) == (6, 3.0)
    assert truth.targets.tobytes() == truths[6].targets.tobytes()
    assert truth.ids.tobytes() == truths[6].ids.tobytes()
    np.testing.assert_array_equal(truth.poses, truths[4].poses)


def test_a_restored_world_waits_only_a_second_and_only_for_who_was_alive() -> None:
    truth = run_on(config(), 2)[1][2]
    world = World(config(), 2, with_alive(truth, alive=("s2",)))
    feed(world, Started(), Alive("agent", "s2", 1), now=10.0)
    assert of_kind(Observation, feed(world, Timer(), now=10.5)) == []
    assert [one.recipient for one in of_kind(Observation, feed(world, Timer(), now=11.0))] == ["s2"]
    world = World(config(), 2, with_alive(truth, alive=("s2",)))
    feed(world, Started(), Alive("agent", "s2", 1), now=10.0)
    assert len(of_kind(Observation, feed(world, hello("s2"), now=10.1))) == 1


def test_real_time_goes_on_at_its_period_after_a_restore() -> None:
    truth = run_on(config(), 2)[1][2]
    world = World(config("realtime"), 2, truth)
    feed(world, Started(), Alive("agent", "s1", 1), Alive("agent", "s2", 1), hello("s1"), hello("s2"), now=70.0)
    assert world.deadline() == 70.5
    assert world.tick == 4


def test_the_bodies_of_guests_stand_where_they_stood_and_a_guest_that_comes_back_finds_its_own() -> None:
    world, _ = started(config())
    hellos = {name: received(Hello(sender=name, incarnation=1, sensor=SENSOR_CLASSES["D"])) for name in ("g1", "g2")}
    for name, said in hellos.items():
        feed(world, Alive("agent", name, 1), said)
    feed(world, Gone("agent", "g1", 1), command("s1", 0))
    (kept,) = of_kind(Truth, feed(world, command("s2", 0)))
    again = World(config(), 2, kept)
    feed(again, Started(), *(Alive("agent", name, 1) for name in ("s1", "s2", "g2")), hello("s1"), hello("s2"), now=50.0)
    (truth,) = of_kind(Truth, feed(again, Timer(), now=51.5))
    assert truth.bodies == ("s1", "s2", "g1", "g2") and truth.alive == ("s1", "s2")
    np.testing.assert_array_equal(truth.poses, kept.poses)
    feed(again, hellos["g2"], command("s1", 3), now=51.6)
    effects = feed(again, command("s2", 3), now=51.6)
    (seen,) = [one for one in of_kind(Observation, effects) if one.recipient == "g2"]
    assert list(seen.pose) == kept.poses[3].tolist()


def test_a_truth_of_another_run_is_refused() -> None:
    truth = run_on(config(), 1)[1][1]
    with pytest.raises(BadSetting, match="restore: tick 1 that was kept does not come from this scenario and seed 2"):
        World(config(seed=2), 2, truth)


def with_alive(truth: Truth, alive: tuple[str, ...]) -> Truth:
    return msgspec.structs.replace(truth, alive=alive)
