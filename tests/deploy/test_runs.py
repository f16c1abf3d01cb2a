"""KeptRun runs: every run has a directory of its own, a name means one run, and what is removed was asked for."""

import fcntl
import json
import os
import re
import subprocess
import threading
import time
from pathlib import Path

import pytest

from deploy.__main__ import app
from deploy.cli.process_list import ended_run, ps_all
from deploy.cli.runs import rm, runs
from deploy.cli.simulate import simulate_here
from deploy.installation import command, environment
from deploy.recording.recording import find_recording
from deploy.scenario import resolve
from deploy.storage.kept_runs import age_of, find_run, kept_runs, link_latest, new_run_directory
from deploy.storage.run_directory import LATEST_LINK, RunDirectory, find_running, running_runs, runs_folder
from protocol.keys import NAME
from protocol.settings import BadSetting


def undated(name: str) -> str:
    """The name of a run that nobody named, without its date: a test may run at midnight."""
    assert re.match(r"\d{4}-\d\d-\d\d-", name), name
    return name[11:]


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path / "runs"))
    monkeypatch.chdir(tmp_path)


def play(
    requested_name: str | None = None, *, seed: int = 1, ended: bool = True, recorded: bool = False, code: int = 0, age: float = 0.0
) -> str:
    """A run as it lies in its folder afterwards; its name."""
    directory, lock = new_run_directory(requested_name, "quick")
    directory.write_config(resolve("quick", {"run.seed": seed}))
    link_latest(directory)
    if ended:
        directory.result.write_text(json.dumps({"steady_ospa": 0.5 + seed, "exit_code": code}))
    if recorded:
        (directory.path / "recording.mcap").write_bytes(bytes(1_500_000))
    os.close(lock)
    os.utime(directory.config, (time.time() - age, time.time() - age))
    return directory.name


def test_runs_that_nobody_names_are_numbered_by_date_and_scenario() -> None:
    names = [play(), play(), play()]
    assert [undated(name) for name in names] == [f"quick-{number}" for number in (1, 2, 3)]
    rm([names[1]], False, None, False)
    assert undated(play()) == "quick-4"  # a number that was removed may stand in somebody's notes


def test_a_scenario_of_any_path_gives_a_name_that_fits_into_a_key() -> None:
    for scenario in ("my runs/ä b#1.toml", "x" * 300, ".toml"):
        directory, lock = new_run_directory(None, scenario)
        os.close(lock)
        assert NAME.match(directory.name)
        assert directory.path.parent == runs_folder()


def test_a_name_that_an_ended_run_has_is_continued_and_nothing_of_the_ended_run_changes() -> None:
    assert play("hunt", seed=1, recorded=True) == "hunt"
    before = {file: file.read_bytes() for file in RunDirectory("hunt").path.rglob("*") if file.is_file()}
    assert [play("hunt", seed=2), play("hunt", seed=3)] == ["hunt-2", "hunt-3"]
    assert {file: file.read_bytes() for file in RunDirectory("hunt").path.rglob("*") if file.is_file()} == before


def test_a_name_of_64_characters_is_continued_within_64_characters() -> None:
    assert [len(play("x" * 64)) for _ in range(3)] == [64, 64, 64]


def test_a_folder_with_anything_in_it_is_no_place_for_a_run() -> None:
    for file in ("hunt/recording.mcap", "hunt-2/trials.jsonl", "hunt-3"):
        (runs_folder() / file).parent.mkdir(parents=True, exist_ok=True)
        (runs_folder() / file).write_text("mine")
    assert play("hunt") == "hunt-4"


def test_what_a_start_that_failed_has_left_is_used_again() -> None:
    directory, lock = new_run_directory("hunt", "quick")
    directory.log("zygote").write_text("no memory")
    directory.output.write_text("no memory")
    directory.page.write_text("http://127.0.0.1:1/")
    os.close(lock)
    directory, lock = new_run_directory("hunt", "quick")
    os.close(lock)
    assert directory.name == "hunt"
    assert list(directory.logs.iterdir()) == []


