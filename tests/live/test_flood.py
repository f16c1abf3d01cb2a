"""One peer that repeats a message ten thousand times a second: the others keep their pace and their memory."""

import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from protocol.messages import Gossip
from protocol.observer_messages import Estimate
from tests.live.harness import ROOT, Covey, Journal

pytestmark = [pytest.mark.live, pytest.mark.slow, pytest.mark.alone]
RATE, SECONDS = 10_000, 6.0
MOST_MEMORY = 20.0  # MiB that a process may take more (the failure model)
FLOOD = """
import sys, time
import zenoh
from protocol import live
from protocol.settings import NetworkSettings

rate, seconds, *seeds = float(sys.argv[1]), float(sys.argv[2]), *sys.argv[3:]
session = live.open_session(NetworkSettings(seeds=tuple(seeds)))
heard = []
ear = session.declare_subscriber("covey/covey/gossip/s1", lambda sample: heard.append(sample.payload.to_bytes()))
while not heard:
    time.sleep(0.01)
ear.undeclare()
voice = session.declare_publisher("covey/covey/gossip/s1", congestion_control=zenoh.CongestionControl.DROP)
source = zenoh.SourceInfo(voice.id, 0)
print("flooding", flush=True)
begin, said = time.monotonic(), 0
while said < rate * seconds:
    while said < min(rate * seconds, (time.monotonic() - begin) * rate):
        voice.put(heard[0], source_info=source)
        said += 1
    time.sleep(0.001)
print(said, flush=True)
session.close()
"""


def memory(covey: Covey) -> dict[int, float]:
    """Resident memory of every process of the run, MiB."""
    found = {}
    for pid in covey.processes():
        lines = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
        found[pid] = int(lines["VmRSS"].split()[0]) / 1024.0
    return found


def test_a_flood_of_ten_thousand_messages_a_second_costs_the_others_neither_their_pace_nor_their_memory(covey: Covey) -> None:
    covey.start("up", "quick", "--run", "covey", "--team", "A1,B2", "--rate", "1", "--seconds", "1000", "--record")
    covey.wait(lambda data: data["swarm"]["tick"] >= 40)
    before = memory(covey)
    command = [sys.executable, "-P", "-c", FLOOD, str(RATE), str(SECONDS), *covey.seeds()]
    flood = subprocess.Popen(command, cwd=ROOT, env={"PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True)
    assert flood.stdout is not None and flood.stdout.readline() == "flooding\n"
    begin, most = time.time(), dict(before)
    while flood.poll() is None:
        most = {pid: max(used, most.get(pid, 0.0)) for pid, used in memory(covey).items()}
        time.sleep(0.2)
    end, said = time.time(), int(flood.stdout.read())
    assert covey.run("down")[0] == 0

    journal = Journal(covey)
    grown = max(most[pid] - before[pid] for pid in before if pid in most)
    calm = [message.round_seconds for _, message in journal.said(Estimate, 0.0, begin) if message.tick >= 8]
    rough = [message.round_seconds for at, message in journal.said(Estimate, begin, end)]
    figures = [1000.0 * float(np.percentile(rounds, 99)) for rounds in (calm, rough)]
    print(f"{said / (end - begin):.0f}/s; memory + {grown:.1f} MiB; p99 of a round {figures[0]:.1f} ms before, {figures[1]:.1f} ms during")
    middle = [1000.0 * statistics.median(rounds) for rounds in (calm, rough)]
    print(f"median of a round {middle[0]:.1f} ms before, {middle[1]:.1f} ms during")
    assert said == RATE * SECONDS and end - begin <= SECONDS / 0.9  # nine tenths of the rate that the promise names
    assert grown < MOST_MEMORY
    assert statistics.median(rough) < 2.0 * np.percentile(calm, 99)
    said_by_s1 = {message.tick for _, message in journal.said(Gossip, begin, end) if message.sender == "s1"}
    assert len(said_by_s1) >= 0.7 * 4.0 * (end - begin)  # its own voice is heard through the flood under its name
    assert statistics.median(score.hole for score in journal.scores.values()) <= 1e-6
