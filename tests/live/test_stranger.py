"""The example agent that shares nothing with ours takes a seat in a live swarm, and what it leaves behind is taken over."""

import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from protocol.geometry import polygon_area
from protocol.messages import Command, Gossip
from protocol.node import Gone
from protocol.observer_messages import Estimate, Truth
from tests.live.harness import LEDGER, MASS, PATIENT, ROOT, Covey, Journal, rows

pytestmark = [pytest.mark.live, pytest.mark.slow]
EXAMPLE = ROOT / "deploy" / "examples" / "stranger.py"


def seat(covey: Covey, *words: str) -> subprocess.Popen[str]:
    """The example as a process of its own in the running swarm, with its numbers: degrees, m, probability, s for which it waits."""
    run = Path(os.path.realpath(covey.runs / "latest")).name
    program = [sys.executable, "-P", str(EXAMPLE), run, covey.seeds()[0], "x1", *words]
    environment = {**os.environ, "COVEY_RUNS": str(covey.runs)}
    process = subprocess.Popen(program, cwd=covey.folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    covey.started.append(process)
    return process


def test_a_stranger_takes_a_seat_keeps_what_the_others_believe_and_is_followed_by_them(covey: Covey) -> None:
    """The arena holds no targets and no detections, so the expected number of targets must stay what it is, whoever owns it."""
    (covey.folder / "three.toml").write_text(LEDGER.replace("L8", "L3"))
    covey.start("up", "three.toml", "--run", "seat", "--lockstep", "--set", "run.max_rate=8", "--seconds", "1000", "--record", *PATIENT)
    covey.running()
    stranger = seat(covey, "240", "8", "1e-12", "30")
    there = covey.wait(lambda data: rows(data).get("x1", {}).get("cell", 0.0) > 0.0)
    assert rows(there)["x1"]["state"] == "guest"
    settled = there["swarm"]["tick"]
    killed = covey.wait(lambda data: data["swarm"]["tick"] > settled + 24)["swarm"]["tick"]
    assert stranger.poll() is None, stranger.communicate()
    os.kill(stranger.pid, signal.SIGKILL)
    covey.wait(lambda data: data["swarm"]["tick"] > killed + 24)
    assert covey.run("down")[0] == 0

    journal = Journal(covey)
    gone = journal.tokens(Gone, "x1")[0][0]
    last = max(said.tick for _, said in journal.said(Gossip, end=gone) if said.sender == "x1")
    with_it = [score for tick, score in journal.scores.items() if settled <= tick < last]
    assert len(with_it) > 20
    assert max(score.hole for score in with_it) <= 1e-6 and max(score.overlap for score in with_it) <= 1e-6
    assert [score.mass / MASS for score in with_it] == pytest.approx([1.0] * len(with_it), abs=0.01)
    estimates = [said for _, said in journal.said(Estimate) if settled <= said.tick < last]
    assert {said.sender for said in estimates} == {"s1", "s2", "s3", "x1"}
    assert all(len({said.diagram_hash for said in estimates if said.tick == tick}) == 1 for tick in range(settled, last))
    assert not [name for said in estimates for name in said.counters if name.startswith("rejected.")]
    without = journal.after(last + 6)
    assert without and max(score.hole for score in without) <= 1e-6 and max(score.overlap for score in without) <= 1e-6
    assert [score.mass / MASS for score in without] == pytest.approx([1.0] * len(without), abs=0.02)


def test_when_a_peer_of_ours_dies_the_stranger_takes_its_part_of_the_cell_with_what_was_believed_there(covey: Covey) -> None:
    (covey.folder / "three.toml").write_text(LEDGER.replace("L8", "L3"))
    covey.start("up", "three.toml", "--run", "seat", "--lockstep", "--set", "run.max_rate=8", "--seconds", "1000", "--record", *PATIENT)
    covey.running()
    seat(covey, "240", "8", "1e-12", "30")
    settled = covey.wait(lambda data: rows(data).get("x1", {}).get("cell", 0.0) > 0.0)["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > settled + 8)
    assert covey.run("kill", "s2,s3")[0] == 0
    killed = covey.wait(lambda data: not rows(data)["s2"]["alive"] and not rows(data)["s3"]["alive"])["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > killed + 16)
    assert covey.run("down")[0] == 0

    scores = Journal(covey).after(killed + 6)
    assert len(scores) >= 8 and max(score.hole for score in scores) <= 1e-6 and max(score.overlap for score in scores) <= 1e-6
    assert [score.mass / MASS for score in scores] == pytest.approx([1.0] * len(scores), abs=0.02)


@pytest.mark.nightly
def test_in_real_time_a_stranger_moves_within_the_limits_and_cuts_the_diagram_of_the_others(covey: Covey) -> None:
    words = ("--run", "seat", "--rate", "0.5", "--set", "team.composition=A1,B2", "--seconds", "1000", "--record")
    covey.start("up", "quick", *words, "--set", "network.lease=30")
    covey.running()
    seat(covey, "90", "8", "0.9", "0.4")
    there = covey.wait(lambda data: rows(data).get("x1", {}).get("cell", 0.0) > 0.0)
    settled = there["swarm"]["tick"]
    covey.wait(lambda data: data["swarm"]["tick"] > settled + 24)
    assert covey.run("down")[0] == 0

    journal = Journal(covey)
    truths = [said for _, said in journal.said(Truth) if said.tick >= settled]
    places = [said.poses[said.bodies.index("x1")][:2].tolist() for said in truths]
    assert math.dist(places[0], places[-1]) > 1.0 or max(math.dist(places[0], place) for place in places) > 1.0
    commands = [said for _, said in journal.said(Command) if said.sender == "x1"]
    assert all(math.hypot(*said.velocity) <= 2.0 + 1e-9 and abs(said.turn_rate) <= 5.0 for said in commands)
    estimates = [said for _, said in journal.said(Estimate) if said.tick >= settled and said.sender == "x1"]
    assert max(polygon_area(said.cell) for said in estimates) > 0.0
    views = [{said.diagram_hash for _, said in journal.said(Estimate) if said.tick == tick} for tick in range(settled + 2, settled + 24)]
    assert sum(len(view) == 1 for view in views) >= 18, views  # the clock runs here, and a gossip may be late
