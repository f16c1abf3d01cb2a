"""Studies: their plan, the folder that survives being killed, and tables that do not depend on how often it was."""

import json
from pathlib import Path

import pytest

from deploy.studies.design import STUDIES, Design, design, plan
from deploy.studies.results import StudyFolder, read_results
from deploy.studies.trials import Row, Trial, methods_of
from protocol.settings import LARGEST_SEED, BadSetting


def row(seed: int, method: str = "power", ospa: float = 1.0, **more: object) -> Row:
    """A row as a trial gives it, in short."""
    head = {"scenario": "efficacy", "seed": seed, "team": "2", "start_targets": 30, "method": method, "steady_ospa": ospa}
    return {**head, "steady_gospa": 9.0, "end_in_view": 0.9, **more, "wall_s": 3.5 * seed, "key": f"{method}-{seed}"}


def test_the_papers_studies() -> None:
    """IV-B: four teams, three numbers of targets, ten trials; IV-C: three teams, 30 targets."""
    assert (STUDIES["efficacy"].teams, STUDIES["efficacy"].targets, STUDIES["efficacy"].trials) == (("2", "3", "4", "5"), (30, 40, 50), 10)
    assert (len(plan(STUDIES["efficacy"])), len(plan(STUDIES["heterogeneity"])), len(plan(STUDIES["convergence"]))) == (360, 90, 40)


def test_a_plan_goes_seed_by_seed_and_pairs_the_methods() -> None:
    trials = plan(Design(scenario="efficacy", teams=("2", "3"), targets=(30,), methods=("power", "voronoi"), trials=2))
    assert [(trial.seed, trial.team, trial.method) for trial in trials] == [
        (seed, team, method) for seed in (100, 101) for team in ("2", "3") for method in ("power", "voronoi")
    ]


def test_a_quick_study_is_the_same_study_with_fewer_and_shorter_trials() -> None:
    quick, full = design("efficacy", quick=True), design("efficacy")
    assert (quick.teams, quick.targets, quick.methods) == (full.teams, full.targets, full.methods)
    assert quick.trials < full.trials


def test_what_cannot_be_run_is_refused_before_anything_runs() -> None:
    with pytest.raises(
        BadSetting, match="study 'eficacy' does not exist; known are convergence, efficacy, heterogeneity, ablation, robustness, bodies"
    ):
        design("eficacy")
    with pytest.raises(BadSetting, match=r"--methods lloyd: should be .* static, or a control law of your own as module:Class$"):
        plan(Design(scenario="efficacy", teams=("2",), targets=(30,), methods=("lloyd",)))
    with pytest.raises(BadSetting, match=r"team\.composition = '9'"):
        plan(Design(scenario="efficacy", teams=("9",), targets=(30,), methods=("power",)))
    with pytest.raises(BadSetting, match=r"run\.dt"):
        plan(Design(scenario="efficacy", teams=("2",), targets=(30,), methods=("power",), options={"run.dt": -1.0}))


def test_a_study_has_targets_and_all_its_seeds_are_those_of_runs() -> None:
    def planned(targets: tuple[int, ...], seed: int) -> list[Trial]:
        return plan(Design(scenario="quick", teams=("2A",), targets=targets, methods=("power",), trials=2, first_seed=seed))

    with pytest.raises(BadSetting, match=r"^targets\.count = 0: there are no scores without targets, .*; should be 1 or more$"):
        planned((3, 0), 1)
    assert planned((3,), LARGEST_SEED - 1)[-1].resolve().run.seed == LARGEST_SEED
    for seed in (-1, LARGEST_SEED):
        with pytest.raises(BadSetting, match=f"^--seed {seed}: should be a whole number from 0 to {LARGEST_SEED - 1}$"):
            planned((3,), seed)


@pytest.mark.parametrize(
    ("setting", "methods", "option"),
    [
        ("run.seed", ("power",), "seed"),
        ("team.composition", ("power",), "teams"),
        ("targets.count", ("power",), "targets"),
        ("partition.kind", ("power", "voronoi"), "methods"),
        ("control.mode", ("power",), "methods"),
        ("extraction.bin", ("power-extraction", "paper-extraction"), "methods"),
    ],
)
def test_a_setting_that_no_trial_would_have_is_refused_and_named_with_its_option(
    setting: str, methods: tuple[str, ...], option: str
) -> None:
    found = Design(scenario="quick", teams=("2A",), targets=(3,), methods=methods, options={setting: 7})
    with pytest.raises(BadSetting, match=rf"^{setting} = 7: the study itself sets it; should be given as {option}$"):
        plan(found)


def test_a_setting_that_some_method_leaves_free_is_that_of_its_trials() -> None:
    found = Design(scenario="quick", teams=("2A",), targets=(3,), methods=("power", "power-extraction"), options={"extraction.bin": 2.0})
    assert [trial.resolve().extraction.bin for trial in plan(found)][:2] == [2.0, 0.7]


