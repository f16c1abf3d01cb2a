"""Outputs that fail in the middle of a run: the run goes on to its end and keeps its result."""

import errno
import functools
import io
import json
import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from rich.console import Console

from deploy.cli.display import Display, show_result
from deploy.cli.errors import guarded
from deploy.cli.simulate import ProgressLine, simulate_here
from deploy.scenario import resolve
from deploy.scoring.result import Result
from deploy.simulation import Simulation
from deploy.storage.kept_runs import kept_runs
from tests.deploy.test_machine_refusals import ROOT, namespaced, program, started
from tests.deploy.wrong_inputs import folder

__all__ = ["folder"]  # a fixture
SHORT = ("up", "quick", "--lockstep", "--team", "A3", "--seconds", "3", "--run", "hunt")
SLOW = ("up", "quick", "--team", "A3", "--rate", "1", "--seconds", "8", "--run", "hunt")
LONG = ("up", "quick", "--team", "A3", "--rate", "4", "--seconds", "400", "--run", "hunt")


class Full(io.StringIO):
    """A file on a full disk."""

    def write(self, text: str) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """A function after which standard output has no room."""
    return lambda: monkeypatch.setattr("sys.stdout", Full())


@functools.cache
def short_result() -> Result:
    return Simulation(resolve("quick", {"run.seconds": 0.5})).run()


def test_an_output_that_is_full_after_the_first_line_is_given_up(full: Any, capsys: pytest.CaptureFixture[str]) -> None:
    display = Display()
    display.event("first")
    full()
    display.event("second")
    display.event("third")
    display.close()
    complaint = "covey: standard output: No space left on device; the run goes on without its lines\n"
    assert capsys.readouterr() == ("first\n", complaint)


def test_an_output_that_is_full_at_the_first_line_ends_the_command(full: Any) -> None:
    full()
    with pytest.raises(OSError, match="No space left"):
        Display().event("first")


@pytest.mark.parametrize("as_json", [False, True])
def test_a_result_that_has_no_room_is_one_line_and_1(
    as_json: bool, full: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deploy.cli.display.lead_nowhere", lambda number=1: None)
    full()
    assert show_result(short_result(), None, as_json) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "covey: standard output: No space left on device"


def test_a_full_standard_error_does_not_cost_the_line_of_json(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", Full())
    assert show_result(short_result(), None, True) == 0
    assert json.loads(capsys.readouterr().out)["agents"] == 6


def test_a_refusal_of_the_machine_without_a_file_is_no_error_of_coveys(capsys: pytest.CaptureFixture[str]) -> None:
    def refused() -> int:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    assert guarded(refused) == 1
    assert capsys.readouterr().err.startswith("covey: this machine refuses: Too many open files; details are in ")


def test_a_reader_who_goes_is_no_failure_of_any_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rich ends the process in its own way, with exit code 1."""
    read, write = os.pipe()
    os.close(read)

    def tell() -> int:
        with open(write, "w", buffering=1) as out:
            Console(file=out).print("a line")
        return 0

    monkeypatch.setattr("deploy.cli.errors.lead_nowhere", lambda: None)
    assert guarded(tell) == 0


def test_a_simulation_whose_result_cannot_be_kept_shows_it(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(folder / "runs"))
    monkeypatch.setattr("deploy.cli.simulate.write_scores", lambda path, scores: Full().write(""))
    assert simulate_here(resolve("quick", {"run.seconds": 0.5}), "hunt", as_json=True) == 0
    shown, complaints = capsys.readouterr()
    assert json.loads(shown)["ticks"] == 2
    assert f"{folder}/runs/hunt/result.json: No space left on device; the result is not kept" in complaints


@pytest.mark.parametrize(("number", "code"), [(signal.SIGHUP, 129), (signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_simulation_with_the_result_of_the_ticks_so_far(
    number: signal.Signals, code: int, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(folder / "runs"))
    monkeypatch.setattr(ProgressLine, "tell", lambda line, done, ticks: signal.raise_signal(number) if done == 5 else None)
    before = signal.signal(number, signal.SIG_DFL)  # under nohup it is ignored
    try:
        assert simulate_here(resolve("quick", {"run.seconds": 5.0}), "hunt", as_json=True) == code
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, before)
    result, shown = kept_result(folder), json.loads(capsys.readouterr().out)
    assert (result["exit_code"], result["ticks"], result) == (code, 5, shown)
    assert [run.state for run in kept_runs()] == ["interrupted"]


def test_a_run_that_sighup_has_stopped_is_listed_as_interrupted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(folder / "runs"))
    kept = folder / "runs" / "hunt"
    kept.mkdir(parents=True)
    (kept / "run.toml").write_text("")
    (kept / "result.json").write_text(msgspec.structs.replace(short_result(), exit_code=129).to_json())
    assert [run.state for run in kept_runs()] == ["interrupted"]


def running(folder: Path, *words: str, stderr: int | None = None) -> "subprocess.Popen[bytes]":
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COVEY_RUNS": str(folder / "runs")}
    return subprocess.Popen(program(*words), cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=stderr)


def kept_result(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "runs" / "hunt" / "result.json").read_text())
    return found


@pytest.mark.live
@pytest.mark.slow
def test_a_run_whose_reader_leaves_goes_on_to_its_end(folder: Path) -> None:
    process = running(folder, *SHORT, stderr=subprocess.PIPE)
    assert process.stdout is not None and process.stderr is not None
    assert process.stdout.readline().startswith(b"run hunt")
    process.stdout.close()
    complaints = process.stderr.read().decode()
    assert (process.wait(100), "Traceback" in complaints) == (0, False), complaints
    assert (kept_result(folder)["exit_code"], kept_result(folder)["ticks"]) == (0, 12)


@pytest.mark.live
@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code"),
    [pytest.param(signal.SIGHUP, 129, id="HUP", marks=pytest.mark.nightly), pytest.param(signal.SIGINT, 130, id="Ctrl-C")],
)
def test_a_signal_that_takes_the_reader_along_keeps_its_exit_code_and_the_result(number: int, code: int, folder: Path) -> None:
    process = running(folder, *LONG)
    assert process.stdout is not None
    while b"OSPA" not in process.stdout.readline():
        assert process.poll() is None
    process.stdout.close()
    process.send_signal(number)
    assert process.wait(100) == code
    assert kept_result(folder)["exit_code"] == code


@pytest.mark.live
@pytest.mark.slow
def test_a_run_that_ignores_sighup_goes_on(folder: Path) -> None:
    code, complaints = started(f"trap '' HUP; {' '.join(program(*SLOW))} & sleep 5; kill -HUP $!; wait $!", folder)
    assert (code, kept_result(folder)["exit_code"]) == (0, 0), complaints


@pytest.mark.live
@pytest.mark.slow
def test_a_run_whose_output_fills_its_disk_goes_on_and_ends_with_1(folder: Path) -> None:
    """The disk of the output has room for the first line alone, not for the table."""
    (folder / "log").mkdir()
    line = f"unset PYTHONUNBUFFERED; head -c 3900 /dev/zero > log/up; exec {' '.join(program(*SHORT))} >> log/up"
    code, complaints = namespaced("-m", f"mount -t tmpfs -o size=4k none log; {line}", folder)
    assert (code, complaints[-1]) == (1, "covey: standard output: No space left on device")
    assert (kept_result(folder)["exit_code"], kept_result(folder)["ticks"]) == (0, 12)
