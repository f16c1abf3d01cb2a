"""Run directories: one supervisor per name, found by name or as the newest."""

import errno
import os
import socket
import tempfile
from pathlib import Path

import pytest

from deploy.scenario import Scenario, resolve
from deploy.storage import run_directory
from deploy.storage.kept_runs import kept_runs, new_run_directory
from deploy.storage.run_directory import RunDirectory, find_running, running_runs, runs_folder
from protocol.settings import BadSetting, load


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path / "runs"))


def held(name: str) -> int:
    """The lock of a run that is running from now on."""
    return new_run_directory(name, "quick")[1]


def test_a_run_is_running_until_its_lock_is_closed() -> None:
    directory = RunDirectory("one")
    assert not directory.is_running()
    lock = held("one")
    assert directory.is_running()
    os.close(lock)
    assert not directory.is_running()


def test_where_files_cannot_be_locked_no_run_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(run_directory.fcntl, "flock", refuse)
    with pytest.raises(
        BadSetting, match=r"run directory .*one: files cannot be locked: No locks available; COVEY_RUNS names another place"
    ):
        held("one")
    assert not RunDirectory("one").is_running()


def test_the_control_socket_of_a_long_name_fits_into_a_temporary_folder_and_one_too_deep_is_refused_with_what_fits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with tempfile.TemporaryDirectory(dir="/tmp") as short:

        def path_below(length: int) -> Path:
            folder = Path(short) / ("t" * (length - len(short) - 1))
            folder.mkdir()
            monkeypatch.setattr(tempfile, "tempdir", str(folder))
            return RunDirectory("n" * 64).socket_path()

        with pytest.raises(BadSetting, match=r"TMPDIR = .*tt: is \d+ bytes too long for a socket in it; should have at most") as error:
            path_below(100)
        most = int(str(error.value).rpartition(" ")[2])
        assert most >= 60
        with socket.socket(socket.AF_UNIX) as longest:
            longest.bind(str(path_below(most)))


def test_a_second_run_of_a_name_is_refused_and_says_how_to_end_the_first() -> None:
    lock = held("one")
    with pytest.raises(BadSetting, match=r"--run one: .*covey down --run one"):
        held("one")
    os.close(lock)


def test_what_a_start_that_failed_has_left_is_removed_by_the_next_one() -> None:
    directory = RunDirectory("one")
    os.close(held("one"))
    directory.log("s1").write_text("old")
    directory.page.write_text("http://127.0.0.1:8765/")
    os.close(held("one"))
    assert list(directory.logs.iterdir()) == []
    assert not directory.page.exists()


def test_the_newest_running_run_is_meant_when_no_name_is_given() -> None:
    with pytest.raises(BadSetting, match="no run is running in"):
        find_running(None)
    locks = []
    for age, name in ((30, "b"), (20, "c"), (10, "a")):
        locks.append(held(name))
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
    lock = held("one")
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
        held("one")


def test_runs_that_are_removed_while_they_are_listed_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    locks = [held(name) for name in ("a", "b")]
    for name in ("a", "b"):
        RunDirectory(name).config.write_text("")

    def gone(directory: RunDirectory) -> bool:
        if directory.name == "b":
            directory.config.unlink(missing_ok=True)
        return False

    monkeypatch.setattr(RunDirectory, "is_simulated", gone)
    assert [directory.name for directory in running_runs()] == ["b", "a"]
    RunDirectory("b").config.write_text("")
    monkeypatch.setattr(RunDirectory, "is_running", gone)
    assert [kept.name for kept in kept_runs()] == ["a"]
    for lock in locks:
        os.close(lock)


def test_whether_the_run_of_another_user_is_running_can_be_seen_without_writing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user of the same folder was told that nothing runs there, and could remove what was running."""
    umask, opened = os.umask(0o022), os.open

    def read(path: Path, flags: int) -> int:
        assert flags == os.O_RDONLY
        return opened(path, flags)

    lock = held("one")
    os.umask(umask)
    assert RunDirectory("one").lock.stat().st_mode & 0o777 == 0o644
    with monkeypatch.context() as other:
        other.setattr(os, "open", read)
        assert RunDirectory("one").is_running()
    os.close(lock)
