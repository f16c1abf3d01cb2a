"""Wall clocks that jump under running processes. Covey measures time with the monotonic clock, which no administrator can set."""

import json
import mmap
import shutil
import struct
import subprocess
import time
from pathlib import Path

import pytest

from deploy.scenario import resolve
from deploy.simulation import simulate
from tests.live.harness import PATIENT, Covey

COMPILER = shutil.which("cc")
pytestmark = [
    pytest.mark.live,
    pytest.mark.slow,
    pytest.mark.skipif(COMPILER is None, reason="there is no C compiler on this machine: apt-get install gcc"),
]
JUMP = 288
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


def test_wall_clocks_that_jump_by_288_s_back_and_forth_in_the_middle_of_a_run_change_nothing(covey: Covey) -> None:
    assert COMPILER is not None
    library, file = covey.folder / "jump.so", covey.folder / "jump"
    (covey.folder / "jump.c").write_text(SHIM)
    subprocess.run([COMPILER, "-shared", "-fPIC", "-O1", "-o", str(library), "jump.c"], cwd=covey.folder, check=True)
    file.write_bytes(bytes(8))
    words = ("up", "quick", "--lockstep", "--seconds", "150", "--json", *PATIENT)
    supervisor = covey.start(*words, variables={"LD_PRELOAD": str(library), "TEST_JUMP": str(file)})
    before = covey.wait(lambda data: data["swarm"]["tick"] >= 40)["swarm"]["tick"]
    with file.open("r+b") as opened, mmap.mmap(opened.fileno(), 8) as shared:
        shared[:] = struct.pack("l", JUMP)
    output, complaints = supervisor.communicate(timeout=300)
    assert supervisor.returncode == 0, complaints
    result = json.loads(output.splitlines()[-1])
    assert before < result["ticks"] == 600 and result["kills"] == []
    assert result["transcript"] == simulate(resolve("quick", {"run.seconds": 150.0})).transcript
    for log in (covey.runs / "latest" / "logs").glob("s*.jsonl"):
        assert abs(json.loads(log.read_text().splitlines()[-1])["time"] - time.time()) > JUMP - 100.0, Path(log).name
