"""The picture and its frames, held against a simulation whose numbers are at hand, and against hand-made events."""

import struct
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from agents.membership.peer_table import MOST_STRANGERS
from deploy.page.frames import belief, beside, curves, density_grid, frame, greeting, moment
from deploy.page.picture import OTHER, Picture, silent_after
from deploy.scenario import FaultSettings, Scenario, resolve
from deploy.scoring.scores import Score
from deploy.simulation import Simulation
from protocol.fields import pack
from protocol.message import Message
from protocol.messages import Gossip, Hello
from protocol.node import Alive, Gone, Rejected, received
from protocol.observer_messages import Estimate, Truth


def scenario(**more: object) -> Scenario:
    return resolve("quick", {"run.seconds": 6.0, "run.clock": "lockstep", **more})


def truth(tick: int, alive: tuple[str, ...] = ("s1",), targets: list[list[float]] | None = None) -> Truth:
    return Truth(
        sender="world",
        incarnation=1,
        tick=tick,
        time=0.25 * tick,
        bodies=("s1", "s2"),
        poses_bytes=pack(np.array([[1.0, 2.0, 0.5], [3.0, 4.0, 0.0]]), "<f8"),
        targets_bytes=pack(np.array(targets or []).reshape(-1, 2), "<f8"),
        ids_bytes=pack(np.arange(len(targets or [])), "<u8"),
        alive=alive,
    )


def gossip(tick: int, incarnation: int = 1, places: list[list[float]] | None = None, weight: float = 0.0) -> Gossip:
    states = np.array([[*place, 0.0, 0.0] for place in places or []]).reshape(-1, 4)
    return Gossip(
        sender="s1",
        incarnation=incarnation,
        tick=tick,
        pose=(1.0, 2.0, 0.5),
        cod=(1.5, 2.5),
        power_radius=1.0,
        unused=3.0,
        claim_tick=max(0, tick - 1),
        claim_names=("s1",) if places else (),
        claim_bytes=pack(np.array([[1.5, 2.5, 1.0]]), "<f8") if places else b"",
        weight=weight,
        states_bytes=pack(states, "<f4"),
        ids_bytes=pack(np.arange(len(states)) + 1, "<u8"),
    )


def shown(*events: object) -> Picture:
    picture = Picture(scenario())
    for event in events:
        picture.see(received(event) if isinstance(event, Message) else event, 0.0)  # type: ignore[arg-type]
    return picture


def kinds(picture: Picture) -> list[tuple[str, str]]:
    return [(one.kind, one.who) for one in picture.happenings]


def test_a_frame_tells_of_all_agents_of_a_large_team_that_die_at_once() -> None:
    picture = Picture(scenario(**{"team.composition": "100A"}))
    names = list(picture.agents)
    picture.see(received(truth(8)), 0.0)
    for name in names:
        picture.see(Alive("agent", name, 1), 0.0)
    for name in names:
        picture.see(Gone("agent", name, 1), 0.0)
    assert [who for _, _, kind, who, _ in moment(picture, None)["happenings"] if kind == "lost"] == names


def test_an_agent_that_is_lost_and_comes_back_stands_on_the_time_line_with_the_worlds_time() -> None:
    picture = shown(Alive("agent", "s1", 1), truth(8), Gone("agent", "s1", 1), truth(9), Alive("agent", "s1", 2))
    assert [(one.kind, one.who, one.time) for one in picture.happenings] == [("lost", "s1", 2.0), ("back", "s1", 2.25)]
    assert picture.agents["s1"].state == "alive"


@pytest.mark.parametrize(("told", "drawn"), [(9, [8, 9]), (10, [8, 9, 10])])
def test_one_that_dies_is_drawn_as_alive_up_to_the_last_tick_of_which_it_has_told(told: int, drawn: list[int]) -> None:
    estimate = Estimate(sender="s1", incarnation=1, tick=told, pose=(1.0, 2.0, 0.5), cod=(1.5, 2.5), power_radius=1.0, unused=3.0)
    picture = shown(Alive("agent", "s1", 1), *map(truth, range(8, 11)), estimate, Gone("agent", "s1", 1), truth(11), truth(12))
    seen = []
    for tick in range(8, 13):
        picture.show(tick)
        seen += [tick] if picture.is_alive(picture.agents["s1"]) else []
    assert seen == drawn
    picture.forget()  # a replay jumps to where it was dead before
    picture.see(received(truth(6)), 0.0)
    picture.show(6)
    assert not picture.is_alive(picture.agents["s1"])


