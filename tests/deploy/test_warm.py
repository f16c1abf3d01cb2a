"""Warming up compiles all that a swarm will call for, whatever befalls it: who compiles in the middle of a round is silent meanwhile."""

import fcntl
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from agents.compiled import cache, warmup
from agents.compiled.cache import folder
from agents.compiled.correction_kernels import correct
from deploy.simulation import compiled

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import sys
from agents.compiled.warmup import warm

def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("agents.")]
    loops = {loop for module in modules for loop in vars(module).values() if hasattr(loop, "signatures")}
    return {(loop.__module__, loop.__name__, str(signature)) for loop in loops for signature in loop.signatures}

warm()
before = compiled()
from deploy.simulation import compiled as fast
from tests.swarm.scene import fault, ledger, tracking, watch
struck = (fault(1.0, "drop", "100%", 0.3, seconds=2.0), fault(3.0, "slow", "s2", 0.6, seconds=2.0), fault(5.0, "kill", "s3", seconds=2.0))
struck += (fault(7.0, "pause", "s4", seconds=2.0), fault(9.0, "partition", "50%", seconds=3.0))
struck += (fault(13.0, "join", "s20", **{"class": "A"}),)
for scene in (ledger(*struck), tracking(*struck), tracking(*struck, timing__interest="neighbours", filter__border="reflect")):
    for clock in ("realtime", "lockstep"):
        watch(scene, clock=clock, backend=fast())
from agents.compiled.cache import loops_on_disk, number_of_loops
assert before and loops_on_disk() == number_of_loops()  # what the progress of the first start counts
print(sorted(compiled() - before))
"""


def test_a_compiler_that_cannot_be_imported_is_an_error_and_makes_no_slow_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "agents.compiled.backend", None)
    with pytest.raises(ImportError, match="None in sys"):
        compiled()


@pytest.mark.slow
def test_after_warming_up_no_fault_makes_anybody_compile() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, text=True, timeout=110, check=False)
    assert (done.stdout, done.returncode) == ("[]\n", 0), done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.nightly  # two compilations of everything; the first start of continuous integration is one too
@pytest.mark.timeout(900)
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core compiles by itself")
def test_two_processes_compile_what_one_loads(tmp_path: Path) -> None:
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    program = (
        "from agents.compiled import warmup; warmup.warm(); import resource; print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime)"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, env=env, capture_output=True, text=True, timeout=880, check=False)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) > 5.0  # s of the second process
    assert len(list(tmp_path.rglob("*.estimate_targets-*.nbc"))) == 1  # for one kind of arguments: what one compiles the other loads
    program = "from agents.compiled.backend import FAST; from agents.compiled import warmup; warmup.warm(); print(warmup.compiled_before())"
    program += "; from agents.compiled.region_kernels import update_regions; print(sum(update_regions.stats.cache_misses.values()))"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, env=env, capture_output=True, text=True, timeout=110, check=False)
    assert done.stdout.split() == ["True", "0"], done.stderr


@pytest.mark.slow
@pytest.mark.nightly
def test_who_finds_loops_that_nobody_has_called_complete_compiles_once_and_says_so_once(tmp_path: Path) -> None:
    shutil.copytree(folder(), tmp_path / "covey" / folder().name, ignore=shutil.ignore_patterns("complete"))
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "COVEY_RUNS": str(tmp_path / "runs")}
    command = [sys.executable, "-m", "deploy", "simulate", "quick", "--seconds", "1"]
    said = [subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=200, check=True).stderr for _ in range(2)]
    assert [text.count("compiling the particle loops") for text in said] == [1, 0]


def test_a_second_process_is_waited_for_while_loops_come_and_not_when_it_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(cache, "folder", lambda: tmp_path)
    monkeypatch.setattr(warmup, "LONGEST", 1.0)
    (tmp_path / "agents").mkdir()
    compiling = "for number in 0 1 2 3 4 5; do touch agents/loop$number.nbi; sleep 0.4; done"
    with subprocess.Popen(["sh", "-c", compiling], cwd=tmp_path) as slow:
        warmup._wait_for(slow)
        assert slow.poll() == 0 and caplog.text == ""
    with subprocess.Popen(["sleep", "100"]) as hung:
        try:
            begin = time.monotonic()
            warmup._wait_for(hung)
            assert hung.poll() is None and time.monotonic() - begin < 20.0
        finally:
            hung.kill()
    assert [record.getMessage() for record in caplog.records] == [
        "the second process that compiles has made no loop for 1 s: it is ended, and its part compiled here"
    ]


@pytest.mark.slow
def test_who_warms_up_while_another_does_waits_for_it() -> None:
    program = "from agents.compiled.warmup import warm; print('begins', flush=True); warm(); print('warm')"
    held = os.open(correct.stats.cache_path, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    try:
        waiting = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert waiting.stdout is not None and waiting.stdout.readline() == "begins\n"
        with pytest.raises(subprocess.TimeoutExpired):  # longer than warming up takes where all has been compiled
            waiting.wait(5.0)
    finally:
        os.close(held)
    assert waiting.communicate(timeout=110) == ("warm\n", None)
