"""Figures of a study: which files come, what stands in them, and that they tell data from data."""

from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from deploy.cli.figures import draw_study, is_study
from deploy.plots.study_figures import boxes, differences, draw, level_of
from deploy.studies.results import StudyFolder
from deploy.studies.trials import Row
from protocol.settings import BadSetting


def rows(
    scenario: str = "efficacy", teams: tuple[str, ...] = ("2", "3"), targets: tuple[int, ...] = (30, 40), worse: float = 0.5
) -> list[Row]:
    """Three seeds of the power diagram, and Voronoi cells that are `worse` m worse."""
    return [
        {"scenario": scenario, "team": team, "triple": "ACD", "agents": 8 * int(team[0]) + 8, "start_targets": count, "seed": seed}
        | {"method": method, "steady_ospa": 1.0 + 0.1 * seed + shift, "steady_gospa": 10.0, "end_in_view": 0.9, "control": "lloyd"}
        for team in teams
        for count in targets
        for seed in range(3)
        for method, shift in (("power", 0.0), ("voronoi", worse), ("voronoi-cod", 2 * worse))
    ]


@pytest.fixture(autouse=True)
def closed() -> None:
    """No figure of another test stays open."""
    plt.close("all")


@pytest.mark.slow
def test_efficacy_makes_figure_4_and_the_paired_differences(tmp_path: Path) -> None:
    files = draw(rows(), tmp_path)
    assert sorted(file.name for file in files) == ["figure4.pdf", "figure4.png", "paired.pdf", "paired.png"]
    assert all(file.read_bytes()[:4] in (b"%PDF", b"\x89PNG") for file in files)
    assert plt.get_fignums() == []


@pytest.mark.slow
def test_the_same_data_make_the_same_files_and_other_data_others(tmp_path: Path) -> None:
    first, again, other = (draw(rows(worse=worse), tmp_path / name) for name, worse in (("a", 0.5), ("b", 0.5), ("c", 0.6)))
    assert [file.read_bytes() for file in first] == [file.read_bytes() for file in again]
    assert all(ours.read_bytes() != theirs.read_bytes() for ours, theirs in zip(first, other))


def test_a_panel_for_each_number_of_targets_and_a_group_for_each_team() -> None:
    figure = boxes(rows(), ["voronoi", "power"])
    assert [panel.get_title() for panel in figure.axes] == ["30 targets", "40 targets"]
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["24", "32"]
    medians = [line for line in figure.axes[0].lines if line.get_linewidth() == 1.4]
    assert [line.get_ydata()[0] for line in medians] == pytest.approx([1.6, 1.6, 1.1, 1.1])  # type: ignore[index]


OWN = {"power": "my:One", "voronoi": "my:Two", "voronoi-cod": "paper-extraction"}


def test_laws_of_the_users_own_have_names_and_colours_of_their_own() -> None:
    study = [{**row, "method": OWN[row["method"]]} for row in rows(targets=(30,))]
    legend = boxes(study, list(OWN.values())).legends[0]
    assert [text.get_text() for text in legend.get_texts()] == list(OWN.values())
    assert len({patch.get_edgecolor() for patch in legend.get_patches()}) == 3
    assert [panel.get_title() for panel in differences(study, ["my:Two"], "my:One").axes] == ["my:Two minus my:One"]


@pytest.mark.slow
def test_without_the_power_diagram_the_first_method_is_compared_with_the_others(tmp_path: Path) -> None:
    files = draw([{**row, "method": OWN[row["method"]]} for row in rows(targets=(30,))], tmp_path)
    assert sorted(file.name for file in files) == ["figure4.pdf", "figure4.png", "paired.pdf", "paired.png"]


def test_differences_seed_by_seed_with_their_tests() -> None:
    figure = differences(rows(targets=(30,)), ["voronoi", "voronoi-cod"])
    points = [line.get_xdata() for line in figure.axes[1].lines if line.get_marker() == "o"]
    assert [list(data) for data in points] == [pytest.approx([1.0, 1.0, 1.0])] * 2  # type: ignore[arg-type]
    assert [text.get_text() for text in figure.axes[0].texts] == ["3/3, p = 0.250"] * 2
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["24 sensors", "32 sensors"]


@pytest.mark.slow
def test_heterogeneity_makes_figure_5_with_levels(tmp_path: Path) -> None:
    study = rows("heterogeneity", ("20E+20F", "20E+4H"), (30,))
    assert {file.name for file in draw(study, tmp_path)} >= {"figure5.pdf", "figure5.png"}
    labels = [label.get_text() for label in boxes(study, ["power"]).axes[0].get_xticklabels()]
    assert labels == ["20E+20F\n2.31 m", "20E+4H\n4.77 m"]
    assert level_of("X3", "ACD") is None


def test_one_method_alone_has_nothing_to_be_paired_with(tmp_path: Path) -> None:
    alone = [row for row in rows("convergence", ("1",), (8,)) if row["method"] == "power"]
    assert [file.name for file in draw(alone, tmp_path)] == ["errors.pdf", "errors.png"]


@pytest.mark.slow
def test_figures_go_into_the_folder_of_the_study_or_where_one_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = StudyFolder(tmp_path / "study")
    with folder.claimed():
        folder.publish(rows())
    assert is_study(folder.path) and is_study(folder.csv) and not is_study(tmp_path)
    assert draw_study(folder.path, None) == 0
    assert (folder.path / "figure4.png").exists() and "figure4.pdf" in capsys.readouterr().out
    assert draw_study(folder.parquet, tmp_path / "else") == 0
    assert (tmp_path / "else" / "paired.pdf").exists()


def test_a_folder_without_results_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match=r"results\.parquet"):
        draw_study(tmp_path, None)
