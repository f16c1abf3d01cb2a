"""Two variants in step: what is compared differs in the diagram or the law alone, and what is clicked happens to both."""

import asyncio
import struct
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from deploy.cli.compare import compare, difference
from deploy.cli.foreground import beside_in_words
from deploy.cli.options import RunOptions
from deploy.cli.start import other_law
from deploy.page.comparison import ComparisonSource
from deploy.page.frames import frame, greeting
from deploy.page.picture import Picture
from deploy.page.server import PageServer
from deploy.page.simulated_swarm import SimulatedSwarm
from deploy.page.source import LiveSource
from deploy.scenario import FaultSettings, resolve, with_deaths
from deploy.simulation import Simulation
from deploy.storage.run_directory import RunDirectory
from protocol.settings import BadSetting


def side(name: str, **settings: Any) -> SimulatedSwarm:
    return SimulatedSwarm(name, resolve("quick", {"run.seconds": 20.0, **settings}))


def played(ticks: int = 12, **settings: Any) -> ComparisonSource:
    source = ComparisonSource((side("power", **settings), side("voronoi", **{**settings, "partition.kind": "voronoi"})))
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
    assert (hello["source"], hello["beside"]["names"], len(hello["beside"]["ospa"])) == ("comparison", ["power", "voronoi"], 12)


def test_what_could_not_be_played_in_time_is_not_made_up_for_when_the_speed_falls() -> None:
    source = ComparisonSource((side("power"), side("voronoi")), speed=100.0)
    for _ in range(50):
        source._pass(0.1)
    source.speed = 0.5
    source._pass(0.01)
    assert source._clock <= 1.0


class FailsLater:
    """A law that answers wrongly in tick 6."""

    def command(self, situation: Any) -> Any:
        return "left" if situation.tick == 6 else ((0.0, 0.0), 0.0)


def test_a_law_that_fails_ends_the_comparison_with_its_line_and_the_demo_goes_on_without_the_swarm_beside() -> None:
    one, other = side("power"), side("mine", **{"control.mode": f"{__name__}:FailsLater"})
    source = ComparisonSource((one, other))
    with pytest.raises(BadSetting, match=r"FailsLater\.command returned 'left'"):
        source.play(30)
    assert "mine: " in source.picture.happenings[-1].text and "FailsLater" in source.picture.happenings[-1].text
    reached = other.tick
    other.play(30)
    assert other.tick == reached < 12
    told = beside_in_words(one.simulation.result(), other)
    assert told.startswith("mine in the same world: ") and "FailsLater.command returned 'left'" in told


def test_a_paused_agent_is_paused_on_the_page_of_a_simulated_swarm() -> None:
    paused = FaultSettings(at=1.0, verb="pause", who="s2")
    swarm = SimulatedSwarm("power", msgspec.structs.replace(resolve("quick", {"run.seconds": 20.0}), faults=(paused,)))
    swarm.play(8)
    assert swarm.picture.agents["s2"].state == "paused"


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


def test_two_variants_are_called_by_what_differs() -> None:
    scenario = resolve("quick", {})
    assert difference(scenario, resolve("quick", {"partition.kind": "voronoi"})) == ("power", "voronoi")
    searching = resolve("quick", {"control.mode": "search-and-track"})
    assert difference(scenario, searching) == ("the paper's method", "search and track")
    assert difference(searching, resolve("quick", {"control.mode": "pursuit"})) == ("search and track", "pursuit")


def test_a_scenario_is_not_compared_with_itself() -> None:
    with pytest.raises(BadSetting, match="--against: should differ from power and lloyd, which the scenario has"):
        compare(resolve("quick", {}), resolve("quick", {}), True, 2.0, False)


@pytest.mark.parametrize(
    ("page", "speed", "complaint"), [(False, 2.0, "--no-page: a comparison is seen"), (True, 0.0, "--speed 0: should be")]
)
def test_a_comparison_needs_a_page_and_a_speed(page: bool, speed: float, complaint: str) -> None:
    with pytest.raises(BadSetting, match=complaint):
        compare(resolve("quick", {}), resolve("quick", {"partition.kind": "voronoi"}), page, speed, False)


def test_a_comparison_names_the_faults_that_change_nothing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    async def serve_for_a_moment(server: PageServer) -> None:
        await server.open()
        await server.close()

    monkeypatch.setattr("deploy.cli.compare._serve", serve_for_a_moment)
    late = (FaultSettings(at=0.0, verb="delay", who="", value=0.5),)
    one, other = (msgspec.structs.replace(resolve("quick", {"partition.kind": kind}), faults=late) for kind in ("power", "voronoi"))
    assert compare(one, other, "0", 2.0, False) == 0
    assert "delay" in capsys.readouterr().err


def live_beside_simulated(directory: Path) -> tuple[LiveSource, Simulation, SimulatedSwarm]:
    """A source of a running swarm, here simulated as well, with search and track beside it."""
    running = Simulation(resolve("quick", {"run.seconds": 20.0}))
    picture = Picture(running.scenario)
    running.scorer.on_event = picture.see
    other = side("search and track, simulated", **{"control.mode": "search-and-track"})
    return LiveSource(running.scorer, picture, RunDirectory(directory), name="the paper's method, live", other=other), running, other


