"""The chronicle: what came of an event, from cells before and after; squares of 10 m, by hand."""

import msgspec
import numpy as np

from deploy.scenario import FaultSettings, resolve
from deploy.scoring.chronicle import Chronicle, ScoredTick, names_of, shares
from deploy.scoring.deaths import Deaths
from deploy.scoring.result import EventReport
from deploy.simulation import Simulation


def box(west: float, south: float, east: float, north: float) -> np.ndarray:
    return np.array([[west, south], [east, south], [east, north], [west, north]])


def view(
    tick: int,
    cells: dict[str, np.ndarray],
    *,
    hole: float = 0.0,
    overlap: float = 0.0,
    targets: tuple[tuple[float, float], ...] = (),
    estimates: tuple[tuple[float, float], ...] = (),
    cutoff: float = 10.0,
) -> ScoredTick:
    """Four ticks a second; targets are numbered from 1 on."""
    places, told = (np.array(points, dtype=float).reshape(-1, 2) for points in (targets, estimates))
    return ScoredTick(tick, 0.25 * tick, cells, np.arange(1, len(places) + 1), places, told, hole, overlap, cutoff)


BEFORE = {"s1": box(0, 0, 10, 10), "s2": box(10, 0, 20, 10), "s3": box(20, 0, 30, 10)}
AFTER = {"s1": box(0, 0, 16, 10), "s3": box(16, 0, 30, 10)}
IN_S2, IN_S1 = ((12.0, 5.0), (18.0, 5.0)), (5.0, 5.0)


def play(chronicle: Chronicle, views: list[ScoredTick]) -> list[EventReport]:
    return [told for one in views for told in chronicle.see(one)]


def test_a_death_says_who_took_how_much_and_when_and_that_no_target_was_lost() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE, targets=IN_S2, estimates=IN_S2))
    chronicle.lose("s2", "died", 100, 25.0)
    almost = {"s1": box(0, 0, 15.8, 10), "s3": box(16, 0, 30, 10)}  # 2 % of the cell is left
    opened = [view(100, AFTER), view(101, almost, hole=0.1, targets=IN_S2), view(102, AFTER, targets=IN_S2)]
    assert play(chronicle, opened) == []
    told = play(chronicle, [view(tick, AFTER, targets=IN_S2, estimates=IN_S2) for tick in range(103, 120)])
    assert told == [EventReport(27.5, "s2", "s2 died at 25.0 s: s1 (60 %) and s3 (40 %) took its cell within 2 ticks; no target lost")]


def test_a_target_is_tracked_within_three_tenths_of_the_cut_off() -> None:
    beside = [(x, y + 2.5) for x, y in IN_S2]
    assert view(1, BEFORE, targets=IN_S2, estimates=tuple(beside)).tracked() == {1, 2}
    assert view(1, BEFORE, targets=IN_S2, estimates=tuple(beside), cutoff=8.0).tracked() == set()


def test_a_target_that_is_tracked_no_more_when_the_cells_have_settled_is_lost_and_one_elsewhere_is_not_counted() -> None:
    chronicle = Chronicle()
    targets = (*IN_S2, IN_S1)
    chronicle.see(view(99, BEFORE, targets=targets, estimates=targets))
    chronicle.lose("s2", "died", 100, 25.0)
    early = [view(tick, AFTER, targets=targets, estimates=targets) for tick in range(101, 105)]  # what a copy still says is no proof
    late = [view(tick, AFTER, targets=targets, estimates=((12.5, 5.0),)) for tick in range(105, 112)]
    assert [told.text for told in play(chronicle, early + late)] == [
        "s2 died at 25.0 s: s1 (60 %) and s3 (40 %) took its cell within 1 tick; 1 of 2 targets in it lost"
    ]


def test_a_target_that_has_left_the_arena_and_one_that_was_not_tracked_are_not_lost() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE, targets=(*IN_S2, (15.0, 1.0)), estimates=IN_S2))
    chronicle.lose("s2", "died", 100, 25.0)
    told = play(chronicle, [view(tick, AFTER, targets=IN_S2[:1], estimates=IN_S2[:1]) for tick in range(101, 112)])
    assert told[0].text.endswith("no target lost")


def test_a_cell_that_nobody_takes_and_an_agent_without_a_cell_are_told_as_such() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE))
    chronicle.lose("s2", "died", 100, 25.0)
    chronicle.lose("s9", "died", 100, 25.0)
    told = play(chronicle, [view(tick, {"s1": BEFORE["s1"]}, hole=0.3) for tick in range(101, 165)])
    assert [one.text for one in told] == ["s9 died at 25.0 s; it owned no cell", "s2 died at 25.0 s: its cell is still open"]
    chronicle.lose("s7", "died", 165, 41.25)
    assert [one.text for one in play(chronicle, [view(tick, AFTER) for tick in range(166, 176)])] == ["s7 died at 41.2 s; it owned no cell"]