@pytest.mark.parametrize("record", ["mine.txt", "/dev/null/mine.mcap"])
def test_a_simulation_that_is_refused_leaves_no_run_and_latest_where_it_was(record: str) -> None:
    play("one")
    with pytest.raises(BadSetting, match="--record "):
        simulate_here(resolve("quick", {"run.seconds": 1.0}), "two", False, Path(record))
    assert {path.name for path in runs_folder().iterdir()} == {"one", LATEST_LINK}
    assert (runs_folder() / LATEST_LINK).readlink() == Path("one")


@pytest.mark.parametrize("words", [("--page", "x"), ("--record", "mine.txt", "--detach")])
def test_a_live_run_that_is_refused_leaves_no_run(words: tuple[str, ...]) -> None:
    start = [*command("deploy"), "up", "quick", "--seconds", "1", "--spawn", "exec", "--run", "two", *words]
    done = subprocess.run(start, env=environment(), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1 and words[0] in done.stderr
    assert list(runs_folder().iterdir()) == []


def test_what_a_start_that_was_killed_has_left_can_be_removed() -> None:
    directory, lock = new_run_directory("hunt", "quick")
    with pytest.raises(BadSetting, match="hunt: the run is running"):
        rm(["hunt"], False, None, False)
    os.close(lock)
    assert rm(["hunt"], False, None, False) == 0
    assert not directory.path.exists()


def test_a_name_whose_run_is_running_is_refused_and_two_unnamed_starts_at_once_get_two_names() -> None:
    _, lock = new_run_directory("hunt", "quick")
    with pytest.raises(BadSetting, match=r"--run hunt: .*covey down --run hunt"):
        new_run_directory("hunt", "quick")
    os.close(lock)
    held = [new_run_directory(None, "quick") for _ in range(2)]
    link_latest(held[1][0])
    assert find_running(LATEST_LINK).name == held[1][0].name
    assert [undated(directory.name) for directory, _ in held] == ["quick-1", "quick-2"]
    for _, lock in held:
        os.close(lock)


@pytest.mark.parametrize("name", ["latest", "..", ".", "a/b", "", "x" * 65, "a b"])
def test_a_name_that_is_no_folder_or_no_part_of_a_key_is_refused(name: str) -> None:
    with pytest.raises(BadSetting, match="--run"):
        new_run_directory(name, "quick")


def test_latest_is_the_run_that_began_last_wherever_a_run_is_named() -> None:
    assert find_run(LATEST_LINK) is None
    play("one", recorded=True)
    play("two", recorded=True)
    assert (runs_folder() / LATEST_LINK).readlink() == Path("two")
    assert find_recording(LATEST_LINK) == RunDirectory("two").path / "recording.mcap"
    rm([LATEST_LINK], False, None, False)
    assert find_recording(LATEST_LINK) == RunDirectory("one").path / "recording.mcap"
    rm(["one"], False, None, False)
    assert not (runs_folder() / LATEST_LINK).is_symlink()


def test_the_name_of_a_run_wins_over_a_file_of_that_name() -> None:
    play("covey", recorded=True)
    Path("covey").write_text("the launcher")
    assert find_recording("covey") == RunDirectory("covey").path / "recording.mcap"
    assert find_recording("./covey") == Path("covey")
    rm(["covey"], False, None, False)
    assert find_recording("covey") == Path("covey")


def test_a_run_without_a_recording_and_a_name_that_nobody_has_are_one_line_each() -> None:
    play("hunt")
    with pytest.raises(BadSetting, match="hunt: no recording in it; run with --record"):
        find_recording("hunt")
    with pytest.raises(BadSetting, match=r"nowhere: no such file, and no run of this name in .*covey runs"):
        find_recording("nowhere")


def test_the_list_says_what_became_of_each_run(capsys: pytest.CaptureFixture[str]) -> None:
    play("ended", seed=1, recorded=True, age=30.0)
    (RunDirectory("ended").path / "recording.foxglove.mcap").write_bytes(bytes(1000))  # which is none
    play("killed", seed=2, ended=False, age=20.0)
    play("stopped", seed=3, code=130, age=10.0)
    play("refused", seed=3, code=2, age=5.0)
    directory, lock = new_run_directory("going", "quick")
    directory.write_config(resolve("quick", {"run.seed": 4}), simulated=True)
    assert runs(as_json=True) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert list(rows) == ["going", "refused", "stopped", "killed", "ended"]
    assert [rows[name]["state"] for name in rows] == ["running", "failed", "interrupted", "interrupted", "ended"]
    assert (rows["ended"]["scenario"], rows["ended"]["seed"], rows["ended"]["ospa"]) == ("quick", 1, 1.5)
    assert (rows["ended"]["recording_bytes"], rows["killed"]["recording_bytes"]) == (1_500_000, 0)
    assert runs(as_json=False) == 0
    table = capsys.readouterr().out
    assert "quick (simulated)" in table and "1.50" in table and "1.5 MB" in table
    os.close(lock)


def test_a_run_that_failed_before_its_first_tick_is_listed_without_a_score() -> None:
    name = play("refused", code=2)
    result = RunDirectory(name).result
    result.write_text(result.read_text().replace("{", '{"ticks": 0, '))
    assert [(kept.state, kept.ospa) for kept in kept_runs()] == [("failed", None)]


def test_a_running_simulation_is_no_swarm_that_could_be_asked() -> None:
    directory, lock = new_run_directory("virtual", "quick")
    directory.write_config(resolve("quick"), simulated=True)
    assert directory.is_running()
    assert running_runs() == []
    with pytest.raises(BadSetting, match="no run is running"):
        find_running(None)
    for supervised in (False, True):
        with pytest.raises(BadSetting, match=r"--run virtual: it is a simulation, .* no network; Ctrl-C"):
            find_running("virtual", supervised=supervised)
    os.close(lock)


@pytest.mark.parametrize(("kind", "is_called"), [("simulated", "a simulation"), ("replayed", "a recording that is said again")])
def test_a_run_without_a_supervisor_is_not_ended_by_down(kind: str, is_called: str) -> None:
    directory, lock = new_run_directory("hunt", "quick")
    directory.write_config(resolve("quick"), simulated=kind == "simulated", replayed=kind == "replayed")
    for refused in (lambda: rm(["hunt"], False, None, False), lambda: new_run_directory("hunt", "quick")):
        with pytest.raises(BadSetting, match=rf"running; it is {is_called}.*Ctrl-C in its terminal ends it") as complaint:
            refused()
        assert "down" not in str(complaint.value)
    os.close(lock)


def test_ps_a_calls_a_simulation_ended_only_once_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    directory, lock = new_run_directory("virtual", "quick")
    directory.write_config(resolve("quick"), simulated=True)
    ps_all(None, as_json=False)
    assert capsys.readouterr().out.startswith("--run virtual: it is a simulation")
    ps_all(None, as_json=True)
    assert json.loads(capsys.readouterr().out) == {"running": [], "ended": []}
    os.close(lock)
    ps_all(None, as_json=True)
    assert [run["run"] for run in json.loads(capsys.readouterr().out)["ended"]] == ["virtual"]


def test_a_body_that_left_after_the_last_tick_has_not_died_before() -> None:
    directory = RunDirectory(play("hunt"))
    ends = ("s1.body ended: exit code 0", "s2.body ended: killed by SIGKILL", "s3.body ended: exit code 1", "world ended: exit code 0")
    directory.log("supervisor").write_text("".join(json.dumps({"time": 1.0, "message": end}) + "\n" for end in ends))
    assert [death["name"] for death in ended_run(directory)["deaths"]] == ["s2.body", "s3.body"]


def test_a_result_that_was_spoilt_is_listed_without_its_score(capsys: pytest.CaptureFixture[str]) -> None:
    play("good")
    RunDirectory(play("spoilt")).result.write_text('{"steady_ospa": "much"}')
    capsys.readouterr()
    assert runs(False) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["name", "spoilt", "good"]
    assert kept_runs()[0].ospa is None


def test_a_running_run_is_not_removed_and_then_nothing_is() -> None:
    play("one")
    _, lock = new_run_directory("two", "quick")
    RunDirectory("two").write_config(resolve("quick"))
    with pytest.raises(BadSetting, match="two: the run is running"):
        rm(["one", "two"], False, None, False)
    assert [kept.name for kept in kept_runs()] == ["two", "one"]
    assert rm([], True, None, True) == 0
    assert [kept.name for kept in kept_runs()] == ["two"]
    os.close(lock)


def test_nothing_but_runs_is_removed() -> None:
    (runs_folder() / "study-efficacy").mkdir(parents=True)
    (runs_folder() / "study-efficacy" / "trials.jsonl").write_text("weeks of work")
    play("one")
    for name in ("study-efficacy", "..", "one/..", "nowhere"):
        with pytest.raises(BadSetting, match="there is no run of this name"):
            rm([name], False, None, False)
    assert rm([], True, None, True) == 0
    assert [path.name for path in runs_folder().iterdir()] == ["study-efficacy"]


def test_old_runs_are_removed_by_age_and_without_a_terminal_only_with_yes() -> None:
    play("old", age=8.0 * 86400.0)
    play("new", age=6.0 * 86400.0)
    with pytest.raises(BadSetting, match="would remove 1 runs; add -y"):
        rm([], False, "7d", False)
    assert rm([], False, "7d", True) == 0
    assert [kept.name for kept in kept_runs()] == ["new"]


@pytest.mark.parametrize("words", [([], False, None), (["a"], True, None), ([], True, "7d"), (["a"], False, "7d")])
def test_what_is_removed_is_said_in_one_way(words: tuple[list[str], bool, str | None]) -> None:
    with pytest.raises(BadSetting, match="give names of runs, or --all, or --older-than 7d"):
        rm(*words, True)


def test_an_age_has_a_number_and_a_unit() -> None:
    assert [age_of(text) for text in ("30m", "12h", "7d", "1.5w")] == [1800.0, 43200.0, 604800.0, 907200.0]
    for text in ("7", "d", "7y", "-1d", "1e9d", ""):
        with pytest.raises(BadSetting, match="30m, 12h, 7d or 2w"):
            age_of(text)


def test_a_simulation_is_kept_when_it_is_named_or_recorded_and_not_otherwise(capsys: pytest.CaptureFixture[str]) -> None:
    scenario = resolve("quick", {"run.seconds": 1.0, "team.composition": "2E"})
    simulate_here(scenario, None, False)
    simulate_here(scenario, None, False, Path("mine.mcap"))
    assert not runs_folder().exists()
    assert Path("mine.mcap").exists()
    simulate_here(scenario, "virtual", False)
    simulate_here(scenario, None, False, True)
    unnamed, named = kept_runs()
    assert [(undated(unnamed.name), unnamed.state, unnamed.simulated), named.name] == [("quick-1", "ended", True), "virtual"]
    assert find_recording(LATEST_LINK).parent.name == unnamed.name
    assert not list(RunDirectory("virtual").path.glob("*.mcap"))


def test_the_commands_take_names_and_the_short_yes() -> None:
    _, bound, _ = app.parse_args(["rm", "one", "two"])
    assert bound.args == ("one", "two")
    _, bound, _ = app.parse_args(["rm", "--all", "-y"])
    assert (bound.arguments["all"], bound.arguments["yes"]) == (True, True)
    _, bound, _ = app.parse_args(["rm", "--older-than", "7d"])
    assert bound.arguments["older_than"] == "7d"


def test_looks_at_a_run_are_in_the_way_of_no_other_look_and_of_no_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path))
    directory, looks = RunDirectory("hunt"), list[bool]()
    descriptor = directory.hold()
    assert descriptor is not None and directory.is_running()
    os.close(descriptor)
    end = threading.Event()

    def look() -> None:
        while not end.is_set():
            looks.append(directory.is_running())

    lookers = [threading.Thread(target=look) for _ in range(2)]
    for looker in lookers:
        looker.start()
    time.sleep(0.3)
    end.set()
    for looker in lookers:
        looker.join()
    assert len(looks) > 100 and not any(looks)
    with directory.lock.open() as looked_at:
        fcntl.flock(looked_at, fcntl.LOCK_SH)
        timer = threading.Timer(0.03, fcntl.flock, (looked_at, fcntl.LOCK_UN))
        timer.start()
        descriptor = directory.hold()
        timer.join()
    assert descriptor is not None
    os.close(descriptor)