def test_the_swarm_beside_a_live_one_is_played_to_its_tick_and_no_further(tmp_path: Path) -> None:
    source, running, _ = live_beside_simulated(tmp_path)
    while running.scorer.truth is None or running.scorer.truth.tick < 5:
        running.bus.step()

    async def some_chores() -> None:
        chores = asyncio.create_task(source.run_while_shown())
        while (beside := source.beside()) is None or beside[0].truth is None or beside[0].truth.tick < 5:
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.1)
        chores.cancel()

    asyncio.run(some_chores())
    beside = source.beside()
    assert beside is not None and beside[0].truth is not None and beside[0].truth.tick == 5
    assert np.array_equal(beside[0].truth.targets, running.scorer.truth.targets)
    assert (source.score().tick, beside[1].tick) == (3, 3)  # type: ignore[union-attr]
    running.bus.step()
    while running.scorer.truth.tick < 7:
        running.bus.step()
    data = frame(source.picture, source.score(), source.extra(), source.beside())
    left = msgspec.json.decode(data[4 : 4 + struct.unpack_from("<I", data)[0]])
    assert left["tick"] == left["beside"]["tick"] == 3  # the other one is two ticks behind
    assert left["targets"] == left["beside"]["targets"]
    hello = msgspec.json.decode(greeting(source.picture, source.scores(), source.about(True)))
    assert hello["beside"]["names"] == ["the paper's method, live", "search and track, simulated"]


def test_a_live_swarm_keeps_its_figures_while_the_one_beside_it_lags_far_behind(tmp_path: Path) -> None:
    source, running, other = live_beside_simulated(tmp_path)
    other.play(3)
    while running.scorer.truth is None or running.scorer.truth.tick < 40:
        running.bus.step()
    score, beside = source.score(), source.beside()
    assert score is not None and score.tick == 38
    assert beside is not None and beside[1] is None
    other.play(30)
    assert source.score() == score, "a picture goes back in time"
    other.play(40)
    beside = source.beside()
    assert source.score() == score and beside is not None and beside[1] is not None and beside[1].tick == 38


def test_who_is_killed_in_the_live_swarm_dies_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, _, other = live_beside_simulated(tmp_path)
    asked: list[tuple[str, str]] = []

    async def supervisor(directory: RunDirectory, verb: str, who: str) -> dict[str, Any]:
        asked.append((verb, who))
        return {"ok": f"{verb} {who}"}

    monkeypatch.setattr("deploy.page.source.ask", supervisor)
    other.play(3)
    assert asyncio.run(source.ask({"verb": "kill", "who": "s2"})) == "kill s2"
    assert asyncio.run(source.ask({"verb": "pause", "who": "s3"})) == "pause s3"
    assert asked == [("kill", "s2"), ("pause", "s3")]
    other.play(6)
    assert [name for name, known in other.picture.agents.items() if known.state == "dead"] == ["s2"]


@pytest.mark.parametrize(
    ("name", "settings", "law"),
    [
        ("convergence", {}, "search-and-track"),
        ("convergence", {"control.mode": "search-and-track"}, "lloyd"),
        ("convergence", {"control.mode": "random"}, None),
        ("efficacy", {"team.composition": "65A"}, None),
    ],
)
def test_a_demo_shows_search_and_track_beside_the_paper_unless_the_team_is_large(
    name: str, settings: dict[str, Any], law: str | None
) -> None:
    assert other_law(resolve(name, settings)) == law


def test_the_demo_of_real_bodies_has_one_arena_for_they_have_one_driver() -> None:
    platform = {"bodies.host": "own", "bodies.platform": "covey.examples.robots:DifferentialDrive"}
    assert other_law(resolve("convergence", platform)) is None


def test_the_demo_of_a_world_that_dies_has_one_arena() -> None:
    """A simulation has no process of the world that could be killed."""
    assert other_law(RunOptions(kill=["world@5"]).variant("quick")) is None
    assert other_law(RunOptions(kill=["s2@5"]).variant("quick")) == "search-and-track"


def test_the_law_beside_a_demo_outweighs_a_law_that_was_set_in_another_way() -> None:
    chosen = RunOptions(settings=["control.mode=search-and-track"])
    law = other_law(chosen.variant("quick"))
    assert law == "lloyd"
    assert chosen.variant("quick", {"control.mode": law}).control.mode == "lloyd"


def test_the_page_draws_the_tick_of_its_figures_where_ticks_are_long() -> None:
    """Ticks of 5 s: in the 12 s of a trail there are hardly three."""
    source = played(8, **{"run.dt": 5.0, "run.seconds": 100.0})
    assert len(source.picture.trail) == 9
    source.picture.show(2)
    assert source.picture.shown is not None and source.picture.shown.tick == 2


def test_a_scheduled_fault_that_finds_too_few_agents_is_noted_and_the_swarm_goes_on_with_the_next_of_the_tick() -> None:
    """Four of six are killed by hand before three are to die at mid-run, and one more."""
    scenario = with_deaths(resolve("quick", {"run.seconds": 10.0}))
    (deaths,) = scenario.faults
    swarm = SimulatedSwarm("power", msgspec.structs.replace(scenario, faults=(deaths, msgspec.structs.replace(deaths, who="s6"))))
    swarm.play(5)
    for name in ("s1", "s2", "s3", "s4"):
        swarm.strike("kill", name)
    swarm.play(30)
    assert swarm.tick == 30
    assert list(swarm.simulation.scorer.alive()) == ["s5"]
    assert "power: faults[0].who = '3': only 2 agents qualify" in [one.text for one in swarm.picture.happenings]
    assert [score.tick for score in swarm.scores] == list(range(len(swarm.scores)))
