"""A run says what happens where it happens: at its pace, in its sentences, at its end, in a terminal and without one."""

import fcntl
import json
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
import urllib.request

import pytest

from deploy.scenario import resolve
from deploy.scoring.scores import read_scores
from deploy.simulation import Simulation
from tests.live.harness import BOUND, PATIENT, ROOT, Covey, rows

pytestmark = pytest.mark.live
FEW = ("quick", "--team", "A3", "--seconds", "100000", "--rate", "4")


class Terminal:
    """A command in a terminal of its own, where somebody may sit."""

    def __init__(self, covey: Covey, *words: str, **variables: str) -> None:
        self._screen, keyboard = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "deploy", *words],
            cwd=covey.folder,
            env={**os.environ, "PYTHONPATH": str(ROOT), "COVEY_RUNS": str(covey.runs), "TERM": "xterm", "COLUMNS": "160", **variables},
            stdin=keyboard,
            stdout=keyboard,
            stderr=keyboard,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        os.close(keyboard)
        self.shown = ""

    def read(self, word: str) -> str:
        """What has been shown once a word has come."""
        end = time.monotonic() + BOUND
        while word not in self.shown:
            assert time.monotonic() < end and self._take(1.0), f"never shown: {word}; {self.shown[-2000:]}"
        return self.shown

    def _take(self, seconds: float) -> bool:
        """Take what is shown within some time; False when the command has left its terminal."""
        if not select.select([self._screen], [], [], seconds)[0]:
            return True
        try:
            self.shown += os.read(self._screen, 65536).decode(errors="replace")
        except OSError:
            return False
        return True

    def press(self, keys: bytes) -> None:
        os.write(self._screen, keys)

    def end(self) -> int:
        """The exit code, all output read."""
        while self._take(0.05) or self.process.poll() is None:
            pass
        os.close(self._screen)
        return self.process.wait(BOUND)


def frame_at(url: str) -> dict[str, object]:
    with urllib.request.urlopen(f"{url}api/frame", timeout=20.0) as answer:
        found: dict[str, object] = json.load(answer)
    return found


def address_in(text: str) -> str:
    return text.split("page: ")[1].split()[0]


@pytest.mark.slow
def test_the_pace_of_a_lockstep_run_changes_no_bit_of_it(covey: Covey) -> None:
    result = covey.result("up", "quick", "--lockstep", "--seconds", "10", "--set", "run.max_rate=5", *PATIENT)
    assert result["transcript"] == Simulation(resolve("quick", {"run.seconds": 10.0})).run().transcript
    assert result["tick_rate"]["asked_per_s"] == 5.0 / result["dt"]
    assert result["tick_rate"]["ticks_per_s"] <= 1.05 * result["tick_rate"]["asked_per_s"]


ENDS = [
    pytest.param(b"\r", None, id="Enter"),
    pytest.param(b"\x03", None, id="Ctrl-C", marks=pytest.mark.nightly),
    pytest.param(b"", signal.SIGTERM, id="TERM", marks=pytest.mark.nightly),
]


@pytest.mark.slow
@pytest.mark.parametrize(("key", "number"), ENDS)
def test_in_a_terminal_the_end_of_a_demo_stays_with_its_page_until_a_key(covey: Covey, key: bytes, number: signal.Signals | None) -> None:
    terminal = Terminal(covey, "demo", "--fast", "--team", "A4", "--seconds", "10", "--page", "0")
    shown = terminal.read("until Enter or Ctrl-C")
    assert "OSPA, mean / steady / final" in shown and "took its cell within" in shown
    assert covey.processes() - {terminal.process.pid} == set()  # nobody but the command is left
    last = frame_at(address_in(shown))
    states = [agent["state"] for agent in last["agents"]]  # type: ignore[attr-defined]
    assert (last["over"], states.count("dead"), states.count("alive")) == (True, 3, 1)  # the last good frame, in which three have died
    assert covey.run("down")[0] == 2  # the run itself is over
    terminal.press(key) if number is None else terminal.process.send_signal(number)
    assert terminal.end() == 0


@pytest.mark.slow
def test_without_a_terminal_a_demo_ends_by_itself(covey: Covey) -> None:
    code, output, _ = covey.run("demo", "--fast", "--team", "A4", "--seconds", "5", "--page", "0")
    assert code == 0
    assert "until Enter" not in output
    covey.wait_until_gone()