@pytest.mark.parametrize("role", ["world", "body"])
def test_agents_that_leave_after_the_last_tick_and_the_world_stay_as_they_were(role: str) -> None:
    last = scenario().run.ticks - 1
    picture = shown(Alive("agent", "s1", 1), truth(last), Gone(role, "s1", 1), Gone("agent", "s1", 1))
    assert picture.agents["s1"].state == "alive"
    assert ("lost", "s1") not in kinds(picture)
    picture.forget()  # a replay goes back
    for event in (Alive("agent", "s1", 1), received(truth(8)), Gone("agent", "s1", 1)):
        picture.see(event, 0.0)
    assert picture.agents["s1"].state == "dead"


def test_a_token_of_an_old_incarnation_that_goes_changes_nothing() -> None:
    picture = shown(Alive("agent", "s1", 1), truth(8), Gone("agent", "s1", 1), Alive("agent", "s1", 2), Gone("agent", "s1", 1))
    assert picture.agents["s1"].alive
    assert kinds(picture) == [("lost", "s1"), ("back", "s1")]


def test_when_the_younger_of_two_processes_of_a_name_ends_the_older_one_is_drawn_again() -> None:
    tokens = Alive("agent", "s1", 1), Alive("agent", "s1", 2)
    picture = shown(*tokens, truth(8), gossip(8, 2), Gone("agent", "s1", 2), gossip(9, 1))
    known = picture.agents["s1"]
    assert known.alive and known.gossip is not None and known.gossip.incarnation == 1
    assert ("lost", "s1") not in kinds(picture)
    picture.see(Gone("agent", "s1", 1), 0.0)
    assert not known.alive


def test_an_agent_is_silent_when_its_peers_would_give_it_up_and_heard_again_with_its_next_word() -> None:
    patience = silent_after(scenario())
    assert patience == 4
    picture = shown(Alive("agent", "s1", 1), truth(10), gossip(10), *(truth(tick) for tick in range(11, 15)))
    assert picture.agents["s1"].state == "alive"
    picture.see(received(truth(15)), 0.0)
    assert picture.agents["s1"].state == "silent"
    picture.see(received(gossip(10)), 0.0)  # an old word
    assert picture.agents["s1"].state == "silent"
    picture.see(received(gossip(15)), 0.0)
    assert picture.agents["s1"].state == "alive"
    assert kinds(picture) == [("silent", "s1"), ("heard", "s1")]


def test_a_watcher_that_hears_the_words_of_all_too_late_takes_nobody_for_silent() -> None:
    both = (Alive("agent", "s1", 1), Alive("agent", "s2", 1))
    words = [msgspec.structs.replace(gossip(10), sender=name) for name in ("s1", "s2")]
    picture = shown(*both, truth(10), *words, *(truth(tick) for tick in range(11, 20)))
    assert [known.state for known in picture.agents.values()][:2] == ["alive", "alive"]
    picture.see(received(gossip(19)), 0.0)
    picture.see(received(truth(20)), 0.0)
    assert kinds(picture) == [("silent", "s2")]


def test_in_real_time_a_second_of_silence_is_allowed_at_any_rate() -> None:
    assert silent_after(scenario(**{"run.clock": "realtime", "run.dt": 0.25, "run.rate": 3.0})) == 12
    assert silent_after(scenario(**{"run.clock": "realtime", "run.dt": 0.5})) == 4
    assert silent_after(scenario(**{"run.clock": "realtime", "run.dt": 0.5, "timing.silence": 3.0})) == 6


def test_at_a_slower_pace_an_agent_is_silent_after_as_many_rounds() -> None:
    said = received(
        Estimate(sender="s2", incarnation=1, tick=8, pose=(1.0, 2.0, 0.5), cod=(1.5, 2.5), power_radius=1.0, unused=3.0, pace=8)
    )
    others = (Alive("agent", "s1", 1), Alive("agent", "s2", 1), said)
    picture = shown(*others, truth(8), gossip(8), msgspec.structs.replace(gossip(8), sender="s2"))
    for tick, state in ((40, "alive"), (41, "silent")):
        for event in (truth(tick), msgspec.structs.replace(gossip(tick), sender="s2")):
            picture.see(received(event), 0.0)
        picture.see(received(truth(tick + 1)), 0.0)
        assert picture.agents["s1"].state == state, tick
    picture.see(Gone("agent", "s2", 1), 0.0)
    assert silent_after(picture.scenario) == 4 and picture.agents["s1"].state == "silent", "the slow one has gone, and its pace with it"


