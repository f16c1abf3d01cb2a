"""Wall clocks that jump under running processes. Covey measures time with the monotonic clock, which no administrator can set."""

import json
import mmap
import shutil
import statistics
import struct
import subprocess
import time
from pathlib import Path

import pytest

from deploy.scenario import resolve
from deploy.simulation import Simulation
from protocol.messages import Observation
from tests.live.harness import PATIENT, Covey, Journal, rows

COMPILER = shutil.which("cc")
pytestmark = [
    pytest.mark.live,
    pytest.mark.slow,
    pytest.mark.skipif(COMPILER is None, reason="there is no C compiler on this machine: apt-get install gcc"),
]
JUMP = 288
NAMES = [f"s{number}" for number in range(1, 9)]
SHIM = r"""
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile long *jump; /* s, in a file that all processes share */

static long offset(void) {
    if (!jump) {
        int file = open(getenv("TEST_JUMP"), O_RDONLY);
        jump = mmap(0, sizeof *jump, PROT_READ, MAP_SHARED, file, 0);
        close(file);
    }
    return getpid() % 2 ? *jump : -*jump; /* so that neighbours differ by twice as much */
}

int clock_gettime(clockid_t which, struct timespec *when) {
    long code = syscall(SYS_clock_gettime, which, when);
    if (code == 0 && (which == CLOCK_REALTIME || which == CLOCK_REALTIME_COARSE)) when->tv_sec += offset();
    return code;
}

int gettimeofday(struct timeval *restrict when, void *restrict zone) {
    struct timespec exact;
    int code = clock_gettime(CLOCK_REALTIME, &exact);
    when->tv_sec = exact.tv_sec, when->tv_usec = exact.tv_nsec / 1000;
    return code;
}

time_t time(time_t *when) {
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    if (when) *when = exact.tv_sec;
    return exact.tv_sec;
}
"""


def start_with_clocks(covey: Covey, *words: str) -> "subprocess.Popen[str]":
    """The command; all of its processes read wall clocks that `jump` moves."""
    assert COMPILER is not None
    library, file = covey.folder / "jump.so", covey.folder / "jump"
    (covey.folder / "jump.c").write_text(SHIM)
    subprocess.run([COMPILER, "-shared", "-fPIC", "-O1", "-o", str(library), "jump.c"], cwd=covey.folder, check=True)
    file.write_bytes(bytes(8))
    return covey.start(*words, variables={"LD_PRELOAD": str(library), "TEST_JUMP": str(file)})


def jump(covey: Covey, seconds: int) -> None:
    """Set all wall clocks, half of them forth and half of them back."""
    with (covey.folder / "jump").open("r+b") as opened, mmap.mmap(opened.fileno(), 8) as shared:
        shared[:] = struct.pack("l", seconds)


@pytest.mark.nightly
def test_wall_clocks_that_jump_by_288_s_back_and_forth_in_the_middle_of_a_run_change_nothing(covey: Covey) -> None:
    supervisor = start_with_clocks(covey, "up", "quick", "--lockstep", "--seconds", "80", "--json", *PATIENT)
    before = covey.wait(lambda data: data["swarm"]["tick"] >= 40)["swarm"]["tick"]
    jump(covey, JUMP)
    output, complaints = supervisor.communicate(timeout=300)
    assert supervisor.returncode == 0, complaints
    result = json.loads(output.splitlines()[-1])
    assert before < result["ticks"] == 320 and result["kills"] == []
    assert result["transcript"] == Simulation(resolve("quick", {"run.seconds": 80.0})).run().transcript
    for log in (covey.runs / "latest" / "logs").glob("s*.jsonl"):
        assert abs(json.loads(log.read_text().splitlines()[-1])["time"] - time.time()) > JUMP - 100.0, Path(log).name


@pytest.mark.nightly
@pytest.mark.alone  # it compares ticks with the time at which they were said
def test_bodies_keep_their_ticks_when_clocks_step_by_a_second_and_one_that_starts_with_a_wrong_clock_is_set_right(covey: Covey) -> None:
    """Half of the clocks step by 1 s forth and half of them back; then two bodies are killed and started again by the wrong clocks."""
    epoch, period, again = time.time() + 45.0, 0.25, ("s3", "s6")
    words = ("--bodies", "own", "--set", f"bodies.epoch={epoch:.3f}", "--control", "random", "--seconds", "1000", "--record")
    start_with_clocks(covey, "up", "ledger.toml", "--rate", "1", *words, *PATIENT)
    covey.wait(lambda data: data["swarm"]["tick"] >= 16)
    jump(covey, 1)
    covey.wait(lambda data: data["swarm"]["tick"] >= 32)
    for name in again:
        assert covey.run("kill", f"{name}.body")[0] == 0
        covey.wait(lambda data, name=name: rows(data)[f"{name}.body"]["state"] == "dead")
        assert covey.run("restart", f"{name}.body")[0] == 0
    tick = covey.wait(lambda data: all(row["state"] == "running" for row in data["processes"]))["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] >= tick + 28)
    assert covey.run("down")[0] == 0
    said = Journal(covey).said(Observation)
    steady = [name for name in NAMES if name not in again]
    when = {(message.recipient, message.tick): at for at, message in said}
    ticks = sorted({message.tick for _, message in said})
    middle = {
        tick: statistics.median(found) for tick in ticks if (found := [when[key] for name in steady if (key := (name, tick)) in when])
    }
    off = {name: {tick: when[name, tick] - middle[tick] for tick in ticks if (name, tick) in when and tick in middle} for name in NAMES}
    for name in steady:  # of those that were not started again no tick has moved
        kept = sorted(off[name])
        assert abs(statistics.median(off[name].values())) < 0.5 * period and kept[-1] - kept[0] + 1 - len(kept) < 8, (name, off[name])
    for name in again:
        incarnations = {message.incarnation for _, message in said if message.recipient == name}
        first, *_ = [message.tick for _, message in said if message.recipient == name and message.incarnation == 2]
        late = [seconds for tick, seconds in off[name].items() if tick >= first]
        print(f"{name}: first tick {late[0]:+.2f} s off, the last ones {statistics.median(late[-8:]):+.2f} s")
        assert incarnations == {1, 2} and len(late) > 16
        assert -period - 0.5 <= statistics.median(late[-8:]) <= 0.5 * period, off[name]