def test_holes_elsewhere_and_a_sliver_in_the_cell_do_not_keep_it_open() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE))
    chronicle.lose("s2", "died", 100, 25.0)
    slivers = {"s1": box(0, 0, 15.95, 10), "s3": box(16, 0, 25, 10)}
    told = play(chronicle, [view(tick, slivers, hole=0.2) for tick in range(101, 112)])
    assert [one.text for one in told] == ["s2 died at 25.0 s: s1 (60 %) and s3 (40 %) took its cell within 1 tick; no target lost"]


def test_what_is_open_at_the_end_of_the_run_is_told_then() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE))
    chronicle.lose("s2", "died", 100, 25.0)
    chronicle.see(view(101, AFTER))
    chronicle.lose("s1", "is paused", 101, 25.25)
    texts = [one.text for one in chronicle.finish()]
    assert texts[0] == "s2 died at 25.0 s: s1 (60 %) and s3 (40 %) took its cell within 1 tick; no target lost"
    assert texts[1] == "s1 is paused at 25.2 s: its cell was open when the run ended"
    assert chronicle.finish() == []


def test_a_paused_agent_is_told_when_others_have_its_cell_and_one_that_goes_on_before_is_not() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE))
    chronicle.lose("s2", "is paused", 100, 25.0)
    told = play(chronicle, [view(tick, BEFORE) for tick in range(101, 105)])  # its last claim still counts
    told += play(chronicle, [view(tick, AFTER) for tick in range(105, 116)])
    assert [one.text for one in told] == ["s2 is paused at 25.0 s: s1 (60 %) and s3 (40 %) took its cell within 5 ticks; no target lost"]
    chronicle.see(view(116, BEFORE))
    chronicle.lose("s2", "is paused", 116, 29.0)
    chronicle.see(view(117, BEFORE))
    chronicle.resume("s2")
    assert play(chronicle, [view(tick, BEFORE) for tick in range(118, 190)]) == []


def test_a_return_is_told_when_the_agent_owns_a_cell_and_overtakes_what_was_open_about_it() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE))
    chronicle.lose("s2", "died", 100, 25.0)
    chronicle.see(view(101, AFTER))
    chronicle.regain("s2", 102)
    told = play(chronicle, [view(102, BEFORE), view(103, AFTER), view(104, {**AFTER, "s2": np.empty((0, 2))}), view(105, BEFORE)])
    assert told == [EventReport(26.25, "s2", "s2 is back: it owns a cell again after 3 ticks")]


def test_a_death_whose_agent_is_back_before_others_took_its_cell_is_told_as_such() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE))
    chronicle.lose("s2", "died", 100, 25.0)
    chronicle.lose("s9", "died", 100, 25.0)
    opened = {name: BEFORE[name] for name in ("s1", "s3")}
    told = play(chronicle, [view(101, opened, hole=0.3)])
    chronicle.regain("s2", 102)
    told += play(chronicle, [view(102, {**opened, "s2": np.empty((0, 2))}, hole=0.3), *[view(tick, BEFORE) for tick in range(103, 190)]])
    assert [one.text for one in told] == [
        "s2 died at 25.0 s: it was back before others took its cell",
        "s2 is back: it owns a cell again after 1 tick",
        "s9 died at 25.0 s; it owned no cell",
    ]


def closed_ticks(*views: ScoredTick) -> int | None:
    """In how many ticks others took the cell of s2, which died at tick 100, by what was scored then."""
    deaths = Deaths()
    deaths.lose("s2", 100, 25.0, 0.0, BEFORE["s2"])
    for one in views:
        deaths.see(one, 0.25 * (one.tick - 100))
    return deaths.kills()[0].closed_ticks


def test_a_hole_is_closed_by_others_and_not_by_the_agent_that_is_back() -> None:
    opened = {name: BEFORE[name] for name in ("s1", "s3")}
    cellless = {**AFTER, "s2": np.empty((0, 2))}
    assert closed_ticks(view(101, opened, hole=0.3), view(102, AFTER), view(103, BEFORE)) == 2
    assert closed_ticks(view(101, opened, hole=0.3), view(102, cellless), view(103, BEFORE)) == 2
    assert closed_ticks(view(101, opened, hole=0.3), view(102, BEFORE), view(103, BEFORE)) is None
    assert closed_ticks(view(101, opened, hole=0.3), view(102, BEFORE), view(200, AFTER)) is None, "the agent was back before it died again"


def test_an_agent_that_is_back_in_the_same_process_was_silent_and_has_not_died() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE))
    chronicle.lose("s2", "died", 100, 25.0)
    told = play(chronicle, [view(101, AFTER)])
    chronicle.regain("s2", 102, same=True)
    told += play(chronicle, [view(tick, BEFORE) for tick in range(102, 112)])
    assert [one.text for one in told] == [
        "s2 is back: it owns a cell again after 1 tick",
        "s2 was silent at 25.0 s: s1 (60 %) and s3 (40 %) took its cell within 1 tick; no target lost",
    ]