def test_who_is_paused_is_paused_and_not_only_silent() -> None:
    picture = shown(Alive("agent", "s1", 1), truth(10))
    picture.pause(frozenset({"s1"}))
    picture.pause(frozenset())
    assert kinds(picture) == [("paused", "s1"), ("heard", "s1")]


def test_the_start_of_a_run_fills_no_time_line_but_a_late_guest_does() -> None:
    assert kinds(shown(Alive("agent", "s1", 1), Alive("agent", "s2", 1), truth(0))) == []
    assert kinds(shown(truth(20), Alive("agent", "guest", 1))) == [("joined", "guest")]


def test_a_guest_is_drawn_with_the_sensor_that_it_announces() -> None:
    picture = shown(Alive("agent", "guest", 1))
    before = picture.roster_version
    picture.see(received(Hello(sender="guest", incarnation=1, sensor_class="A")), 0.0)
    assert picture.agents["guest"].sensor is not None
    assert picture.roster_version > before


def test_rejected_messages_are_counted_by_known_sender_and_reason() -> None:
    picture = shown(Rejected("s1", "format"), Rejected("s1", "format"), *[Rejected(f"n{number}", "key") for number in range(9)])
    assert picture.rejected == {("s1", "format"): 2, ("(other)", "key"): 9}
    assert picture.agents["s1"].rejected == 2


def test_of_made_up_names_a_fixed_number_is_drawn_and_nobody_of_the_roster_or_with_a_token_is_forgotten() -> None:
    picture = shown(Alive("agent", "guest", 1), msgspec.structs.replace(gossip(1), sender="guest"))
    roster = {*picture.agents}
    for number in range(2 * MOST_STRANGERS):
        name = f"x{number}"
        picture.see(received(msgspec.structs.replace(gossip(1), sender=name)), 0.0)
        picture.see(Rejected(name, "range"), 0.0)
    picture.see(Alive("agent", "late", 1), 0.0)
    picture.see(Gone("agent", "late", 1), 0.0)
    assert len(picture.agents) == len(roster) + MOST_STRANGERS
    assert roster | {"late", f"x{2 * MOST_STRANGERS - 1}"} <= picture.agents.keys() and "x0" not in picture.agents
    assert picture.rejected[OTHER, "range"] == MOST_STRANGERS + 1 and picture.rejected.total() == 2 * MOST_STRANGERS


def test_the_density_of_a_cluster_keeps_its_mass() -> None:
    picture = shown(Alive("agent", "s1", 1), truth(10), gossip(10, places=[[10.0, 10.0]] * 20, weight=0.0002))
    grid, (columns, rows), square = density_grid(picture)
    mass = -np.log1p(-grid.astype(float) / 255.0) * 0.25 * square**2
    assert (columns, rows) == (128, 128)
    assert square == pytest.approx(25.0 / 128)
    row, column = np.unravel_index(int(np.argmax(grid)), grid.shape)
    assert (row, column) == (int(10.0 / square), int(10.0 / square))
    assert mass.sum() == pytest.approx(0.004, rel=0.03)  # within the steps of a byte


def test_particles_of_the_dead_are_not_drawn() -> None:
    picture = shown(Alive("agent", "s1", 1), truth(10), gossip(10, places=[[10.0, 10.0]], weight=1.0), Gone("agent", "s1", 1))
    assert len(picture.particles()) == 0
    assert not density_grid(picture)[0].any()


def played(of: Scenario, until: Callable[[Picture], bool]) -> tuple[Simulation, Picture]:
    """A simulation and its picture, stopped as soon as `until` holds."""
    simulation = Simulation(of)
    picture = Picture(simulation.scenario)
    simulation.scorer.on_event = picture.see
    while not until(picture) and simulation.bus.step():
        pass
    return simulation, picture


