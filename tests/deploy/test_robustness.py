"""The robustness study: which runs it plays, and what it reads from their curves."""

import csv
from pathlib import Path

import numpy as np
import pytest

from deploy.studies.robustness import LEVELS, Bout, Played, fault_of, plan, play, recovery, row_of, summary, table, write
from protocol.settings import BadSetting

SMALL = {"team.composition": "A2,B3", "arena.width": 25.0, "arena.height": 25.0, "targets.count": 3, "run.dt": 0.5}


def played(kind: str, level: float, ospa: list[float], fresh: float | None = None, seed: int = 1) -> Played:
    """A bout with a tick each second, the fault at 40 s."""
    return Played(Bout(kind, level, seed, 40.0, 100.0), [float(second) for second in range(len(ospa))], ospa, fresh, 0.0, 5)


def test_all_kinds_and_levels_are_played_with_the_same_seeds() -> None:
    bouts = plan(2, 7, 100.0, 200.0, list(LEVELS), {})
    assert len(bouts) == 2 * (1 + sum(map(len, LEVELS.values())))
    assert {bout.seed for bout in bouts} == {7, 8} and bouts[0].kind == "none"
    assert fault_of(Bout("kill", 0.3, 1, 50.0, 100.0))[0].who == "30%" and fault_of(bouts[0]) == ()


@pytest.mark.parametrize(("kinds", "seconds"), [(["flood"], 200.0), (["kill"], 120.0)])
def test_unknown_faults_and_runs_that_end_too_early_are_refused(kinds: list[str], seconds: float) -> None:
    with pytest.raises(BadSetting):
        plan(1, 1, 100.0, seconds, kinds, {})


def test_a_row_compares_with_the_same_seed_without_the_fault_and_after_deaths_with_the_fresh_team() -> None:
    calm = played("none", 0.0, [2.0] * 100)
    loss = row_of(played("loss", 0.3, [2.0] * 40 + [5.0] * 10 + [3.0] * 50), calm)
    assert (loss["before"], loss["first"], loss["settled"], loss["reference"], loss["ratio"]) == (2.0, 5.0, 3.0, 2.0, 1.5)
    killed = row_of(played("kill", 0.3, [2.0] * 40 + [5.0] * 10 + [3.0] * 50, fresh=3.0), calm)
    assert (killed["reference"], killed["ratio"]) == (3.0, 1.0)


def test_recovery_is_the_first_time_from_which_five_seconds_are_good_in_the_mean() -> None:
    times, bout = np.arange(100.0), Bout("kill", 0.3, 1, 40.0, 100.0)
    ospa = np.where(times < 40.0, 1.0, np.where(times < 52.0, 4.0, 1.0))
    assert recovery(times, ospa, bout, 1.0) == 12.0
    assert recovery(times, ospa, Bout("partition", 6.0, 1, 40.0, 100.0), 1.0) == 6.0  # counted from its end at 46 s
    assert recovery(times, np.full(100, 4.0), bout, 1.0) is None


def test_the_summary_takes_medians_over_the_seeds() -> None:
    cells = [played("none", 0.0, [1.0] * 100, seed=seed) for seed in (1, 2, 3)]
    cells += [played("loss", 0.3, [float(seed)] * 100, seed=seed) for seed in (1, 2, 3)]
    [calm, loss] = summary(table(cells))
    assert (calm["ratio"], loss["ratio"], loss["seeds"], loss["recovery_s"]) == (1.0, 2.0, 3, float("inf"))


def test_a_small_study_gives_curves_a_table_and_a_figure(tmp_path: Path) -> None:
    fixed = tuple(SMALL.items())
    bouts = [Bout(kind, level, 3, 5.0, 50.0, fixed) for kind, level in [("none", 0.0), ("kill", 0.5), ("partition", 3.0)]]
    found = [play(bout) for bout in bouts]
    assert found[1].survivors == 2 and found[1].fresh is not None and found[2].survivors == 5
    paths = write(found, tmp_path)
    assert [path.name for path in paths] == ["curves.csv", "robustness.csv", "robustness.pdf", "robustness.png"]
    rows = list(csv.DictReader((tmp_path / "robustness.csv").open()))
    assert [(row["kind"], row["level"]) for row in rows] == [("none", "0.0"), ("kill", "0.5"), ("partition", "3.0")]
    assert len((tmp_path / "curves.csv").read_text().splitlines()) == 1 + 3 * 100
    assert all(path.stat().st_size > 1000 for path in (paths[0], *paths[2:]))
