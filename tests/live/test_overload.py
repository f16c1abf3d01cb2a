"""Real processes that are all stopped at once: none of those that wake up takes the others for dead."""

import contextlib
import os
import signal
import statistics
import time

import pytest

from protocol.node import Gone
from protocol.observer_messages import Estimate
from tests.live.harness import Covey, Journal

pytestmark = [pytest.mark.live, pytest.mark.slow, pytest.mark.alone]
FROZEN = 3.0  # s
SETTLED = 1.0  # s after the freeze, from when on each place has one claim
CLOSED = 1e-6  # of the area
ADOPTED = 0.05  # of the area: less than half of a cell; whoever is taken for dead loses a whole one to the others


def send(number: signal.Signals, pids: set[int]) -> None:
    """Send a signal to all of these processes."""
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)


@pytest.mark.parametrize(
    "words", [pytest.param((), marks=pytest.mark.nightly), ("--set", "network.lease=2")], ids=["lease as set", "lease shorter"]
)
def test_a_freeze_of_all_processes_makes_nobody_dead(covey: Covey, words: tuple[str, ...]) -> None:
    covey.start("up", "ledger.toml", "--rate", "1", "--seconds", "1000", "--record", *words)
    covey.wait(lambda data: data["swarm"]["tick"] >= 20)
    pids = covey.processes()
    assert len(pids) >= 10  # eight agents, the world, the supervisor
    send(signal.SIGSTOP, pids)
    time.sleep(FROZEN)
    send(signal.SIGCONT, pids)
    end = time.time()
    back = covey.status()["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > back + 24)
    assert covey.run("down")[0] == 0

    journal = Journal(covey)
    estimates = journal.said(Estimate, end)
    first = min(message.tick for at, message in estimates if at >= end + SETTLED)
    vanished = [event.name for at, event in journal.heard if isinstance(event, Gone) and event.role == "agent" and at < end + 5.0]
    assert bool(vanished) == bool(words)  # with the shorter lease all links really went down
    scores = journal.after(min(message.tick for _, message in estimates))
    print(f"largest hole and overlap since: {max(score.hole for score in scores):.1e}, {max(score.overlap for score in scores):.1e}")
    assert max(max(score.hole, score.overlap) for score in scores) <= ADOPTED
    settled = [score for score in scores if score.tick >= first]
    assert statistics.median(max(score.hole, score.overlap) for score in settled) <= CLOSED
    assert statistics.median(journal.masses(first)) == pytest.approx(1.0, abs=0.01)
