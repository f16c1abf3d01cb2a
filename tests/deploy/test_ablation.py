"""The ablation: the parts of the OSPA, the gain on paired seeds, and its table and figure."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from deploy.scenario import resolve
from deploy.scoring.error_parts import ErrorParts, Parts
from deploy.studies.ablation import gains, lines
from deploy.studies.design import design, plan
from protocol.fields import pack
from protocol.observer_messages import Truth
from world.score import gospa, ospa


def truth(tick: int, *targets: tuple[float, float]) -> Truth:
    """One body of class A (240 degrees, 8 m) at (20, 20) that faces east, and targets 1, 2, ..."""
    return Truth(
        sender="world",
        incarnation=1,
        tick=tick,
        time=0.25 * tick,
        targets_bytes=pack(np.array(targets), "<f8"),
        ids_bytes=pack(np.arange(1, len(targets) + 1), "<u8"),
        bodies=("s1",),
        poses_bytes=pack(np.array([[20.0, 20.0, 0.0]]), "<f8"),
        alive=("s1",),
    )


def test_the_parts_of_the_ospa_add_up_and_tell_why_a_target_is_missed() -> None:
    """Target 1 in view has an estimate 1 m away; target 2 is unseen; then target 1 is out of view, and estimates are too many."""
    parts = ErrorParts(resolve("convergence", {"team.composition": "A1"}))
    first, second = ((25.0, 20.0), (5.0, 5.0)), ((35.0, 20.0), (25.0, 21.0))
    one, three = np.array([[25.0, 21.0]]), np.array([[25.0, 21.0], [1.0, 1.0], [38.0, 20.0]])
    parts.see(truth(0, *first), one)
    parts.see(truth(1, *second), three)
    assert parts.parts[0] == pytest.approx((10.0 / 2, 0.0, 1.0 / 2, 0.0))
    assert parts.parts[1] == pytest.approx((0.0, 3.0 / 3, 0.0, 10.0 / 3))
    assert [sum(found) for found in parts.parts] == pytest.approx([ospa(np.array(first), one), ospa(np.array(second), three)])
    assert parts.gospa_parts[0] == pytest.approx((5.0, 0.0, 1.0, 0.0))
    assert parts.gospa_parts[1] == pytest.approx((0.0, 3.0, 0.0, 5.0))
    totals = [gospa(np.array(first), one).total, gospa(np.array(second), three).total]
    assert [sum(found) for found in parts.gospa_parts] == pytest.approx(totals)
    assert parts.mean() == pytest.approx(Parts(2.5, 0.5, 0.25, 10.0 / 6))


def test_the_parts_are_capped_at_the_cut_off_of_the_study() -> None:
    parts = ErrorParts(resolve("convergence", {"team.composition": "A1", "study.cutoff": 4.0}))
    parts.see(truth(0, (25.0, 20.0), (5.0, 5.0)), np.array([[25.0, 21.0]]))
    assert parts.parts[0] == pytest.approx((4.0 / 2, 0.0, 1.0 / 2, 0.0))
    assert parts.gospa_parts[0] == pytest.approx((2.0, 0.0, 1.0, 0.0))


def test_the_gain_is_that_of_the_means_and_equal_pairs_leave_no_doubt() -> None:
    assert gains(np.array([[1.0, 2.0], [3.0, 4.0]]))[0] == pytest.approx(1.0 - 2.0 / 3.0)
    assert gains(np.array([[1.0, 2.0]] * 3)) == pytest.approx((0.5, 0.5, 0.5))
    gain, low, high = gains(np.array([[1.0, 2.0], [3.0, 4.0], [2.0, 5.0], [2.0, 4.0]]))
    assert low < gain < high
    assert gains(np.array([[1.0, 0.0], [1.0, 4.0]])) == pytest.approx((0.5, 0.5, 0.75)), "draws without an error of the base do not count"


def test_every_team_is_compared_on_the_same_seeds_and_the_closed_arena_is_its_own_scenario() -> None:
    trials = plan(design("ablation"))
    assert {trial.seed for trial in trials} == set(range(400, 410))
    assert {(trial.scenario, trial.targets) for trial in trials if trial.team == "1"} == {("convergence", 8)}
    assert {(trial.scenario, trial.targets) for trial in trials if trial.team != "1"} == {("efficacy", 30)}


def test_with_several_numbers_of_targets_the_closed_arena_is_played_once_with_its_own() -> None:
    trials = plan(msgspec.structs.replace(design("ablation", quick=True), targets=(20, 30), methods=("power",), trials=1))
    assert [(trial.team, trial.targets) for trial in trials] == [("20E+4H", 20), ("1", 8), ("20E+4H", 30)]


def test_table_and_figure_hold_every_method(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from deploy.plots.ablation_figure import write

    rows = [
        {"team": team, "start_targets": 30, "method": method, "seed": seed, "mean_ospa": value + seed, "mean_gospa": 9.0}
        | {"ospa_never_seen": value, "ospa_lost": float(seed), "ospa_in_view": 0.0, "ospa_false": 0.0}
        | {"gospa_never_seen": 5.0, "gospa_lost": 2.0, "gospa_in_view": 1.5, "gospa_false": 0.5}
        for team in ("20E+4H", "20E+20F")
        for method, value in (("power", 3.0), ("search-and-track", 1.0))
        for seed in (1, 2)
    ]
    found = lines(rows)
    assert [line.gain for line in found] == [None, pytest.approx(2.0 / 4.5)] * 2
    paths = write(found, tmp_path)
    assert [path.name for path in paths] == ["ablation.csv", "ablation.pdf", "ablation.png"]
    assert paths[0].read_text().splitlines()[1].startswith("20E+4H,30,power,2,4.5,9.0,3.0,1.5,0.0,0.0,5.0,2.0,1.5,0.5,,,")