@pytest.mark.slow
def test_open_opens_the_browser_that_the_user_has_and_says_so_where_there_is_none(covey: Covey) -> None:
    browser = covey.folder / "browser"
    browser.write_text(f"#!/bin/sh\necho $1 > {covey.folder}/opened\n")
    browser.chmod(0o755)
    words = ("up", "quick", "--lockstep", "--team", "A2", "--seconds", "2", "--page", "0", "--open")
    process = covey.start(*words, variables={"BROWSER": str(browser), "DISPLAY": ""})
    output, _ = process.communicate(timeout=BOUND)
    assert (covey.folder / "opened").read_text().strip() == address_in(output)
    process = covey.start(*words, variables={"BROWSER": "", "DISPLAY": "", "WAYLAND_DISPLAY": ""})
    output, _ = process.communicate(timeout=BOUND)
    assert f"--open: no display here to open a browser on; open {address_in(output)} by hand" in output


@pytest.mark.slow
def test_a_detached_run_says_where_its_page_is(covey: Covey) -> None:
    code, output, _ = covey.run("up", *FEW, "--detach", "--page", "0")
    assert code == 0
    covey.running()
    assert len(frame_at(address_in(output))["agents"]) == 3  # type: ignore[arg-type]
    assert covey.run("down")[0] == 0


@pytest.mark.slow
def test_a_run_that_ctrl_c_stops_prints_its_table_and_where_it_is_kept(covey: Covey) -> None:
    supervisor = covey.start("up", *FEW, "--run", "hunt")
    covey.running()
    supervisor.send_signal(signal.SIGINT)
    output, _ = supervisor.communicate(timeout=BOUND)
    assert supervisor.returncode == 130
    assert "OSPA, mean / steady / final" in output and "kept in runs/hunt" in output
    kept = json.loads(covey.run("runs", "--json")[1])[0]
    assert (kept["name"], kept["state"]) == ("hunt", "interrupted")
    result = json.loads((covey.runs / "hunt" / "result.json").read_text())
    assert result["exit_code"] == 130
    assert [score.tick for score in read_scores(covey.runs / "hunt" / "scores.csv")] == [*range(result["ticks"])]


@pytest.mark.slow
def test_a_world_that_dies_is_said_with_the_command_that_helps(covey: Covey) -> None:
    supervisor = covey.start("up", *FEW, "--run", "hunt")
    os.kill(rows(covey.running())["world"]["pid"], signal.SIGKILL)
    covey.wait(lambda data: rows(data)["world"]["state"] == "dead")
    assert covey.run("restart", "world", "--run", "hunt")[0] == 0
    assert covey.run("down")[0] == 0
    output, _ = supervisor.communicate(timeout=BOUND)
    assert "world died: killed by SIGKILL; the swarm stands still until `covey restart world --run hunt`, after 60 s" in output
    assert supervisor.returncode == 0


HURRY = """
import sys
if "up" in sys.orig_argv:
    from deploy.live import supervisor
    supervisor.WORLD_SECONDS = 2.0
"""


@pytest.mark.slow
def test_without_a_terminal_a_run_whose_world_nobody_restarts_ends_with_1(covey: Covey) -> None:
    (covey.folder / "sitecustomize.py").write_text(HURRY)
    supervisor = covey.start("up", *FEW, "--run", "hunt", variables={"PYTHONPATH": f"{covey.folder}:{ROOT}"})
    os.kill(rows(covey.running())["world"]["pid"], signal.SIGKILL)
    output, complaints = supervisor.communicate(timeout=BOUND)
    assert (supervisor.returncode, complaints) == (1, "")
    assert "until `covey restart world --run hunt`, after 2 s without it the run ends" in output
    assert "the world has been dead for 2 s and nobody has restarted it: the run ends" in output
    assert "OSPA, mean / steady / final" in output
    covey.wait_until_gone()


@pytest.mark.slow
def test_an_agent_that_is_stopped_from_outside_is_paused_and_goes_on_when_it_is_let(covey: Covey) -> None:
    supervisor = covey.start("up", *FEW)
    pid = rows(covey.running())["s1"]["pid"]
    os.kill(pid, signal.SIGSTOP)
    data = covey.wait(lambda data: not rows(data)["s1"]["alive"])  # its token is lost after the lease
    assert (rows(data)["s1"]["state"], rows(data)["s1"]["paused"]) == ("paused", True)
    os.kill(pid, signal.SIGCONT)
    covey.wait(lambda data: rows(data)["s1"]["state"] == "running" and rows(data)["s1"]["alive"])
    assert covey.run("down")[0] == 0
    output, _ = supervisor.communicate(timeout=BOUND)
    assert "s1 has been stopped from outside; `covey resume s1` lets it go on" in output
    assert "s1 goes on, told from outside" in output and "died" not in output


