"""However a run ends, nobody is left: signals, a killed supervisor, a killed zygote; and runs side by side leave each other alone."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deploy.scenario import resolve
from deploy.simulation import Simulation
from tests.live.harness import BOUND, PATIENT, ROOT, Covey

pytestmark = pytest.mark.live
FEW = ("up", "quick", "--team", "A2", "--seconds", "100000", "--rate", "4")
GONE = 3.0  # s, in which all must be gone (the failure model); it takes some 0.2 s


def sockets() -> set[str]:
    return {path.name for path in Path(os.environ.get("TMPDIR", "/tmp"), f"covey-{os.getuid()}").glob("*.sock")}


def kill_supervisor(covey: Covey, moment: float | None) -> float:
    """Kill a supervisor, at a moment after its start or once its swarm runs; how long it took until nobody was left, s."""
    supervisor = covey.start(*FEW)
    if moment is None:
        covey.running()
    else:
        time.sleep(moment)
    supervisor.kill()
    begin = time.monotonic()
    covey.wait_until_gone()
    supervisor.communicate()
    return time.monotonic() - begin


@pytest.mark.slow
def test_nobody_survives_a_supervisor_that_is_killed_while_it_starts_or_runs_and_its_socket_is_swept(covey: Covey) -> None:
    for moment in (1.0, None):  # the last one has opened its socket
        kill_supervisor(covey, moment)
    left = {name for name in sockets() if not Path(f"/proc/{name.removesuffix('.sock').rpartition('-')[2]}").exists()}  # by other tests too
    covey.start(*FEW)
    covey.running()
    assert not left & sockets()
    assert covey.run("down")[0] == 0


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("number", [pytest.param(5, marks=pytest.mark.nightly), pytest.param(100, marks=pytest.mark.nightly)])
def test_many_killed_supervisors_leave_no_orphan(covey: Covey, number: int) -> None:
    dice = random.Random(1)
    took = sorted(kill_supervisor(covey, dice.uniform(0.0, 5.0)) for _ in range(number))
    print(f"all gone after {took[number // 2]:.3f} s in the median, {took[-1]:.3f} s at most")
    assert took[number // 2] <= 1.0  # those that were still importing when it happened take as long as that takes


def end_by(covey: Covey, numbers: list[signal.Signals], code: int) -> float:
    """End a run by signals; how long it took until nobody was left, s."""
    supervisor = covey.start(*FEW)
    covey.running()
    begin = time.monotonic()
    for number in numbers:
        supervisor.send_signal(number)
        time.sleep(0.05)
    _, complaints = supervisor.communicate(timeout=60)
    assert (supervisor.returncode, complaints) == (code, "")
    covey.wait_until_gone()
    return time.monotonic() - begin


LATE_SIGNAL = """
import signal, sys
from asyncio.selector_events import BaseSelectorEventLoop
from deploy.__main__ import main

close = BaseSelectorEventLoop.close

def closing(loop):
    close(loop)
    signal.raise_signal(signal.SIGINT)

