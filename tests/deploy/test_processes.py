"""A child process and what is said of it: how it ended, its last words, its row in `ps`."""

import json
import re
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest

from deploy.live.processes import LAST_BYTES, Child, is_stopped, process_rows
from deploy.live.seeds import endpoints, seed_listeners
from deploy.scenario import resolve
from deploy.storage.run_directory import RunDirectory
from protocol.settings import BadSetting


@pytest.fixture
def child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Child:
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path))
    directory = RunDirectory("one")
    directory.logs.mkdir(parents=True)
    return Child("s2", "agents", directory, [])


def line(**fields: str) -> str:
    return json.dumps({"time": 1.0, "level": "info", **fields})


def test_the_last_words_of_a_process_are_its_complaint_or_the_last_line_of_its_exception(child: Child) -> None:
    log = child.directory.log("s2")
    assert child.last_log_line() == ""
    log.write_text(line(message="joined") + "\n" + line(message="the end", exception="Traceback:\n  a.py\nZeroDivisionError: no way\n"))
    assert child.last_log_line() == "ZeroDivisionError: no way"
    log.write_text(line(message="joined") + "\n")
    assert child.last_log_line() == "joined"
    log.write_text("17\n" + line(message="joined") + "\n")
    assert child.last_log_line() == "17"
    log.write_text("agents: --name s9: no such member\n" + line(message="joined") + "\n")
    assert child.last_log_line() == "agents: --name s9: no such member"


def test_an_old_complaint_is_not_the_cause_of_a_later_crash(child: Child, monkeypatch: pytest.MonkeyPatch) -> None:
    log = child.directory.log("s2")
    crash = line(message="the end", exception="Traceback:\nZeroDivisionError: no way\n") + "\n"
    log.write_text("a library's warning\n" + crash + line(message="ends") + "\n")
    assert child.last_log_line() == "ZeroDivisionError: no way"
    log.write_text("a library's warning\n" + crash)
    monkeypatch.setattr(Child, "_fork", lambda *_: None)
    child.start()
    assert child.last_log_line() == ""
    with log.open("a") as more:
        more.write(line(message="joined") + "\n")
    assert child.last_log_line() == "joined"


def test_of_a_long_log_only_whole_lines_of_its_end_are_read(child: Child) -> None:
    long = line(message="y" * (LAST_BYTES - 50))
    child.directory.log("s2").write_text("an old complaint\n" + line(message="x" * 100) + "\n" + long + "\n")
    assert child.last_log_line() == "y" * (LAST_BYTES - 50)


@pytest.mark.parametrize(
    ("code", "crashed"),
    [(None, False), (0, False), (1, True), (3, False), (-signal.SIGSEGV, True), (-signal.SIGKILL, False), (-signal.SIGTERM, False)],
)
def test_an_exception_and_a_crash_are_the_processs_own_and_a_kill_is_not(child: Child, code: int | None, crashed: bool) -> None:
    child.returncode = code
    assert child.crashed == crashed


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc here")
def test_a_process_that_is_stopped_or_let_go_on_from_outside_is_noticed_once(child: Child) -> None:
    process = child.process = subprocess.Popen(["sleep", "1000"], stdin=subprocess.PIPE)
    try:
        assert child.look() == ""
        process.send_signal(signal.SIGSTOP)
        until_stopped(process.pid, True)
        assert (child.look(), child.paused, child.look()) == ("pause", True, "")
        process.send_signal(signal.SIGCONT)
        until_stopped(process.pid, False)
        assert (child.look(), child.paused, child.look()) == ("resume", False, "")
        child.send(signal.SIGSTOP)  # an order, not from outside
        until_stopped(process.pid, True)
        assert (child.look(), child.paused) == ("", True)
        child.send(signal.SIGCONT)
        assert (child.look(), child.paused) == ("", False)
    finally:
        process.kill()
        process.communicate()


