"""A long run: memory and descriptors of every process stay where they are."""

import time
from pathlib import Path

import numpy as np
import pytest

from tests.live.harness import Covey

pytestmark = [pytest.mark.live, pytest.mark.slow]


def soak(covey: Covey, team: str, warm: float, seconds: float) -> tuple[float, float, int]:
    """Let a swarm run; its median and largest growth of memory, MiB/h, and the largest growth of descriptors, after `warm` s."""
    covey.start("up", "quick", "--team", team, "--rate", "1", "--seconds", "1000000")
    covey.running()
    time.sleep(warm)
    begin, seen = time.monotonic(), []
    while time.monotonic() < begin + seconds:
        seen.append((time.monotonic() - begin, {pid: figures(pid) for pid in covey.processes()}))
        time.sleep(seconds / 60.0)
    alive = set.intersection(*(set(found) for _, found in seen))
    data = covey.status()
    assert data is not None and all(row["state"] == "running" for row in data["processes"])
    assert covey.run("down")[0] == 0
    times = np.array([at for at, _ in seen]) / 3600.0
    slopes = sorted(float(np.polyfit(times, [found[pid][0] for _, found in seen], 1)[0]) for pid in alive)
    descriptors = max(seen[-1][1][pid][1] - seen[0][1][pid][1] for pid in alive)
    print(
        f"{len(alive)} processes, {seconds:.0f} s: RSS slope {slopes[len(slopes) // 2]:.2f} MiB/h in the median, {slopes[-1]:.2f} at most"
    )
    return slopes[len(slopes) // 2], slopes[-1], descriptors


def figures(pid: int) -> tuple[float, int]:
    """Resident memory, MiB, and the number of open descriptors."""
    lines = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return int(lines["VmRSS"].split()[0]) / 1024.0, len(list(Path(f"/proc/{pid}/fd").iterdir()))


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_in_two_minutes_memory_hardly_grows_and_descriptors_do_not(covey: Covey) -> None:
    median, most, descriptors = soak(covey, "A2,B6", 30.0, 120.0)
    assert median < 30.0 and most < 120.0 and descriptors <= 2  # MiB/h: half a MiB in a minute is noise, ten are a leak


@pytest.mark.nightly
@pytest.mark.timeout(5400)
def test_in_an_hour_24_agents_grow_by_less_than_a_mebibyte(covey: Covey) -> None:
    median, _, descriptors = soak(covey, "A6,B18", 300.0, 3600.0)
    assert median < 1.0 and descriptors <= 2
