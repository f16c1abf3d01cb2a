"""The robustness study: which runs it plays, what it reads from their curves, and that it goes on where it was."""

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.cli import robustness as robustness_command
from deploy.plots.robustness_figure import mosaic
from deploy.scenario import resolve
from deploy.studies import robustness
from deploy.studies.robustness import FRESH, LEVELS, NONE, Bout, Curve, line, plan, play, recovery, summary, table
from protocol.settings import BadSetting

SMALL = {"team.composition": "A2,B4", "arena.width": 25.0, "arena.height": 25.0, "targets.count": 3, "run.dt": 0.5}


def bout(kind: str, level: float, seed: int = 3, at: float = 5.0, seconds: float = 50.0, options: dict[str, Any] = SMALL) -> Bout:
    return Bout(kind=kind, level=level, seed=seed, at=at, seconds=seconds, options=options)


def row(kind: str, level: float, ospa: list[float], seed: int = 1) -> dict[str, Any]:
    """A bout with a tick each second, the fault at 40 s."""
    times = [float(second) for second in range(len(ospa))]
    return {"kind": kind, "level": level, "seed": seed, "at": 40.0, "agents": 5, "hole": 0.0, "times": times, "ospa": ospa}


def test_all_kinds_and_levels_are_played_with_the_same_seeds_and_every_death_beside_a_fresh_team() -> None:
    bouts = plan(2, 7, 100.0, 200.0, {})
    assert len(bouts) == 2 * (1 + sum(map(len, LEVELS.values())) + len(LEVELS["kill"])) == len({bout.key() for bout in bouts})
    assert [bout.seed for bout in bouts] == sorted(bout.seed for bout in bouts) and {bout.seed for bout in bouts} == {7, 8}
    deaths = [{bout.level for bout in bouts if bout.kind == kind} for kind in ("kill", FRESH)]
    assert deaths[0] == deaths[1] == set(LEVELS["kill"])


@pytest.mark.parametrize(
    ("trials", "seconds", "options"),
    [(0, 200.0, {}), (1, 120.0, {}), (1, 200.0, {"team.composition": "A2,B3"}), (1, 200.0, {"targets.count": 0})],
)
def test_no_trials_or_targets_runs_that_end_too_early_and_teams_that_would_die_out_are_refused(
    trials: int, seconds: float, options: Any
) -> None:
    with pytest.raises(BadSetting):
        plan(trials, 1, 100.0, seconds, options)


def test_a_fresh_team_is_the_one_that_the_kill_leaves_alive() -> None:
    killed, fresh = play(bout("kill", 0.5)), bout(FRESH, 0.5)
    assert killed["agents"] == len(fresh.resolve().members) == 3
    assert fresh.resolve().faults == () and play(fresh)["agents"] == 3
    assert set(fresh.resolve().members.items()) < set(resolve("efficacy", SMALL).members.items())


@pytest.mark.slow
def test_the_bouts_of_a_seed_are_the_same_until_the_fault_strikes() -> None:
    calm, *others = [play(bout(*cell)) for cell in ((NONE, 0.0), ("kill", 0.5), ("loss", 0.5), ("delay", 2.0), ("partition", 12.0))]
    for other in others:
        assert other["ospa"][:10] == calm["ospa"][:10] and other["ospa"] != calm["ospa"]


def test_a_line_compares_with_the_same_seed_without_the_fault_and_after_deaths_with_the_fresh_team() -> None:
    disturbed = [2.0] * 40 + [5.0] * 10 + [3.0] * 50
    rows = [row(NONE, 0.0, [2.0] * 100), row("loss", 0.3, disturbed), row("kill", 0.3, disturbed), row(FRESH, 0.3, [3.0] * 100)]
    _, loss, killed = table(rows)
    assert (loss["before"], loss["first"], loss["settled"], loss["reference"], loss["ratio"]) == (2.0, 5.0, 3.0, 2.0, 1.5)
    assert (killed["reference"], killed["ratio"]) == (3.0, 1.0)
    assert [line(row("loss", 0.3, [ospa] * 100), 0.0)["ratio"] for ospa in (0.0, 2.0)] == [1.0, math.inf]


def test_a_seed_and_a_clock_among_the_settings_are_refused() -> None:
    with pytest.raises(BadSetting, match=r"^run\.seed = 3: the study itself sets it; should be given as seed$"):
        plan(1, 1, 100.0, 200.0, {"run.seed": 3})
    with pytest.raises(BadSetting, match=r"^run\.clock = 'lockstep': the study itself sets it; should be left out$"):
        plan(1, 1, 100.0, 200.0, {"run.clock": "lockstep"})


def test_a_line_counts_the_recovery_of_a_partition_from_its_heal_and_that_of_a_loss_from_the_fault() -> None:
    disturbed = [1.0] * 40 + [4.0] * 15 + [1.0] * 45
    assert line(row("partition", 12.0, disturbed), 1.0)["recovery_s"] == 3.0
    assert line(row("loss", 0.3, disturbed), 1.0)["recovery_s"] == 15.0