BaseSelectorEventLoop.close = closing
main()
"""


@pytest.mark.slow
def test_a_signal_while_the_loop_closes_is_no_complaint(tmp_path: Path) -> None:
    command = [sys.executable, "-c", LATE_SIGNAL, "up", "quick", "--team", "A2", "--seconds", "1", "--lockstep"]
    environment = {**os.environ, "COVEY_RUNS": str(tmp_path)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=BOUND, check=False)
    assert (done.returncode, done.stderr) == (0, "")


ENDS = [([signal.SIGINT], 130), ([signal.SIGTERM], 143), ([signal.SIGINT, signal.SIGINT], 130)]


@pytest.mark.slow
@pytest.mark.parametrize("bodies", ["world", pytest.param("own", marks=pytest.mark.nightly)])
def test_a_monitor_that_was_behind_scores_what_was_said_before_the_end(covey: Covey, bodies: str) -> None:
    words = ("convergence", "--lockstep", "--bodies", bodies, "--team", "E4", "--seconds", "15", "--seed", "3", "--set", "run.max_rate=5")
    supervisor = covey.start("up", *words, "--json", *PATIENT)
    covey.running()
    supervisor.send_signal(signal.SIGSTOP)
    end = time.monotonic() + BOUND
    while any("-m\0world\0" in Path(f"/proc/{pid}/cmdline").read_text() for pid in covey.processes()):
        assert time.monotonic() < end
        time.sleep(0.05)
    supervisor.send_signal(signal.SIGCONT)
    output, complaints = supervisor.communicate(timeout=BOUND)
    assert supervisor.returncode == 0, complaints
    scenario = resolve("convergence", {"team.composition": "E4", "run.seconds": 15.0, "run.seed": 3})
    assert json.loads(output.splitlines()[-1])["transcript"] == Simulation(scenario).run().transcript


@pytest.mark.parametrize(
    ("numbers", "code"), [ENDS[0], *(pytest.param(*end, marks=[pytest.mark.slow, pytest.mark.nightly]) for end in ENDS[1:])]
)
def test_a_signal_ends_everybody_within_three_seconds(covey: Covey, numbers: list[signal.Signals], code: int) -> None:
    assert end_by(covey, numbers, code) <= GONE


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(("numbers", "code"), ENDS, ids=["Ctrl-C", "TERM", "Ctrl-C twice"])
def test_twenty_of_twenty_runs_are_gone_in_three_seconds(covey: Covey, numbers: list[signal.Signals], code: int) -> None:
    took = sorted(end_by(covey, numbers, code) for _ in range(20))
    print(f"all gone after {took[10]:.3f} s in the median, {took[-1]:.3f} s at most")
    assert took[-1] <= GONE


@pytest.mark.slow
def test_a_paused_agent_ends_with_the_others(covey: Covey) -> None:
    supervisor = covey.start(*FEW)
    covey.running()
    assert covey.run("pause", "s2")[0] == 0
    supervisor.terminate()
    supervisor.communicate(timeout=60)
    assert supervisor.returncode == 143
    covey.wait_until_gone()


@pytest.mark.slow
def test_a_killed_zygote_takes_its_agents_along_and_they_can_be_started_again(covey: Covey) -> None:
    """The price of the fast start: with `--spawn exec` there is no such process."""
    covey.start(*FEW)
    covey.running()
    zygote = [pid for pid in covey.processes() if b"zygote" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    parents = {int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1]) for pid in zygote}
    os.kill(next(pid for pid in zygote if pid in parents), signal.SIGKILL)
    covey.wait(lambda data: all(row["state"] == "dead" for row in data["processes"] if row["name"] != "world"))
    assert covey.run("restart")[1] == "restarted s1, s2\n"
    covey.wait(lambda data: all(row["alive"] and row["incarnation"] == 2 for row in data["processes"] if row["name"] != "world"))
    assert covey.run("down")[0] == 0
    covey.wait_until_gone()


@pytest.mark.slow
@pytest.mark.nightly  # two of one name do not hear each other either
def test_two_runs_on_one_machine_do_not_hear_each_other(covey: Covey) -> None:
    seeds = (3, 4)
    runs = [
        covey.start("up", "quick", "--lockstep", "--seconds", "15", "--seed", str(seed), "--run", f"r{seed}", "--json", *PATIENT)
        for seed in seeds
    ]
    for seed, process in zip(seeds, runs):
        output, complaints = process.communicate(timeout=300)
        assert process.returncode == 0, complaints
        result = json.loads(output.splitlines()[-1])
        assert result["transcript"] == Simulation(resolve("quick", {"run.seconds": 15.0, "run.seed": seed})).run().transcript
    covey.wait_until_gone()


@pytest.mark.slow
@pytest.mark.nightly
def test_two_runs_of_one_name_in_two_folders_do_not_hear_each_other(covey: Covey, tmp_path: Path) -> None:
    other = Covey(tmp_path / "other")
    runs = [(where, where.start("up", "quick", "--lockstep", "--seconds", "15", "--json", *PATIENT)) for where in (covey, other)]
    try:
        for where, process in runs:
            output, complaints = process.communicate(timeout=300)
            assert process.returncode == 0, complaints
            assert json.loads(output.splitlines()[-1])["transcript"] == Simulation(resolve("quick", {"run.seconds": 15.0})).run().transcript
            where.wait_until_gone()
    finally:
        other.kill_all()