def test_a_cut_is_told_when_both_sides_cover_the_arena_and_a_healing_when_the_cells_tile_it() -> None:
    chronicle = Chronicle()
    chronicle.cut("partition", 100, 2)
    told = play(chronicle, [view(tick, BEFORE, overlap=min(1.0, 0.25 * (tick - 100))) for tick in range(101, 110)])
    assert [one.text for one in told] == ["the cut: each side covers the whole arena by itself after 4 ticks"]
    chronicle.cut("heal", 110, 1)
    told = play(chronicle, [view(111, BEFORE, overlap=0.5), view(112, BEFORE, hole=0.1), view(113, BEFORE), view(114, BEFORE)])
    assert [one.text for one in told] == ["the healing: the cells tile the arena again after 3 ticks"]


def test_a_second_cut_is_told_when_all_three_sides_cover_the_arena() -> None:
    chronicle = Chronicle()
    chronicle.cut("partition", 100, 2)
    assert len(play(chronicle, [view(101, BEFORE, overlap=1.0)])) == 1
    chronicle.cut("partition", 110, 3)
    told = play(chronicle, [view(110 + tick, BEFORE, overlap=1.0 + 0.25 * tick) for tick in range(1, 8)])
    assert [one.text for one in told] == ["the cut: each side covers the whole arena by itself after 4 ticks"]
    chronicle.cut("heal", 120, 2)
    told = play(chronicle, [view(121, BEFORE, overlap=2.0), view(122, BEFORE, overlap=1.5), view(123, BEFORE, overlap=1.0)])
    assert [one.text for one in told] == ["the cut: each side covers the whole arena by itself after 3 ticks"]


def test_a_cut_that_leaves_all_agents_connected_is_not_told_and_its_healing_is() -> None:
    chronicle = Chronicle()
    chronicle.cut("partition", 100, 1)
    assert play(chronicle, [view(101, BEFORE), view(102, BEFORE, overlap=0.5), view(103, BEFORE, overlap=1.0)]) == []
    chronicle.cut("heal", 110, 1)
    assert len(play(chronicle, [view(111, BEFORE, overlap=0.5), view(112, BEFORE)])) == 1


def test_a_silence_in_which_nobody_took_the_cell_is_no_open_cell() -> None:
    chronicle = Chronicle()
    chronicle.see(view(99, BEFORE))
    chronicle.lose("s2", "died", 100, 25.0)
    chronicle.regain("s2", 100, same=True)
    told = play(chronicle, [view(tick, BEFORE) for tick in range(101, 190)])
    assert [one.text for one in told] == ["s2 is back: it owns a cell again after 1 tick"]


def test_shares_are_of_the_former_cell_and_many_heirs_are_counted() -> None:
    assert shares(box(0, 0, 10, 10), {"a": box(5, 0, 50, 50), "b": box(0, 0, 5, 9), "c": box(0, 9, 0.4, 10), "d": np.empty((0, 2))}) == [
        ("a", 0.5),
        ("b", 0.45),
    ]
    assert names_of([("a", 0.5), ("b", 0.25)]) == "a (50 %) and b (25 %)"
    assert names_of([(name, 0.15) for name in "abcdef"]) == "a (15 %), b (15 %), c (15 %), d (15 %) and 2 more"
    assert names_of([]) == ""


def test_the_same_cut_twice_has_two_sides_and_a_second_one_after_a_part_was_healed_has_two_again() -> None:
    faults = (
        FaultSettings(at=5.0, verb="partition", who="s1,s2"),
        FaultSettings(at=10.0, verb="partition", who="s1,s2"),
        FaultSettings(at=15.0, verb="partition", who="s4"),
        FaultSettings(at=20.0, verb="heal", who="s4", options={"only_cut": True}),
        FaultSettings(at=25.0, verb="heal"),
    )
    simulation = Simulation(msgspec.structs.replace(resolve("quick", {"run.seconds": 30.0, "targets.count": 2}), faults=faults))
    told = simulation.run().events
    assert [fault.sides for fault in simulation.scorer.faults] == [2, 2, 3, 1, 1]
    assert [one.time // 5.0 * 5.0 for one in told] == [5.0, 10.0, 15.0, 25.0]


def test_the_result_of_a_run_tells_every_death_and_return_and_a_paused_agent_is_not_counted_dead() -> None:
    faults = (
        FaultSettings(at=10.0, verb="kill", who="s2"),
        FaultSettings(at=12.0, verb="pause", who="s5", seconds=6.0),
        FaultSettings(at=20.0, verb="restart", who="s2"),
    )
    scenario = resolve("quick", {"run.seconds": 30.0, "targets.count": 6})
    result = Simulation(msgspec.structs.replace(scenario, faults=faults)).run()
    texts = [told.text for told in result.events]
    assert any(text.startswith("s2 died at ") and "took its cell within" in text for text in texts)
    assert any(text.startswith("s5 is paused at 1") for text in texts)
    assert [text for text in texts if "is back" in text][-1].startswith("s2 is back: it owns a cell again after")
    assert [kill.name for kill in result.kills] == ["s2"]