def test_a_torn_line_is_cut_off_and_the_rest_counts(tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path / "study")
    with folder.claimed():
        folder.add(row(1))
        folder.add(row(2))
    with folder.trials.open("a") as file:
        file.write('{"seed": 3, "key": "power-')
    with folder.claimed():
        folder.add(row(4))
    assert sorted(folder.finished()) == ["power-1", "power-2", "power-4"]


def test_a_folder_is_held_by_one_study(tmp_path: Path) -> None:
    with StudyFolder(tmp_path).claimed(), pytest.raises(BadSetting, match="a study is running there"), StudyFolder(tmp_path).claimed():
        pass
    with StudyFolder(tmp_path).claimed():
        pass


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadSetting, match=r"--into .*file/study"), StudyFolder(tmp_path / "file" / "study").claimed():
        pass


def test_tables_do_not_tell_how_long_a_trial_took(tmp_path: Path) -> None:
    first, second = StudyFolder(tmp_path / "a"), StudyFolder(tmp_path / "b")
    for folder, slowness in ((first, 1.0), (second, 7.0)):
        with folder.claimed():
            folder.publish([{**row(1), "wall_s": slowness}, {**row(2), "wall_s": slowness}])
    assert first.csv.read_bytes() == second.csv.read_bytes()
    assert first.parquet.read_bytes() == second.parquet.read_bytes()


def test_results_are_read_back_from_either_file_or_the_folder(tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path)
    rows = [row(1, sensors="{}", control="lloyd"), row(2, "voronoi", 2.5, sensors="{}", control="lloyd")]
    folder.path.mkdir(exist_ok=True)
    folder.publish(rows)
    expected = [{name: value for name, value in one.items() if name not in ("wall_s", "key")} for one in rows]
    assert read_results(folder.parquet) == read_results(folder.csv) == read_results(tmp_path) == expected
    assert methods_of(expected) == ["power", "voronoi"] and methods_of(expected[::-1]) == ["voronoi", "power"]


def test_files_that_are_no_results_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match=r"^[^:]*: no results of a study: holds neither"):
        read_results(tmp_path)
    other = tmp_path / "other.csv"
    other.write_text("a,b\n1,2\n")
    with pytest.raises(BadSetting, match="the column method is missing"):
        read_results(other)
    bodies = StudyFolder(tmp_path / "bodies")
    bodies.path.mkdir()
    bodies.publish([{name: value for name, value in row(1, "points").items() if name != "scenario"}])
    for path in (bodies.path, bodies.csv, bodies.parquet):
        with pytest.raises(BadSetting, match="no results of a study of the paper or of the ablation: the column scenario is missing"):
            read_results(path)
    robustness = StudyFolder(tmp_path / "robustness")
    robustness.path.mkdir()
    robustness.add(row(1))
    (robustness.path / "robustness.csv").write_text("kind,level\n")
    with pytest.raises(BadSetting, match=r"a study of robustness has drawn its own figure, robustness\.pdf"):
        read_results(robustness.path)
    robustness.publish([row(1)])  # another study in the same folder
    assert [found["seed"] for found in read_results(robustness.path)] == [1]
    broken = tmp_path / "broken.parquet"
    broken.write_text(json.dumps({}))
    with pytest.raises(BadSetting, match=r"broken\.parquet: no results of a study"):
        read_results(broken)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("9.0,0.9\r\n", "9\r\n", "line 2 has 7 cells; should have 8, as the first"),
        ("1.0,9.0", "oops,9.0", "line 2: steady_ospa = 'oops': should be a number"),
        ("2.5,9.0", "2.5,", "line 3: steady_gospa = '': should be a number"),
    ],
)
def test_a_table_that_is_cut_or_spoilt_names_the_line(old: str, new: str, complaint: str, tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path)
    folder.publish([row(1), row(2, "voronoi", 2.5)])
    folder.csv.write_bytes(folder.csv.read_bytes().replace(old.encode(), new.encode(), 1))
    with pytest.raises(BadSetting, match=rf"results\.csv: no results of a study: {complaint}$"):
        read_results(folder.csv)


def test_a_table_without_a_row_and_a_study_that_has_not_finished_are_told_as_such(tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path)
    folder.add(row(1))
    with pytest.raises(BadSetting, match=f"^{tmp_path}: the study has not finished"):
        read_results(tmp_path)
    folder.csv.write_text("method,team,seed,start_targets,steady_ospa\n")
    with pytest.raises(BadSetting, match=r"results\.csv: no results of a study: it holds no row$"):
        read_results(tmp_path)


@pytest.mark.parametrize("line", ["garbage}", '{"a": 1}', "[]"])
def test_a_kept_line_that_is_no_row_is_named(line: str, tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path)
    folder.add(row(1))
    with folder.trials.open("a") as file:
        file.write(line + "\n")
    with folder.claimed(), pytest.raises(BadSetting, match=r"trials\.jsonl, line 2: is no row of a study"):
        folder.finished()
