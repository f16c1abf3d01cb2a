"""The scorer, fed by hand: two agents halve a 10 x 10 m arena in which one target stands."""

import hashlib
from pathlib import Path

import msgspec
import numpy as np
import pytest

from deploy.cli.display import process_cells, swarm_line
from deploy.recording.recorder import Recorder, RecorderNode
from deploy.scenario import Scenario, agent_config, resolve
from deploy.scoring.scorer import MOST_GUESTS, Scorer, hole_and_overlap
from protocol.fields import pack
from protocol.geometry import polygon_area
from protocol.message import SharedSettings, Vector
from protocol.messages import Gossip, Hello
from protocol.node import Alive, Gone, Node, Received, Reopen, Started, Subscribe, received
from protocol.observer_messages import Estimate, Truth
from protocol.sensing import WedgeSensor
from protocol.settings import BadSetting
from tests.names import names_in

LEFT = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 10.0], [0.0, 10.0]])
RIGHT = np.add(LEFT, [5.0, 0.0])
WHOLE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
EMPTY = np.empty((0, 2))
TARGET = np.array([[2.0, 3.0]])


@pytest.fixture
def scenario(tmp_path: Path) -> Scenario:
    file = tmp_path / "halves.toml"
    file.write_text(
        '[run]\nseconds = 10.0\ndt = 1.0\nclock = "lockstep"\n[arena]\nwidth = 10.0\nheight = 10.0\n[members]\na = "A"\nb = "B"\n'
    )
    return resolve(str(file))


def longer(scenario: Scenario) -> Scenario:
    return msgspec.structs.replace(scenario, run=msgspec.structs.replace(scenario.run, seconds=40.0))


def truth(tick: int, alive: tuple[str, ...] = ("a", "b")) -> Received:
    return received(
        Truth(
            sender="world",
            incarnation=1,
            tick=tick,
            time=float(tick),
            targets_bytes=pack(TARGET, "<f8"),
            ids_bytes=pack(np.array([1]), "<u8"),
            bodies=("a", "b"),
            poses_bytes=pack(np.full((2, 3), float(tick)), "<f8"),
            in_view=1,
            alive=alive,
        ),
        payloads=[bytes(100)],
    )


