"""Run directories: one supervisor per name, found by name or as the newest."""

import os
from pathlib import Path

import pytest

from deploy.scenario import Scenario, resolve
from deploy.storage.run_directory import RunDirectory, find_running, running_runs, runs_folder
from protocol.settings import BadSetting, load


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path / "runs"))


def test_a_claimed_run_is_running_until_the_lock_is_closed() -> None:
    directory = RunDirectory("one")
    assert not directory.is_running()
    lock = directory.claim()
    assert directory.is_running()
    os.close(lock)
    assert not directory.is_running()


def test_a_second_claim_is_refused_and_says_how_to_end_the_first() -> None:
    lock = RunDirectory("one").claim()
    with pytest.raises(BadSetting, match=r"--run one: .*covey down --run one"):
        RunDirectory("one").claim()
    os.close(lock)


def test_a_new_run_of_an_old_name_starts_with_empty_logs_and_no_result() -> None:
    directory = RunDirectory("one")
    os.close(directory.claim())
    directory.result.write_text("old")
    directory.log("s1").write_text("old")
    os.close(directory.claim())
    assert not directory.result.exists()
    assert list(directory.logs.iterdir()) == []


def test_the_newest_running_run_is_meant_when_no_name_is_given() -> None:
    with pytest.raises(BadSetting, match="no run is running in"):
        find_running(None)
    locks = []
    for age, name in ((30, "b"), (20, "c"), (10, "a")):
        locks.append(RunDirectory(name).claim())
        RunDirectory(name).config.write_text("")
        os.utime(RunDirectory(name).config, (1000 - age, 1000 - age))
    assert [directory.name for directory in running_runs()] == ["b", "c", "a"]
    assert find_running(None).name == "a"
    assert find_running("b").name == "b"
    with pytest.raises(BadSetting, match=r"--run d: no run of this name is running.*running are b, c, a"):
        find_running("d")
    for lock in locks:
        os.close(lock)


def test_the_resolved_scenario_reads_back_from_run_toml() -> None:
    directory = RunDirectory("one")
    lock = directory.claim()
    scenario = resolve("quick", {"run.seed": 5})
    directory.write_config(scenario)
    assert load(directory.config, Scenario) == scenario
    assert '"numpy"' in directory.versions.read_text()
    os.close(lock)


def test_a_folder_that_cannot_be_made_is_one_clear_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path / "file"))
    assert runs_folder() == tmp_path / "file"
    with pytest.raises(BadSetting, match="COVEY_RUNS"):
        RunDirectory("one").claim()
