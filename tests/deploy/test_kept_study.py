"""The study whose table is kept in docs/data: figure 4 is drawn from it, and docs/evidence/paper.md says what it says."""

import re
import statistics
from pathlib import Path

import pytest

from deploy.cli.figures import draw_study
from deploy.studies.paired import compare, groups_of
from deploy.studies.results import read_results
from deploy.studies.trials import Row

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "docs" / "data" / "efficacy-small.parquet"
PAPER = (ROOT / "docs" / "evidence" / "paper.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return list(read_results(KEPT))


def test_it_is_small_and_holds_every_combination_of_figure_4(rows: list[Row]) -> None:
    assert KEPT.stat().st_size < 100_000
    teams, targets, methods, seeds = ({row[name] for row in rows} for name in ("team", "start_targets", "method", "seed"))
    assert (teams, targets, methods) == ({"2", "3", "4", "5"}, {30, 40, 50}, {"power", "voronoi"})
    assert len(rows) == len(teams) * len(targets) * len(methods) * len(seeds) == 48


def test_figure_4_is_drawn_from_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert draw_study(KEPT, tmp_path) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"figure4.pdf", "figure4.png", "paired.pdf", "paired.png"}
    assert (tmp_path / "figure4.png").read_bytes().startswith(b"\x89PNG") and (tmp_path / "figure4.png").stat().st_size > 10_000


def test_the_page_says_what_the_table_says(rows: list[Row]) -> None:
    said = dict(re.findall(r"^\| medians with 30 targets, teams 2, 3, 4, 5: (\w+) \| (.*?) \|", PAPER, re.MULTILINE))
    assert set(said) == {"power", "Voronoi"}
    for method, numbers in (("power", said["power"]), ("voronoi", said["Voronoi"])):
        of_method = [row for row in rows if row["method"] == method and row["start_targets"] == 30]
        medians = [statistics.median([row["steady_ospa"] for row in of_method if row["team"] == team]) for team in ("2", "3", "4", "5")]
        assert ", ".join(f"{median:.2f}" for median in medians) == numbers
    pairs = [pair for group in groups_of(rows) if (pair := compare(rows, group, "power", "voronoi"))]
    won, played = sum(pair.wins for pair in pairs), sum(len(pair.differences) for pair in pairs)
    assert f"| pairs that the power diagram won | {won} of {played} |" in PAPER