def estimate(
    name: str, tick: int, cell: np.ndarray, targets: np.ndarray | None = None, mass: float = 0.5, velocity: Vector | None = None
) -> Received:
    targets = np.empty((0, 2)) if targets is None else targets
    details = b"" if velocity is None else pack(np.tile([*velocity, 1.0, 0.0, 1.0, 1.0], (targets.size // 2, 1)), "<f4")
    return received(
        Estimate(
            sender=name,
            incarnation=1,
            tick=tick,
            pose=(0.0, 0.0, 0.0),
            cod=(0.0, 0.0),
            power_radius=1.0,
            unused=1.0,
            mass=mass,
            cell_bytes=pack(cell, "<f8"),
            targets_bytes=pack(targets, "<f8"),
            details_bytes=details,
            counters={"rounds": tick + 1},
        ),
        payloads=[bytes(50)],
    )


def started(scenario: Scenario) -> Scorer:
    scorer = Scorer(scenario)
    effects = scorer.handle(Started(), 0.0)
    assert Subscribe(f"covey/{scorer.run}/truth") in effects
    scorer.handle(Alive("agent", "a", 1), 0.0)
    scorer.handle(Alive("agent", "b", 1), 0.0)
    return scorer


def test_a_tick_is_scored_when_all_have_spoken_in_whatever_order(scenario: Scenario) -> None:
    scorer = started(scenario)
    scorer.handle(estimate("b", 0, RIGHT), 1.0)
    scorer.handle(truth(0), 1.0)
    assert scorer.scores == []
    scorer.handle(estimate("a", 0, LEFT, np.add(TARGET, [3.0, 4.0])), 1.0)
    (score,) = scorer.scores
    assert (score.tick, score.ospa, score.gospa, score.in_view, score.estimated) == (0, 5.0, 5.0, 1, 1)
    assert (score.mass, score.hole, score.overlap) == pytest.approx((1.0, 0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("cell", [[[0.0, 0.0], [5.0, 10.0], [5.0, 0.0], [0.0, 10.0]], [[1.0, 1.0], [2.0, 2.0], [4.0, 4.0]]])
def test_a_cell_that_crosses_itself_or_has_no_area_ends_no_scorer(scenario: Scenario, cell: list[list[float]]) -> None:
    """Anybody may publish one; its agent dies at the end, so that others take over what it had."""
    scorer = started(scenario)
    for tick in range(6):
        scorer.handle(truth(tick, ("a", "b") if tick < 3 else ("b",)), float(tick))
        scorer.handle(estimate("b", tick, RIGHT), float(tick))
        if tick < 3:
            scorer.handle(estimate("a", tick, np.array(cell)), float(tick))
        else:
            scorer.handle(Gone("agent", "a", 1), float(tick))
    scorer.finish(6.0)
    assert len(scorer.scores) == 6 and all(score.hole <= 0.5 + 1e-9 for score in scorer.scores)


def test_words_about_ticks_after_the_end_of_the_run_count_for_nothing(scenario: Scenario) -> None:
    scorer = started(scenario)
    for tick in range(10):
        if tick == 4:
            scorer.handle(estimate("a", 10**6, LEFT), float(tick))
            scorer.handle(truth(10**6), float(tick))
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("a", tick, LEFT), float(tick))
        scorer.handle(estimate("b", tick, RIGHT), float(tick))
    assert [score.hole for score in scorer.scores] == [0.0] * 10


def test_the_transcript_hashes_poses_then_targets_in_the_order_of_the_team(scenario: Scenario) -> None:
    scorer = started(scenario)
    wanted = hashlib.blake2b(digest_size=16)
    for tick in (0, 1):
        scorer.handle(truth(tick), 1.0)
        scorer.handle(estimate("b", tick, RIGHT, TARGET + 1.0), 1.0)
        scorer.handle(estimate("a", tick, LEFT, TARGET), 1.0)
        for array in (np.full((2, 3), float(tick)), TARGET, TARGET + 1.0):
            wanted.update(pack(array, "<f8"))
    assert scorer.result(1.0).transcript == wanted.hexdigest()


def test_a_lost_agent_leaves_a_hole_that_closes_when_the_cells_of_the_rest_cover_the_arena(scenario: Scenario) -> None:
    scorer = started(scenario)
    for tick in (0, 1):
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("a", tick, LEFT, TARGET), float(tick))
        if tick == 0:
            scorer.handle(estimate("b", tick, RIGHT), float(tick))
    scorer.handle(Gone("agent", "b", 1), 1.25)
    assert scorer.scores[-1].hole == pytest.approx(0.5, abs=1e-12)
    scorer.handle(truth(2, ("a",)), 2.0)
    scorer.handle(estimate("a", 2, WHOLE, TARGET), 2.0)
    result = scorer.result(2.0)
    (kill,) = result.kills
    assert (kill.name, kill.tick, kill.time, kill.closed_seconds, kill.closed_ticks) == ("b", 1, 1.0, 0.75, 1)
    assert result.hole_area == pytest.approx(0.5, abs=1e-12)
    rows = {agent.name: agent for agent in scorer.status(2.0).agents}
    assert not rows["b"].alive and rows["b"].left_at == 1.0
    assert rows["a"].alive and rows["a"].cell == 1.0 and rows["a"].pose == (2.0, 2.0, 2.0)


def test_an_agent_whose_token_comes_back_in_the_same_process_has_not_died_and_one_in_a_new_process_has(scenario: Scenario) -> None:
    scorer = started(scenario)
    scorer.handle(truth(0), 0.0)
    for name, incarnation in (("a", 1), ("b", 2)):
        scorer.handle(Gone("agent", name, 1), 0.5)
        scorer.handle(Alive("agent", name, incarnation), 1.0)
    assert [kill.name for kill in scorer.result(1.0).kills] == ["b"]


def test_a_pause_that_outlives_the_lease_does_not_undo_an_earlier_death(scenario: Scenario) -> None:
    """b is killed at 1 s and restarted; then it is paused until its token is lost, and resumed."""
    scorer = started(scenario)
    scorer.handle(truth(1), 1.0)
    scorer.handle(Gone("agent", "b", 1), 1.5)
    scorer.handle(Alive("agent", "b", 2), 2.0)
    scorer.handle(truth(3), 3.0)
    scorer.note_fault("pause", "pause b", "b", 3.0)
    scorer.handle(Gone("agent", "b", 2), 4.0)
    scorer.note_fault("resume", "resume b", "b", 5.0)
    scorer.handle(truth(5), 5.0)
    scorer.handle(Alive("agent", "b", 2), 5.5)
    assert [(kill.name, kill.time) for kill in scorer.result(6.0).kills] == [("b", 1.0)]


def test_a_silent_agent_is_not_waited_for_without_end(scenario: Scenario) -> None:
    scorer = started(longer(scenario))
    for tick in range(25):
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("a", tick, LEFT), float(tick))
    assert [score.tick for score in scorer.scores] == [0, 1, 2]  # 20 ticks and 2 s later
    scorer.finish(25.0)
    assert len(scorer.scores) == 25
    assert all(score.hole == pytest.approx(0.5) for score in scorer.scores)


def test_after_the_finish_nobody_who_leaves_counts_as_lost(scenario: Scenario) -> None:
    scorer = started(scenario)
    scorer.handle(truth(0), 0.0)
    scorer.finish(1.0)
    scorer.handle(Gone("agent", "a", 1), 1.0)
    assert scorer.result(1.0).kills == ()


@pytest.mark.parametrize(("role", "name"), [("world", "world"), ("body", "b")])
def test_agents_that_leave_after_the_last_tick_and_the_world_are_dismissed_and_their_last_estimates_count(
    scenario: Scenario, role: str, name: str
) -> None:
    scorer = started(scenario)
    for tick in range(10):
        scorer.handle(truth(tick), float(tick))
        scorer.handle(estimate("b", tick, RIGHT), float(tick))
        if tick < 9:
            scorer.handle(estimate("a", tick, LEFT), float(tick))
        if tick == 8:
            scorer.handle(Gone(role, name, 1), 8.5)
            scorer.handle(Alive(role, name, 2), 8.5)
            assert not scorer.is_over  # it has died and come back
    scorer.handle(Gone(role, name, 2), 10.0)
    assert scorer.is_over
    scorer.handle(Gone("agent", "b", 1), 10.1)
    scorer.handle(estimate("a", 9, LEFT), 10.1)
    scorer.handle(Gone("agent", "a", 1), 10.2)
    scorer.finish(11.0)
    assert [score.hole for score in scorer.scores] == [0.0] * 10
    assert (scorer.result(11.0).kills, scorer.result(11.0).events, scorer.alive()) == ((), (), {"a": 1, "b": 1})


def test_an_agent_that_dies_in_the_last_tick_before_the_world_ends_has_died(scenario: Scenario) -> None:
    scorer = started(scenario)
    scorer.handle(truth(9), 9.0)
    scorer.handle(Gone("agent", "a", 1), 9.5)
    scorer.handle(Gone("world", "world", 1), 10.0)
    assert [kill.name for kill in scorer.result(10.0).kills] == ["a"]


def test_the_loss_of_an_old_incarnation_is_no_loss(scenario: Scenario) -> None:
    scorer = started(scenario)
    scorer.handle(truth(0), 0.0)
    scorer.handle(Alive("agent", "a", 2), 0.0)
    scorer.handle(Gone("agent", "a", 1), 0.0)
    assert scorer.alive() == {"a": 2, "b": 1}
    assert scorer.result(1.0).kills == ()


def test_an_agent_that_has_lost_its_body_skips_rounds_for_no_want_of_time(scenario: Scenario) -> None:
    scorer = started(scenario)
    for name in ("a", "of nobody"):
        scorer.handle(Gone("body", name, 1), 0.0)
    assert scorer.tick_rate._excused == {"a"}


@pytest.mark.parametrize("end", ["death", "pause"])
def test_a_world_that_stood_still_is_no_sign_of_a_machine_that_is_too_small(scenario: Scenario, end: str) -> None:
    run = msgspec.structs.replace(scenario.run, clock="realtime", rate=2.0, dt=0.5, seconds=100.0)
    scorer = started(msgspec.structs.replace(scenario, run=run))
    for tick in range(20):
        scorer.handle(truth(tick), 0.25 * tick)
    if end == "death":
        scorer.handle(Gone("world", "world", 1), 5.0)
    else:
        scorer.note_fault("pause", "pause world", "world")
        scorer.handle(truth(20), 5.0)  # which was on its way
        scorer.note_fault("resume", "resume world", "world")
    for tick in range(21, 30):
        scorer.handle(truth(tick), now := 60.0 + 0.25 * (tick - 21))
        found = scorer.tick_rate.at(now)
        assert (found.ticks_per_s, found.advice) == (None if tick == 21 else 4.0, "")


def test_when_the_younger_of_two_processes_of_a_name_ends_the_older_one_counts_again(scenario: Scenario) -> None:
    scorer = started(scenario)
    scorer.handle(truth(0), 0.0)
    scorer.handle(Alive("agent", "a", 2), 0.0)
    younger = msgspec.structs.replace(estimate("a", 0, LEFT).batch.messages[0], incarnation=2)
    scorer.handle(received(younger, payloads=[b""]), 0.0)
    scorer.handle(estimate("b", 0, RIGHT), 0.0)
    scorer.handle(Gone("agent", "a", 2), 0.5)
    scorer.handle(truth(1), 1.0)
    scorer.handle(estimate("a", 1, LEFT), 1.0)
    scorer.handle(estimate("b", 1, RIGHT), 1.0)
    assert scorer.alive() == {"a": 1, "b": 1}
    assert (scorer.result(1.0).kills, scorer.scores[-1].tick, scorer.scores[-1].hole) == ((), 1, 0.0)


def test_the_mass_residual_compares_what_an_agent_says_with_the_particles_it_publishes(scenario: Scenario) -> None:
    scorer = started(scenario)
    scorer.handle(estimate("a", 4, LEFT, mass=1.0), 0.0)
    gossip = Gossip(
        sender="a",
        incarnation=1,
        tick=5,
        pose=(0.0, 0.0, 0.0),
        cod=(0.0, 0.0),
        power_radius=1.0,
        unused=1.0,
        claim_tick=4,
        claim_names=("a",),
        claim_bytes=pack(np.zeros((1, 3)), "<f8"),
        weight=0.25,
        states_bytes=pack(np.zeros((3, 4)), "<f4"),
        ids_bytes=pack(np.arange(3), "<u8"),
    )
    scorer.handle(received(gossip, payloads=[bytes(10)]), 0.0)
    assert scorer.result(1.0).mass_residual == 0.25


def test_result_of_means_and_steady_part_is_what_a_pocket_calculator_says(scenario: Scenario) -> None:
    scorer = started(scenario)
    for tick in range(10):
        scorer.handle(truth(tick), 0.0)
        scorer.handle(estimate("a", tick, LEFT, np.add(TARGET, [float(tick), 0.0]), mass=0.75), 0.0)
        scorer.handle(estimate("b", tick, RIGHT), 0.0)
    result = scorer.result(3.0)
    assert (result.ticks, result.rounds, result.agents, result.wall_s) == (10, 20, 2, 3.0)
    assert (result.mean_ospa, result.steady_ospa, result.final_ospa) == (4.5, 5.5, 9.0)
    assert (result.cardinality_error, result.share_in_view, result.targets_in_view) == (0.25, 1.0, 1)
    assert (result.messages, result.bytes) == (30, 2000)


def test_a_sensor_that_fails_while_a_tick_is_scored_is_told_once_and_the_run_has_a_result(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    scorer, ended = started(longer(scenario)), list[bool]()
    scorer.on_finish = lambda: ended.append(True)
    scorer.handle(truth(0), 0.0)
    scorer.handle(estimate("a", 0, LEFT), 0.0)
    scorer.handle(estimate("b", 0, RIGHT), 0.0)

    def fails(self: WedgeSensor, points: np.ndarray, pose: object) -> np.ndarray:
        raise BadSetting("own:Sensor.probability raised ZeroDivisionError")

    monkeypatch.setattr(WedgeSensor, "probability", fails)
    for tick in range(1, 13):  # the coverage is read anew from tick 10 on
        scorer.handle(truth(tick), 0.0)
    with pytest.raises(BadSetting, match="ZeroDivisionError"):
        scorer.finish(1.0)
    scorer.finish(1.0, failed=True)
    assert ended == [True] and scorer.result(1.0).ticks == len(scorer.scores) == 10


def test_a_run_of_no_tick_has_a_result_too(scenario: Scenario) -> None:
    assert Scorer(scenario).result(0.0).ticks == 0


@pytest.mark.parametrize(
    ("cells", "hole", "overlap"),
    [([LEFT, RIGHT, EMPTY], 0.0, 0.0), ([], 1.0, 0.0), ([LEFT, np.add(LEFT, [2.0, 0.0])], 0.3, 0.3), ([LEFT, WHOLE], 0.0, 0.5)],
)
def test_hole_and_overlap_are_exact_areas_even_where_they_cancel_and_empty_cells_are_normal(
    cells: list[np.ndarray], hole: float, overlap: float
) -> None:
    assert hole_and_overlap(cells, 100.0) == pytest.approx((hole, overlap), abs=1e-12)


def test_two_cells_whose_common_border_differs_in_the_last_digit_do_not_swallow_each_other() -> None:
    """From tick 237 of `covey simulate convergence --dt 0.5`: without a grid the geometry engine returns a union without the first."""
    first = [[29.198632058918548, 21.242347443368615], [28.73734618139099, 21.225474460291274], [18.84009059777672, 10.324987771675342]]
    first += [[27.241295536131368, 6.961695247874254], [32.103700384724775, 15.08592850779863]]
    second = [[32.103700384724775, 15.08592850779863], [27.241295536131368, 6.961695247874252], [27.475365874616788, 5.860602448974385]]
    second += [[33.62261710078804, 0.0], [40.0, 0.0], [40.0, 12.166848100513812]]
    area = polygon_area(np.array(first)) + polygon_area(np.array(second))
    assert hole_and_overlap([np.array(first), np.array(second)], area) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_an_agent_of_other_settings_is_told_of_once_and_named_in_the_table_of_processes(scenario: Scenario) -> None:
    scorer, told = Scorer(scenario), list[tuple[str, tuple[str, ...]]]()
    scorer.on_differing = lambda name, fields: told.append((name, fields))
    right = agent_config(scenario).shared_settings()
    wrong: SharedSettings = {**right, "filter": {"gate": 1.5}, "arena": {"width": 2, "height": 3.5}}
    for settings in (wrong, wrong, {}):
        scorer.handle(received(Hello(sender="b", incarnation=1, settings=settings)), 0.0)
        scorer.handle(received(Hello(sender="a", incarnation=1, settings=right)), 0.0)
        if len(settings):
            assert [agent.differs for agent in scorer.status(2.0).agents] == [[], ["arena.height", "arena.width", "filter.gate"]]
    assert told == [("b", ("arena.height", "arena.width", "filter.gate"))]
    assert [agent.differs for agent in scorer.status(2.0).agents] == [[], []]
    row = {"name": "b", "class": "B", "state": "running", "pid": 7, "incarnation": 1, "differs": ["arena.width", "filter.gate"]}
    assert process_cells(row)[2] == "running, refused: other arena.width, filter.gate"


@pytest.mark.parametrize("kind", ["scorer", "recorder"])
def test_an_observer_with_half_a_session_opens_it_anew(kind: str, scenario: Scenario, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "some.mcap", scenario)
    node: Node = Scorer(scenario) if kind == "scorer" else RecorderNode(recorder, scenario, "recorder-1")
    node.handle(Alive("agent", "b", 1), 0.0)
    node.handle(Gone("agent", "b", 1), 0.0)
    effects = [node.handle(received(Hello(sender="b", incarnation=1)), now) for now in (1.0, 3.0, 5.0, 7.0)]
    assert effects == [[], [], [], [Reopen("b speaks, but its token has gone")]]
    recorder.close()


def test_of_made_up_names_a_fixed_number_is_a_row_of_the_tables(scenario: Scenario) -> None:
    scorer = Scorer(scenario)
    for event in (Started(), Alive("agent", "a", 1), truth(0)):
        scorer.handle(event, 0.0)
    for number in range(3 * MOST_GUESTS):
        name = f"x{number}"
        hello = received(Hello(sender=name, incarnation=1, settings={"arena": {"width": float(number)}}))
        for event in (Alive("agent", name, 1), Alive("body", name, 1), hello, estimate(name, 0, EMPTY), Gone("agent", name, 1)):
            scorer.handle(event, 0.0)
    kept = {f"x{number}" for number in range(MOST_GUESTS)}
    assert names_in(scorer, "deploy", "world") == kept
    assert {row.name for row in scorer.status(0.0).agents} == {"a", "b", *kept}
    for event in (Alive("agent", "b", 1), estimate("a", 0, LEFT), estimate("b", 0, RIGHT)):
        scorer.handle(event, 0.0)
    assert len(scorer.scores) == 1 and scorer.scores[0].hole == 0.0


def test_before_the_first_tick_a_swarm_says_what_it_waits_for_and_no_hole(scenario: Scenario) -> None:
    scorer = started(scenario)
    status = scorer.status(0.0)
    assert swarm_line(msgspec.to_builtins(status)) == "starting"
    assert swarm_line({**msgspec.to_builtins(status), "waiting": "there are 1 of 2 agents"}) == "starting: there are 1 of 2 agents"
    scorer.handle(truth(0), 0.0)
    for name, cell in (("a", LEFT), ("b", RIGHT)):
        scorer.handle(estimate(name, 0, cell), 0.0)
    assert swarm_line(msgspec.to_builtins(scorer.status(0.0))).startswith("t    0.00 s  OSPA")


COMPARED = [  # rows of the table that compare with true targets alone
    *("OSPA, mean / steady / final", "GOSPA, mean / steady / final", "  localisation + missed + false"),
    *("identity switches, IDF1 / HOTA / MOTA", "OSPA of tracks", "targets in view at the end"),
]


@pytest.mark.parametrize("count", [0, 3])
def test_without_true_targets_there_are_no_scores_and_one_line_says_why(count: int, scenario: Scenario) -> None:
    scorer = started(msgspec.structs.replace(scenario, targets=msgspec.structs.replace(scenario.targets, count=count)))
    scorer.handle(truth(0), 0.0)
    for name, cell in (("a", LEFT), ("b", RIGHT)):
        scorer.handle(estimate(name, 0, cell), 0.0)
    table = dict(scorer.result(1.0).rows())
    assert table.get("no scores") == (None if count else "targets.count = 0: no true targets are known")
    assert [what for what in table if table[what] == "-"] == ([] if count else COMPARED) + ["time to close the hole"]
    assert table["targets / reported / expected"].startswith("- /") == (not count)
    assert ("OSPA -  GOSPA -  in view - (targets.count = 0)" in swarm_line(msgspec.to_builtins(scorer.status(0.0)))) == (not count)
