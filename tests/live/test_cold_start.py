"""The first start on a machine: however long it takes, the swarm is complete, says what it waits for, and ends when told to."""

import json
import re
import signal
import time
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from tests.live.harness import BOUND, ROOT, Covey

pytestmark = pytest.mark.live
SHORT = ("up", "quick", "--seconds", "5", "--lockstep")
FEW = ("up", "quick", "--team", "A2", "--seconds", "100000", "--rate", "4")
GONE = 3.0  # s after Ctrl-C, in which all must be gone
MOMENTS = (0.0, 0.1, 0.3, 0.7, 1.5, 4.0)  # s after the start
LOOPS = (1, 2, 3, 4)  # numbers of the loop that is being compiled
BUSY = 5.0  # times that: other tests run beside this one
SLOW = """
import sys, time
if "deploy.live.zygote" in sys.orig_argv:
    time.sleep(6.0)
"""
SWALLOWING = """
import contextlib, os, signal, time
with contextlib.suppress(KeyboardInterrupt):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1.0)
from protocol.sensing import WedgeSensor

def Sensor():
    return WedgeSensor(2.0, 12.0, 0.9)
"""
DYING = """
import os, signal, sys
from protocol.sensing import WedgeSensor

def dying():
    if "s3" in sys.argv:
        os.kill(os.getpid(), signal.SIGKILL)
    return WedgeSensor(2.0, 12.0, 0.9)
"""


def cold(covey: Covey, number: int = 0) -> dict[str, str]:
    """An environment in which nothing has been compiled."""
    return {"NUMBA_CACHE_DIR": str(covey.folder / f"loops{number}")}


