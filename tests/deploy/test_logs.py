"""`covey logs` and `covey ps -a`: logs merged by time, one process or all, while they grow, and runs that have ended."""

import json
import os
import shutil
from pathlib import Path

import pytest

from deploy.cli.logs import LogTails, logs
from deploy.cli.process_list import ps_all
from deploy.scenario import resolve
from deploy.storage.run_directory import RunDirectory
from protocol.settings import BadSetting


def line(time: float, name: str, message: str, **more: object) -> str:
    return json.dumps({"time": time, "level": "info", "run": "r", "agent": name, "message": message, **more}) + "\n"


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunDirectory:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path))
    monkeypatch.setenv("TZ", "UTC")
    directory = RunDirectory("r")
    directory.logs.mkdir(parents=True)
    directory.log("s1").write_text(line(10.0, "s1", "first") + line(30.0, "s1", "third", tick=7, level="warning"))
    directory.log("supervisor").write_text(
        line(20.0, "supervisor", "second") + "agents: a complaint\n" + line(40.0, "supervisor", "s1 ended: killed by SIGKILL")
    )
    return directory


def test_all_logs_come_out_by_time_and_a_line_without_one_stays_behind_the_line_before(
    run: RunDirectory, capsys: pytest.CaptureFixture[str]
) -> None:
    assert logs((), None, follow=True, lines=None, raw=False) == 0
    shown = [entry.split(maxsplit=2)[1:] for entry in capsys.readouterr().out.splitlines()]
    assert shown == [
        ["s1", "first"],
        ["supervisor", "second"],
        ["supervisor", "agents: a complaint"],
        ["s1", "warning: third  (tick 7)"],
        ["supervisor", "s1 ended: killed by SIGKILL"],
    ]


def test_one_process_the_last_lines_and_the_raw_lines(run: RunDirectory, capsys: pytest.CaptureFixture[str]) -> None:
    logs(("s1",), "r", follow=False, lines=None, raw=True)
    assert capsys.readouterr().out == run.log("s1").read_text()
    logs((), "r", follow=False, lines=1, raw=True)
    assert capsys.readouterr().out == line(40.0, "supervisor", "s1 ended: killed by SIGKILL")
    logs((), "r", follow=False, lines=0, raw=True)
    assert capsys.readouterr().out == ""


def test_what_is_written_later_is_read_later_and_half_a_line_waits_for_its_end(run: RunDirectory) -> None:
    tails = LogTails(run)
    assert len(tails.read()) == 5
    whole = line(50.0, "s2", "a newcomer")
    with run.log("s2").open("w") as log:
        log.write(whole[:20])
        log.flush()
        assert tails.read() == []
        log.write(whole[20:])
    assert [(entry.name, entry.fields["message"]) for entry in tails.read()] == [("s2", "a newcomer")]
    assert tails.read() == []


def test_an_exception_stands_below_its_line(run: RunDirectory, capsys: pytest.CaptureFixture[str]) -> None:
    run.log("s1").write_text(line(1.0, "s1", "the process ends", exception="Traceback:\n  here"))
    logs(("s1",), "r", follow=False, lines=None, raw=False)
    assert capsys.readouterr().out == "00:00:01.000  s1          the process ends\n    Traceback:\n      here\n"


def test_a_run_or_a_process_that_is_not_there_is_told_with_those_that_are(run: RunDirectory) -> None:
    with pytest.raises(BadSetting, match=r"'s9': run r has no such process; it has s1, supervisor"):
        logs(("s9",), "r", follow=False, lines=None, raw=False)
    with pytest.raises(BadSetting, match=r"--run q: there is no such run in .*; there are r"):
        logs((), "q", follow=False, lines=None, raw=False)


def test_of_what_has_no_processes_it_is_said_so_and_the_newest_run_that_has_some_is_the_default(
    run: RunDirectory, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind in ("simulated", "replayed"):
        directory = RunDirectory(kind)
        directory.logs.mkdir(parents=True)
        os.utime(directory.logs, (4e9, 4e9))  # the newest
        directory.write_config(resolve("quick"), **{kind: True})
    for names in (), ("s1",):
        with pytest.raises(BadSetting, match=r"--run simulated: it is a simulation, which has no processes and no logs$"):
            logs(names, "simulated", follow=False, lines=None, raw=False)
    with pytest.raises(BadSetting, match=r"--run q: there is no such run in .*; there are r$"):
        logs((), "q", follow=False, lines=None, raw=False)
    with pytest.raises(BadSetting, match=r"--run replayed: it is a recording that is said again, which has no processes and no logs$"):
        logs((), "replayed", follow=False, lines=None, raw=False)
    assert logs((), None, follow=False, lines=1, raw=True) == 0
    assert capsys.readouterr().out == line(40.0, "supervisor", "s1 ended: killed by SIGKILL")
    shutil.rmtree(run.path)
    with pytest.raises(BadSetting, match=r"there is no run in .* that has processes"):
        logs((), None, follow=False, lines=None, raw=False)


def test_ps_a_leaves_out_a_run_that_is_removed_while_it_looks(
    run: RunDirectory, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def remove(directory: RunDirectory) -> bool:
        shutil.rmtree(directory.path)
        return False

    monkeypatch.setattr(RunDirectory, "is_running", remove)
    assert ps_all(None, as_json=True) == 0
    assert json.loads(capsys.readouterr().out) == {"running": [], "ended": []}


def test_ps_a_shows_a_run_that_has_ended_and_who_died_in_it(run: RunDirectory, capsys: pytest.CaptureFixture[str]) -> None:
    run.config.write_text('[run]\nscenario = "quick"\n[members]\ns1 = "A"\ns2 = "A"\n')
    run.result.write_text("{}")
    (run.logs.parent.parent / "latest").symlink_to("r")  # no run of its own
    assert ps_all(None, as_json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["running"] == [] and len(found["ended"]) == 1
    ended = found["ended"][0]
    assert (ended["run"], ended["scenario"], ended["agents"], ended["ended_at"]) == ("r", "quick", 2, 40.0)
    assert ended["deaths"] == [{"name": "s1", "end": "killed by SIGKILL"}] and ended["result"].endswith("r/result.json")
    ps_all(None, as_json=False)
    assert "s1 (killed by SIGKILL)" in capsys.readouterr().out