LAW = "import os\nclass Bad:\n    def command(self, situation):\n        if situation.tick == 9 and situation.name == 's2':\n"
GOOD = "        return (0.0, 0.0), 0.0\n"
BAD = ("up", "quick", "--lockstep", "--team", "A3", "--seconds", "10", "--set", "control.mode=mine:Bad")


@pytest.mark.slow
def test_a_class_of_the_users_that_raises_in_the_middle_of_a_run_ends_it_with_one_line_and_2(covey: Covey) -> None:
    (covey.folder / "mine.py").write_text(LAW + "            raise ZeroDivisionError('no way')\n" + GOOD)
    code, _, complaints = covey.run(*BAD)
    assert code == 2
    assert "mine:Bad.command" in complaints and "no way" in complaints and "Traceback" not in complaints
    result = json.loads((covey.runs / "latest" / "result.json").read_text())
    assert result["exit_code"] == 2 and 0 < result["ticks"] < 40  # what came before is kept


@pytest.mark.slow
def test_an_agent_that_crashes_says_its_last_line_and_the_run_goes_on_and_ends_with_1(covey: Covey) -> None:
    (covey.folder / "mine.py").write_text(LAW + "            os.write(2, b'a last line\\n')\n            os._exit(1)\n" + GOOD)
    code, output, _ = covey.run(*BAD)
    assert code == 1
    assert "s2 died: exit code 1: a last line" in output
    result = json.loads((covey.runs / "latest" / "result.json").read_text())
    assert (result["exit_code"], result["ticks"]) == (1, 40)
    assert json.loads(covey.run("runs", "--json")[1])[0]["state"] == "failed"


@pytest.mark.slow
def test_a_paused_agent_is_paused_everywhere_and_the_dead_own_no_cell(covey: Covey) -> None:
    supervisor = covey.start("up", *FEW, "--page", "0", "--record")
    assert supervisor.stdout is not None
    url = address_in(supervisor.stdout.readline())
    covey.running()
    assert covey.run("pause", "s1")[0] == 0
    data = covey.wait(lambda data: not rows(data)["s1"]["alive"])  # its token is lost after the lease
    assert (rows(data)["s1"]["state"], rows(data)["s1"]["paused"], rows(data)["s1"]["cell"]) == ("paused", True, 0.0)
    page = {agent["name"]: agent["state"] for agent in frame_at(url)["agents"]}  # type: ignore[attr-defined]
    assert page["s1"] == "paused"
    assert covey.run("kill", "s2")[0] == 0
    data = covey.wait(lambda data: not rows(data)["s2"]["alive"])
    assert (rows(data)["s2"]["cell"], rows(data)["s2"]["mass"], rows(data)["s2"]["targets"]) == (0.0, 0.0, 0)
    assert covey.run("resume", "s1")[0] == 0
    back = rows(covey.wait(lambda data: rows(data)["s1"]["alive"] and rows(data)["s1"]["cell"] > 0.0))["s1"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] >= back)  # it is told when that tick is scored
    assert covey.run("down")[0] == 0
    output = supervisor.stdout.read()
    assert supervisor.wait(BOUND) == 0
    result = json.loads((covey.runs / "latest" / "result.json").read_text())
    assert [kill["name"] for kill in result["kills"]] == ["s2"]
    assert "s1 is paused at " in output and "s2 died at " in output and "s1 is back: " in output
    assert [kill["name"] for kill in covey.result("score", "latest")["kills"]] == ["s2"]


@pytest.mark.slow
@pytest.mark.nightly
def test_a_machine_that_is_too_small_is_said_in_the_terminal_in_ps_and_in_the_result(covey: Covey) -> None:
    """Two agents that are asked for 4000 rounds a second each: no machine is large enough."""
    supervisor = covey.start("up", "quick", "--team", "A2", "--rate", "1000", "--seconds", "100000")
    covey.wait(lambda data: data["swarm"]["tick_rate"]["advice"] != "")
    assert "this machine is too small for 2 agents at rate 1000" in " ".join(covey.run("ps")[1].split())
    assert covey.run("down")[0] == 0
    output, _ = supervisor.communicate(timeout=BOUND)
    first, later = output.index("2 agents at 4000 ticks/s will be late"), output.index("this machine is too small for 2 agents")
    assert first < later
    rate = json.loads((covey.runs / "latest" / "result.json").read_text())["tick_rate"]
    assert rate["asked_per_s"] == 4000.0 and rate["ticks_per_s"] < 4000.0 and "--rate" in rate["advice"]
