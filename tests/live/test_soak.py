"""A long run: memory and descriptors of every process stay where they are."""

import time
from pathlib import Path

import numpy as np
import pytest

from tests.live.harness import Covey, rows

pytestmark = [pytest.mark.live, pytest.mark.slow]


def soak(covey: Covey, team: str, rate: str, warm: float, seconds: float, deaths: int = 0) -> tuple[float, float, int]:
    """Let a swarm run, in which agents die and come back; after `warm` s the median and the largest growth of memory of the processes
    that live all the time, MiB/h, and the largest growth of descriptors.
    """
    covey.start("up", "quick", "--team", team, "--rate", rate, "--seconds", "1000000")
    covey.running()
    time.sleep(warm)
    begin, seen, died = time.monotonic(), [], 0
    while (now := time.monotonic()) < begin + seconds:
        if died < deaths and now >= begin + (died + 1) * seconds / (deaths + 1):
            died += 1
            die_and_return(covey, f"s{1 + died % 3}")
        seen.append((time.monotonic() - begin, {pid: figures(pid) for pid in covey.processes()}))
        time.sleep(seconds / 60.0)
    alive = set.intersection(*(set(found) for _, found in seen))
    data = covey.status()
    assert data is not None and all(row["state"] == "running" for row in data["processes"])
    assert covey.run("down")[0] == 0
    times = np.array([at for at, _ in seen]) / 3600.0
    slopes = sorted(float(np.polyfit(times, [found[pid][0] for _, found in seen], 1)[0]) for pid in alive)
    descriptors = max(seen[-1][1][pid][1] - seen[0][1][pid][1] for pid in alive)
    print(f"{len(alive)} processes that lived all the {seconds:.0f} s, {died} deaths and returns, {data['swarm']['tick']} ticks:")
    print(f"RSS slope {slopes[len(slopes) // 2]:.2f} MiB/h in the median, {slopes[-1]:.2f} at most; descriptors + {descriptors} at most")
    return slopes[len(slopes) // 2], slopes[-1], descriptors


def die_and_return(covey: Covey, name: str) -> None:
    """SIGKILL of an agent, and its restart once it is missed."""
    code, _, complaints = covey.run("kill", name)
    assert code == 0, complaints
    covey.wait(lambda data: not rows(data)[name]["alive"])
    code, _, complaints = covey.run("restart", name)
    assert code == 0, complaints
    covey.wait(lambda data: rows(data)[name]["alive"])


def figures(pid: int) -> tuple[float, int]:
    """Resident memory, MiB, and the number of open descriptors."""
    lines = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return int(lines["VmRSS"].split()[0]) / 1024.0, len(list(Path(f"/proc/{pid}/fd").iterdir()))


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_in_two_minutes_memory_hardly_grows_and_descriptors_do_not(covey: Covey) -> None:
    median, most, descriptors = soak(covey, "A2,B6", "1", 30.0, 120.0)
    assert median < 30.0 and most < 120.0 and descriptors <= 2  # MiB/h: half a MiB in a minute is noise, ten are a leak


@pytest.mark.nightly
@pytest.mark.timeout(5400)
def test_in_an_hour_24_agents_grow_by_less_than_a_mebibyte(covey: Covey) -> None:
    """At a quarter of real time, so that it fits beside other work. With deaths it grows by more (docs/evidence/promises.md)."""
    median, _, descriptors = soak(covey, "A6,B18", "0.25", 300.0, 3600.0)
    assert median < 1.0 and descriptors <= 2