def test_a_frame_shows_one_tick_whose_cells_tile_the_arena_and_whose_numbers_are_those_of_the_score() -> None:
    simulation, picture = played(scenario(), lambda picture: picture.truth is not None and picture.truth.tick == 20)
    score = simulation.scorer.scores[-2]
    data = moment(picture, score)
    cells = [np.array(agent["cell"]).reshape(-1, 2) for agent in data["agents"]]
    areas = [0.5 * abs(np.sum(c[:, 0] * np.roll(c[:, 1], -1) - np.roll(c[:, 0], -1) * c[:, 1])) for c in cells]
    assert data["tick"] == score.tick
    assert sum(areas) == pytest.approx(25.0 * 25.0, abs=0.5)
    assert sum(len(agent["targets"]) // 2 for agent in data["agents"]) == score.estimated
    assert len(data["targets"]) // 2 == score.targets
    assert data["score"][1] == pytest.approx(score.ospa, abs=1e-4)
    assert sum(agent["mass"] for agent in data["agents"]) == pytest.approx(score.mass, abs=0.01)
    assert picture.particles()[:, 2].sum() == pytest.approx(score.mass, abs=1e-4)


def test_a_frame_is_a_length_a_json_text_and_the_grid() -> None:
    simulation, picture = played(scenario(), lambda picture: picture.truth is not None and picture.truth.tick == 8)
    data = frame(picture, simulation.scorer.scores[-1], {"play": {"playing": True}})
    length = struct.unpack_from("<I", data)[0]
    text = msgspec.json.decode(data[4 : 4 + length])
    assert text["play"] == {"playing": True}
    assert len(data) == 4 + length + text["grid"][0] * text["grid"][1]


def test_a_killed_agent_loses_its_cell_and_its_neighbours_take_it_over_in_the_picture() -> None:
    with_kill = msgspec.structs.replace(scenario(), faults=(FaultSettings(at=3.0, verb="kill", who="s2"),))
    simulation, picture = played(with_kill, lambda picture: picture.truth is not None and picture.truth.tick == 20)
    data = moment(picture, simulation.scorer.scores[-2])
    dead = next(agent for agent in data["agents"] if agent["name"] == "s2")
    assert (dead["state"], dead["cell"]) == ("dead", [])
    assert ("lost", "s2") in kinds(picture)
    assert simulation.scorer.scores[-2].hole == 0.0


def test_a_greeting_holds_the_curves_thinned_out_and_footprints_at_the_origin() -> None:
    simulation, picture = played(scenario(), lambda picture: picture.truth is not None and picture.truth.tick == 20)
    data = msgspec.json.decode(greeting(picture, simulation.scorer.scores * 200, {"source": "live"}))
    assert len(data["curves"]["ospa"]) <= 1200
    assert [agent["name"] for agent in data["agents"]] == ["s1", "s2", "s3", "s4", "s5", "s6"]
    outline = np.array(data["agents"][0]["outline"]).reshape(-1, 2)
    assert np.hypot(outline[:, 0], outline[:, 1]).max() == pytest.approx(8.0, abs=0.01)
    assert len(data["trails"]["bodies"]["s1"]) == 3 * 21


def test_the_curve_of_a_second_swarm_stands_at_the_ticks_of_the_first() -> None:
    one, other = ([score(tick, ospa) for tick in range(number)] for number, ospa in ((2401, 1.0), (2400, 2.0)))
    found = beside(one, other)
    assert len(found) == len(curves(one)["time"]) == 801
    assert found[:800] == [2.0] * 800 and found[800] is None
    assert beside(other, [each for each in one if each.tick % 4]) == [None if tick % 4 == 0 else 1.0 for tick in range(0, 2400, 2)]


def test_a_thinned_curve_keeps_the_hole_of_one_tick() -> None:
    found = curves([score(tick, 1.0, hole=0.1 if tick in (1001, 1702) else 0.0) for tick in range(2401)])
    assert len(found["time"]) == 801
    assert [time for time, hole in zip(found["time"], found["hole"]) if hole] == [1001 * 0.25, 1702 * 0.25]


def score(tick: int, ospa: float, hole: float = 0.0) -> Score:
    return Score(tick, 0.25 * tick, ospa, 0.0, 1, 1, 1, 1.0, hole, 0.0)


def test_what_an_agent_believes_can_be_asked_for_and_nobody_else_is_known() -> None:
    _, picture = played(scenario(), lambda picture: picture.truth is not None and picture.truth.tick == 20)
    found = belief(picture, "s1")
    assert found is not None
    assert found["claim"][0]["name"] == "s1"
    assert len(found["neighbours"]) >= 1
    assert set(found["neighbours"]) <= set(picture.agents) - {"s1"}
    assert found["agree"][0] == found["agree"][1] > 0
    assert belief(picture, "nobody") is None


def test_a_picture_that_has_heard_nothing_can_be_drawn() -> None:
    picture = Picture(scenario())
    assert moment(picture, None)["tick"] == -1
    assert len(frame(picture, None, {})) > 128 * 128
    assert msgspec.json.decode(greeting(picture, [], {}))["curves"]["time"] == []
    assert {agent["state"] for agent in moment(picture, None)["agents"]} == {"waiting"}
