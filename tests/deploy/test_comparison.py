"""Two diagrams in step: what is compared differs in the diagram alone, and what is clicked happens to both."""

import asyncio
import struct
from typing import Any

import msgspec
import numpy as np
import pytest

from deploy.cli.compare import compare
from deploy.page.comparison import ComparisonSource
from deploy.page.frames import frame, greeting
from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol.settings import BadSetting


def played(ticks: int = 12, **settings: Any) -> ComparisonSource:
    source = ComparisonSource(resolve("quick", {"run.seconds": 20.0, **settings}), ("power", "voronoi"))
    source.play(ticks)
    return source


def test_both_sides_are_at_one_tick_with_the_same_targets_and_other_cells() -> None:
    source = played()
    data = frame(source.picture, source.score(), source.extra(), source.beside())
    length = struct.unpack_from("<I", data)[0]
    left = msgspec.json.decode(data[4 : 4 + length])
    right = left["beside"]
    assert left["tick"] == right["tick"] == 10
    assert left["targets"] == right["targets"]
    assert left["score"] != right["score"]
    assert [one["cell"] for one in left["agents"]] != [one["cell"] for one in right["agents"]]
    assert len(data) == 4 + length + 2 * left["grid"][0] * left["grid"][1]
    hello = msgspec.json.decode(greeting(source.picture, source.scores(), source.about(True)))
    assert (hello["source"], hello["beside"]["partition"], len(hello["beside"]["ospa"])) == ("comparison", "voronoi", 12)


def test_the_left_side_is_the_run_that_is_simulated_alone() -> None:
    source = played()
    alone = Simulation(resolve("quick", {"run.seconds": 20.0}))
    while alone.scorer.truth is None or alone.scorer.truth.tick < 12:
        alone.bus.step()
    assert [score.ospa for score in source.scores()] == [score.ospa for score in alone.scorer.scores][: len(source.scores())]


def test_a_kill_is_a_kill_on_both_sides_and_stands_on_the_time_line() -> None:
    source = played()
    assert asyncio.run(source.ask({"verb": "kill", "who": "s2"})) == "s2 is killed on both sides"
    source.play(15)
    assert [side.picture.agents["s2"].state for side in source.sides] == ["dead", "dead"]
    assert ("asked", "s2") in [(one.kind, one.who) for one in source.picture.happenings]
    for wrong in ({"verb": "pause", "who": "s1"}, {"verb": "kill", "who": "s99"}, {}):
        with pytest.raises(BadSetting, match=r"should be one of|there is no such agent"):
            asyncio.run(source.ask(wrong))


def test_a_dragged_target_is_there_on_both_sides_and_moves_on_from_there() -> None:
    source = played(**{"targets.speed": 0.1})
    number = int(source.picture.truth.ids[0])  # type: ignore[union-attr]
    asyncio.run(source.ask({"drag": number, "to": [3.0, 4.0]}))
    source.play(14)
    for side in source.sides:
        truth = side.picture.truth
        assert truth is not None
        near = np.linalg.norm(truth.targets - [3.0, 4.0], axis=1) < 0.25
        assert truth.ids[near].tolist() == [number]  # the others stay where they were
    for wrong in ({"drag": 1, "to": [3.0]}, {"drag": 1, "to": [3.0, 400.0]}, {"drag": "x", "to": [3.0, 4.0]}):
        with pytest.raises(BadSetting, match="should be"):
            asyncio.run(source.ask(wrong))


def test_recorded_targets_cannot_be_dragged() -> None:
    simulation = Simulation(resolve("students03", {"run.seconds": 5.0}))
    with pytest.raises(BadSetting, match="a target can be moved in a simulated world only"):
        simulation.move_target(1, (1.0, 1.0))


def test_a_diagram_is_not_compared_with_itself() -> None:
    with pytest.raises(BadSetting, match="--against power: is the scenario's own diagram"):
        compare(resolve("quick", {}), "power", False, 2.0, False)