def test_recovery_is_the_first_time_from_which_five_seconds_are_good_in_the_mean() -> None:
    times = np.arange(100.0) - 40.0
    found = Curve(times, np.where(times < 0.0, 1.0, np.where(times < 12.0, 4.0, 1.0)))
    assert recovery(found, 0.0, 1.0) == 12.0
    assert recovery(found, 6.0, 1.0) == 6.0  # a partition that ends after 6 s
    assert recovery(Curve(times, np.full(100, 4.0)), 0.0, 1.0) is None


@pytest.mark.parametrize(
    ("ratios", "quartiles"),
    [([1.0, 2.0, 4.0], (1.5, 3.0)), ([1.0, 2.0, math.inf, math.inf], (1.75, math.inf)), ([1.0, 2.0, 3.0, 4.0, math.inf], (2.0, 4.0))],
)
def test_quartiles_of_ratios_of_which_some_are_infinite_are_numbers(ratios: list[float], quartiles: tuple[float, float]) -> None:
    """A seed without any error in its reference has an infinite ratio."""
    others = dict.fromkeys(("agents", "before", "first", "settled", "reference", "recovery_s", "largest_hole"), 1.0)
    [cell] = summary([{"kind": "kill", "level": 0.1, **others, "ratio": ratio} for ratio in ratios])
    assert (cell["ratio_low"], cell["ratio_high"]) == quartiles


def test_the_summary_takes_medians_and_quartiles_over_the_seeds() -> None:
    lines = [line(row("loss", 0.3, [float(seed)] * 100, seed=seed), 1.0) for seed in (1, 2, 3)]
    [loss] = summary(lines)
    assert (loss["ratio"], loss["ratio_low"], loss["ratio_high"], loss["seeds"]) == (2.0, 1.5, 2.5, 3)
    assert loss["recovery_s"] == float("inf")  # one of three recovers


@pytest.mark.slow
@pytest.mark.nightly
def test_a_study_that_was_stopped_goes_on_and_writes_tables_and_a_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(robustness, "LEVELS", {"kill": (0.5,), "loss": (0.5,), "delay": (), "partition": (3.0,)})
    monkeypatch.setattr(robustness_command, "QUICK", {"at": 5.0, "seconds": 46.0, "trials": 1})
    monkeypatch.setattr(robustness, "SETTLED", 20.0)
    assert robustness_command.run_robustness_study(True, None, 3, None, SMALL, tmp_path, 2, None, True) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (found["study"], found["bouts"]) == ("robustness", 5)
    assert [(cell["kind"], cell["level"]) for cell in found["cells"]] == [("none", 0.0), ("kill", 0.5), ("loss", 0.5), ("partition", 3.0)]
    first = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(first) == {"trials.jsonl", "lock", "curves.csv", "bouts.csv", "robustness.csv", "robustness.pdf", "robustness.png"}
    assert len(first["curves.csv"].splitlines()) == 1 + 5 * 92 and first["robustness.png"].startswith(b"\x89PNG")
    bouts = csv.DictReader((tmp_path / "bouts.csv").read_text().splitlines())
    assert [line["kind"] for line in bouts] == ["none", "kill", "loss", "partition"]

    kept = first["trials.jsonl"].splitlines(keepends=True)
    (tmp_path / "trials.jsonl").write_bytes(b"".join(kept[:3]) + kept[3][:100])  # as if killed in the middle of a line
    assert robustness_command.run_robustness_study(True, None, 3, None, SMALL, tmp_path, 1, None, False) == 0
    assert "3 of them done already" in capsys.readouterr().out
    again = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.name != "trials.jsonl"}
    assert again == {name: data for name, data in first.items() if name != "trials.jsonl"}


@pytest.mark.parametrize(("targets", "methods"), [("30,40", None), (None, "power")])
def test_what_the_study_does_not_know_is_refused(targets: str | None, methods: str | None) -> None:
    with pytest.raises(BadSetting):
        robustness_command.settings_of(None, targets, methods)


def test_faults_can_be_chosen_and_bring_their_references() -> None:
    assert robustness_command.kinds_of(None) == (NONE, *LEVELS, FRESH)
    assert robustness_command.kinds_of("kill") == (NONE, "kill", FRESH)
    assert robustness_command.kinds_of("loss, delay") == (
        NONE,
        "loss",
        "delay",
    )
    with pytest.raises(BadSetting, match="--faults flood: should be one or more of kill, loss, bursts, delay, throttle, partition"):
        robustness_command.kinds_of("flood")


def test_the_figure_has_panels_for_the_faults_that_were_played() -> None:
    assert mosaic(["kill"]) == [["deaths"] * 4 + ["kill"] * 2]
    assert mosaic(["loss", "partition"]) == [["loss"] * 3 + ["partition"] * 3]
    assert [len(places) for places in mosaic(list(LEVELS))] == [6, 6, 6]
