"""`covey study` from end to end with the smallest trials, its options, and what it says of the time that is left."""

import json
import multiprocessing
import operator
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from deploy.cli.study import console_of, run_study
from deploy.installation import ROOT, environment
from deploy.studies.design import Design, design_fields, design_with, dotted_options
from deploy.studies.engines import FinishedTrials, Numbered, TrialFailed, _harvest, on_a_cluster, on_this_machine, shared_progress
from deploy.studies.open_trials import ProgressBar, RemainingWork, _exits_on_sigterm, _follow, duration_text, remaining
from deploy.studies.results import StudyFolder
from deploy.studies.trials import Row, Trial, run_trial
from protocol.settings import BadSetting

SMALL = Design(
    scenario="quick", teams=("A2,B4",), targets=(3,), methods=("power", "voronoi"), trials=2, options={"run.seconds": 3.0, "run.dt": 0.5}
)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """Run a study into a folder of its own with two workers; its JSON line."""

    def go(found: Design = SMALL, into: str = "study") -> dict[str, Any]:
        assert run_study(found, tmp_path / into, 2, None, as_json=True) == 0
        result: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
        return result

    return go


@pytest.mark.slow
def test_a_study_that_was_cut_short_goes_on_and_ends_with_the_same_table(run: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    whole = run()
    lines = (tmp_path / "study" / "trials.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "again").mkdir()
    (tmp_path / "again" / "trials.jsonl").write_text(lines[2] + lines[0] + lines[1][:40])  # two rows and a torn one
    again = run(into="again")
    assert {**again, "folder": ""} == {**whole, "folder": ""} and whole["trials"] == 4
    assert StudyFolder(tmp_path / "again").csv.read_bytes() == StudyFolder(tmp_path / "study").csv.read_bytes()
    kept = (tmp_path / "again" / "trials.jsonl").read_text().splitlines(keepends=True)
    assert kept[:2] == [lines[2], lines[0]] and len(kept) == 4  # nothing was run twice


@pytest.mark.slow
def test_workers_give_the_rows_that_this_process_gives(run: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    run()
    rows = StudyFolder(tmp_path / "study").finished()
    trial = Trial(scenario="quick", seed=100, team="A2,B4", targets=3, method="voronoi", options=SMALL.options)
    assert {**rows[trial.key()], "wall_s": 0} == {**run_trial(trial), "wall_s": 0}


def test_rows_of_another_program_are_not_mixed_in(run: Callable[..., dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    """This process believes in other sources than its workers read."""
    monkeypatch.setattr("deploy.studies.trials.fingerprint", lambda: "0123456789ab")
    with pytest.raises(
        BadSetting,
        match=r"a worker runs another program \([0-9a-f]{12}\) .*\.py was the last\); start the study again; 0 of 4 trials are kept$",
    ):
        run()


@pytest.mark.slow
def test_a_scenario_file_that_changes_in_the_middle_of_a_study_is_named_and_the_trials_before_are_kept(tmp_path: Path) -> None:
    file, folder = tmp_path / "mine.toml", StudyFolder(tmp_path / "study")
    file.write_text("[run]\nseconds = 1.0\n")
    trials = [Trial(scenario=str(file), seed=seed, team="A2", targets=1, method="power") for seed in (1, 2)]
    keys = [trial.key() for trial in trials]

    def engine() -> FinishedTrials:
        yield [(0, {"key": keys[0], "code": "a"})]
        file.write_text("[run]\nseconds = 2.0\n")
        yield [(1, {"key": trials[1].key(), "code": "a"})]

    ahead, tell = RemainingWork(trials, list(enumerate(trials)), [0.0, 0.0]), console_of(as_json=True)
    with (
        folder.claimed(),
        pytest.raises(BadSetting, match=r"/mine\.toml: it, or a file .* was changed while the study ran; .*; 1 of 2 trials are kept$"),
    ):
        _follow(engine(), folder, trials, keys, ahead, ProgressBar(tell, ahead, 2, None))
    assert folder.finished().keys() == {keys[0]}


def test_a_study_goes_on_when_its_reader_has_gone() -> None:
    program = """
import sys
from deploy.cli.study import console_of
console = console_of(False)
for line in ("begun", "the table"):
    console.print(line)
sys.stderr.write("kept")
"""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-c", program], stdout=write, stderr=subprocess.PIPE, cwd=ROOT, env=environment(), check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"kept")


@pytest.mark.slow
def test_a_trial_that_fails_names_its_command() -> None:
    bad = Trial(scenario="quick", seed=1, team="A1", targets=3, method="power", options={"targets.motion": "nowhere:Motion"})
    with pytest.raises(TrialFailed, match=r"covey simulate quick .*nowhere"):
        list(on_this_machine([(0, bad)], 1, shared_progress(1)))


def test_a_trial_that_fails_costs_no_other_its_row() -> None:
    trials = [Trial(scenario="quick", seed=seed, team="A1", targets=3, method="power") for seed in range(3)]
    done: dict[Future[Row], Numbered] = {Future(): (number, trial) for number, trial in enumerate(trials)}
    one, bad, another = done
    one.set_result({"row": 0})
    bad.set_exception(ValueError("no such thing"))
    another.set_result({"row": 2})
    steps = _harvest(done)
    assert next(steps) == [(0, {"row": 0}), (2, {"row": 2})]
    with pytest.raises(TrialFailed, match=r"--seed 1 .*: ValueError: no such thing"):
        next(steps)


def test_a_worker_that_was_killed_is_no_fault_of_a_trial() -> None:
    trial = Trial(scenario="quick", seed=1, team="A1", targets=3, method="power")
    with pytest.raises(
        TrialFailed, match=r"^a worker process ended: .* lacks memory .* fewer --workers need less; or a script calls .* outside of"
    ):
        list(on_this_machine([(0, trial)], 1, shared_progress(1), _killed))


def _killed(trial: Trial, tell: Callable[[float], None]) -> Row:
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def test_a_study_ends_no_process_but_its_own() -> None:
    """Its workers compare a trial with a function, which is done at once."""
    bystander = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600,))
    bystander.start()
    try:
        trial = Trial(scenario="quick", seed=1, team="A1", targets=3, method="power")
        (rows,) = [rows for rows in on_this_machine([(0, trial)], 1, shared_progress(1), operator.eq) if rows]
        assert rows == [(0, False)]
        bystander.join(0.5)
        assert bystander.is_alive()
        for process in multiprocessing.active_children():
            if process is not bystander:
                process.join(30.0)
        assert multiprocessing.active_children() == [bystander]
    finally:
        bystander.kill()
        bystander.join()


def test_in_a_thread_a_study_leaves_signals_to_the_program() -> None:
    def inside() -> object:
        with _exits_on_sigterm():
            return signal.getsignal(signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    with ThreadPoolExecutor(1) as threads:
        assert threads.submit(inside).result() == before
    assert inside() != before
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_scheduler_that_is_not_there_is_named() -> None:
    with pytest.raises(BadSetting, match=r"--scheduler nonsense://127\.0\.0\.1:1"):
        list(on_a_cluster([], "nonsense://127.0.0.1:1"))


@pytest.mark.slow
def test_a_cluster_gives_the_same_table(run: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    run()
    workers = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "host": "127.0.0.1"}
    with distributed.LocalCluster(**workers) as cluster:
        assert run_study(SMALL, tmp_path / "cluster", 2, cluster.scheduler_address, as_json=True) == 0
    assert StudyFolder(tmp_path / "cluster").csv.read_bytes() == StudyFolder(tmp_path / "study").csv.read_bytes()


def test_options_become_fields_and_settings() -> None:
    given = design_fields(3, 200, "2,20E+4H", "30, 40", "power,voronoi,power")
    found = design_with("efficacy", False, given, dotted_options("BCD", None, 0.5, None))
    assert (found.trials, found.first_seed, found.teams, found.targets) == (3, 200, ("2", "20E+4H"), (30, 40))
    assert found.methods == ("power", "voronoi")
    assert found.options == {"team.triple": "BCD", "run.dt": 0.5}


@pytest.mark.parametrize(("trials", "targets", "complaint"), [(0, None, "--trials 0"), (None, "30,many", "--targets 30,many")])
def test_options_that_make_no_sense_are_named(trials: int | None, targets: str | None, complaint: str) -> None:
    with pytest.raises(BadSetting, match=complaint):
        design_fields(trials, None, None, targets, None)


def test_what_is_left_is_what_was_done_at_the_same_speed() -> None:
    assert remaining(0.25, 60.0) == pytest.approx(180.0)


def test_the_share_that_is_done_counts_running_trials_by_their_cost() -> None:
    """Four trials of equal cost: one done before this start, one finished, one half way, one open."""
    trials = [Trial(scenario="quick", seed=seed, team="A1", targets=3, method="power") for seed in range(4)]
    ahead = RemainingWork(trials, list(enumerate(trials))[1:], [0.0, 0.0, 0.5, 0.0])
    ahead.finish(1)
    assert ahead.finished == 2 and ahead.running() == 1
    assert ahead.share() == pytest.approx(1.5 / 3.0)


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "1 s"), (44.1, "45 s"), (100.0, "2 min"), (3600.0, "60 min"), (12000.0, "3 h 20 min")])
def test_durations_in_words(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text