def hears_ctrl_c() -> None:
    """As in a terminal: whoever runs the tests in the background ignores Ctrl-C, and so would all that they start."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def is_compiling(data: dict[str, Any], loop: int) -> bool:
    """Whether a status says that a loop of this number or a later one is being compiled."""
    found = re.match(r"compiling loop (\d+) of", data["swarm"]["waiting"])
    return found is not None and int(found[1]) >= loop


def end_at(covey: Covey, moment: float, loop: int, number: int) -> float:
    """Start where nothing has been compiled, press Ctrl-C at a moment, s, or when a loop is being compiled, if `loop` is not 0.

    Returns how long it took until nobody was left, s.
    """
    process = covey.start(*FEW, variables=cold(covey, number), limit=hears_ctrl_c)
    time.sleep(moment)
    if loop:
        covey.wait(lambda data: is_compiling(data, loop))
    begin = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, complaints = process.communicate(timeout=BOUND)
    covey.wait_until_gone()
    took = time.monotonic() - begin
    if loop or moment >= 1.0:  # before that Python itself may still be starting, and has its own words
        assert complaints == "", moment
        assert process.returncode in (130, -signal.SIGINT), moment  # the same to a shell
    return took


@pytest.mark.slow
@pytest.mark.nightly
def test_a_zygote_that_takes_longer_than_the_start_line_gives_a_complete_swarm(covey: Covey) -> None:
    (covey.folder / "sitecustomize.py").write_text(SLOW)
    variables = {"PYTHONPATH": f"{covey.folder}:{ROOT}"}
    process = covey.start(*SHORT, "--team", "A3", "--set", "run.start_timeout=4", "--json", "--kill", "3@1", variables=variables)
    output, complaints = process.communicate(timeout=2.0 * BOUND)
    assert process.returncode == 0, complaints
    result = json.loads(output.splitlines()[-1])
    assert (result["missing"], result["ticks"], len(result["kills"])) == ([], 20, 3)
    assert "starting: loading the compiled loops" in complaints


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("moments", "loops"),
    [((0.4, 2.5), ()), pytest.param(MOMENTS, LOOPS, marks=pytest.mark.nightly)],
    ids=["two", "ten"],
)
def test_ctrl_c_ends_a_start_at_any_moment(covey: Covey, moments: tuple[float, ...], loops: tuple[int, ...]) -> None:
    when = [(moment, 0) for moment in moments] + [(0.0, loop) for loop in loops]
    for number, (moment, loop) in enumerate(when):
        took = end_at(covey, moment, loop, number)
        print(f"Ctrl-C {f'in loop {loop}' if loop else f'after {moment} s'}: all gone after {took:.2f} s")
        assert took <= BUSY * GONE


def test_ctrl_c_ends_an_import_that_swallows_the_exception(covey: Covey) -> None:
    """As compiled modules of numpy and scipy do, for a few microseconds each."""
    (covey.folder / "swallowing.py").write_text(SWALLOWING)
    process = covey.start("simulate", *SHORT[1:], "--team", "S2", "--set", "sensors.S.model=swallowing:Sensor", limit=hears_ctrl_c)
    output, complaints = process.communicate(timeout=BOUND)
    assert (process.returncode, output, complaints) == (130, "", "")


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_while_it_compiles_terminal_and_page_say_so_and_down_ends_it(covey: Covey) -> None:
    process = covey.start(*FEW, "--page", "0", variables=cold(covey))
    assert process.stdout is not None
    address = process.stdout.readline().split()[1]
    data = covey.wait(lambda data: data["swarm"]["waiting"].startswith("compiling loop"))
    wanted = r"compiling loop \d+ of \d\d, once on this machine \(\d+ s so far\)"
    assert re.fullmatch(wanted, data["swarm"]["waiting"])
    assert [row["state"] for row in data["processes"]] == [
        "running",
        "waiting",
        "waiting",
    ]  # the world, and agents that have not been started
    end = time.monotonic() + BOUND
    while "waiting" not in (frame := json.load(urllib.request.urlopen(f"{address}api/frame", timeout=BOUND))):
        assert time.monotonic() < end, frame
        time.sleep(0.1)
    assert re.fullmatch(wanted, frame["waiting"]) and frame["tick"] == -1
    assert covey.run("down")[0] == 0
    output, complaints = process.communicate(timeout=BOUND)
    assert (process.returncode, complaints) == (0, "")
    assert re.search("starting: " + wanted, output)
    covey.wait_until_gone()


def dying(covey: Covey, *words: str) -> tuple[int, str, str]:
    """A swarm of four, of which s3 dies as soon as it knows its sensor."""
    (covey.folder / "mine.py").write_text(DYING)
    settings = ("--set", "sensors.D.model=mine:dying", "--set", "run.start_timeout=3")
    return covey.run(*SHORT, "--team", "4D", *settings, *words)


@pytest.mark.slow
def test_a_swarm_without_a_member_that_died_at_the_start_says_so(covey: Covey) -> None:
    code, output, complaints = dying(covey, "--json")
    assert code == 0, complaints
    assert "[0.0 s] the run starts with 3 of 4 agents (without s3)" in complaints
    assert "1 of 4: s3" in complaints  # in the table
    assert json.loads(output.splitlines()[-1])["missing"] == ["s3"]


@pytest.mark.slow
def test_a_strict_swarm_refuses_to_start_without_a_member(covey: Covey) -> None:
    code, output, complaints = dying(covey, "--strict")
    assert code == 2
    assert complaints == "covey: s3 died: killed by SIGKILL; --strict refuses to start with fewer than 4 agents\n"
    assert "%" not in output  # no tick was played
    covey.wait_until_gone()


@pytest.mark.slow
@pytest.mark.nightly
def test_a_zygote_that_dies_before_it_is_ready_is_replaced_by_agents_that_start_by_themselves(covey: Covey) -> None:
    (covey.folder / "sitecustomize.py").write_text(SLOW.replace("time.sleep(6.0)", "sys.exit('no room')"))
    process = covey.start(*SHORT, "--team", "A3", "--json", variables={"PYTHONPATH": f"{covey.folder}:{ROOT}"})
    output, complaints = process.communicate(timeout=2.0 * BOUND)
    assert process.returncode == 0, complaints
    assert complaints.count("the process that prepares agents has ended") == 1
    assert json.loads(output.splitlines()[-1])["missing"] == []
    assert "no room" in Path(covey.runs / "latest" / "logs" / "zygote.jsonl").read_text()