def test_lines_that_a_full_pipe_has_no_room_for_arrive_whole_and_the_newest_last(child: Child) -> None:
    """The process reads nothing until the end, as one that is paused."""
    process = child.process = subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.send_signal(signal.SIGSTOP)
    until_stopped(process.pid, True)
    try:
        lines = [str(number) * 50_000 for number in range(1, 8)]
        for line in lines:
            child.tell(line)
        process.send_signal(signal.SIGCONT)
        reader = threading.Thread(target=lambda: found.append(process.stdout.read()))  # type: ignore[union-attr]
        found: list[bytes] = []
        reader.start()
        end = time.monotonic() + 60.0
        while (child.unwritten or child.next_line) and time.monotonic() < end:
            child.write_what_waits()
            time.sleep(0.01)
        assert process.stdin is not None
        process.stdin.close()
        reader.join(60.0)
        read = found[0].decode().splitlines()
        assert read == [*lines[: len(read) - 1], lines[-1]] and 2 <= len(read) < 7
    finally:
        process.kill()
        process.wait()


def until_stopped(pid: int, wanted: bool) -> None:
    end = time.monotonic() + 60.0
    while is_stopped(pid) != wanted:
        assert time.monotonic() < end
        time.sleep(0.005)


def test_every_process_has_a_row_with_what_is_known_of_it_and_living_guests_follow(child: Child) -> None:
    child.incarnation, child.returncode = 1, -signal.SIGKILL
    known = {"tick": 7, "cell": 0.0}
    agents = [{"name": name, "alive": alive, **known} for name, alive in (("s2", False), ("guest", True), ("gone", False))]
    dead, guest = process_rows({"s2": child}, {"s2": "A"}, agents)
    assert (dead["name"], dead["class"], dead["state"], dead["end"], dead["tick"]) == ("s2", "A", "dead", "killed by SIGKILL", 7)
    assert (guest["name"], guest["state"], guest["alive"]) == ("guest", "guest", True)


def test_a_seed_listens_and_nobody_dials_itself() -> None:
    seeds = ("tcp/a", "tcp/b")
    assert endpoints("s1", {"s1": "tcp/a"}, seeds) == ["--listen", "tcp/a", "--seed-endpoint", "tcp/b"]
    assert endpoints("s2", {"s1": "tcp/a"}, seeds) == ["--seed-endpoint", "tcp/a", "--seed-endpoint", "tcp/b"]


@pytest.mark.parametrize(
    ("listen", "found"), [("tls/0.0.0.0:0", r"tls/0\.0\.0\.0:[1-9]\d+"), ("tcp/127.0.0.1:7447", r"tcp/127\.0\.0\.1:7447")]
)
def test_where_the_scenario_says_any_free_port_the_others_are_told_which(listen: str, found: str) -> None:
    listeners = seed_listeners(resolve("quick", {"network.listen": [listen]}))
    assert list(listeners) == ["monitor"] and re.fullmatch(found, listeners["monitor"])


@pytest.mark.parametrize("listen", [[], ["tcp/127.0.0.1:7447", "tcp/127.0.0.1:7448"]])
def test_a_supervisor_that_would_listen_nowhere_or_at_two_places_is_refused(listen: list[str]) -> None:
    with pytest.raises(BadSetting, match=re.escape(f"network.listen = {listen}: should be one endpoint, such as")):
        seed_listeners(resolve("quick", {"network.listen": listen}))


@pytest.mark.parametrize(
    ("name", "package", "option"), [("world", "world", "--keep-halt"), ("s2.body", "world", "--keep"), ("s2", "agents", "")]
)
def test_whoever_moves_bodies_keeps_the_halt_beside_its_log(
    child: Child, monkeypatch: pytest.MonkeyPatch, name: str, package: str, option: str
) -> None:
    told = list[list[str]]()
    monkeypatch.setattr(subprocess, "Popen", lambda words, **_: told.append(words))
    body_of = "s2" if name.endswith("body") else ""
    Child(name, package, child.directory, [], body_of=body_of).start()
    halts = [word for word in told[0] if word.endswith(".halt")]
    assert halts == ([str(child.directory.logs / f"{name}.halt")] if option else [])
    assert not option or told[0][told[0].index(halts[0]) - 1] == option
