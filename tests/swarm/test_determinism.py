"""The same scenario and seed give the same run, whatever carries it: bytes or objects, plain loops or compiled ones, any hash seed."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from agents.backend import PLAIN, Backend
from agents.tracking.tracker import RegionUpdate
from deploy.simulation import Simulation, compiled
from tests.swarm.scene import fault, tracking, watch

ROOT = Path(__file__).resolve().parents[2]
ROUGH = (fault(1.0, "drop", "100%", 0.2, seconds=5.0), fault(2.0, "kill", "25%", seconds=2.0), fault(4.0, "partition", "3", seconds=2.0))


def transcript(**options: object) -> str:
    result = watch(tracking(*ROUGH, run__seconds=8.0), **options).result
    assert result.ticks == 32
    return result.transcript


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_the_same_seed_gives_the_same_run_under_faults_too(clock: str) -> None:
    assert transcript(clock=clock) == transcript(clock=clock)


def test_another_seed_gives_another_run() -> None:
    runs = [watch(tracking(*ROUGH, run__seconds=8.0, run__seed=seed)).result for seed in (1, 2)]
    assert runs[0].transcript != runs[1].transcript


@pytest.mark.parametrize("interest", ["all", "neighbours"])
def test_taking_what_comes_in_an_instant_together_changes_nothing(interest: str) -> None:
    """The bus hands out messages one by one, or as batches."""
    faults = fault(2.0, "kill", "25%", seconds=2.0), fault(3.0, "pause", "1", seconds=1.0), fault(4.0, "slow", "1", 0.3, seconds=2.0)
    alone, together = [], []
    for said, batches in ((alone, False), (together, True)):
        simulation = Simulation(tracking(*faults, run__seconds=8.0, timing__interest=interest))
        simulation.bus.batches = batches
        result = simulation.run()
        counters = {name: dict(agent.counters) for name, agent in simulation.agents.items()}
        said += [result.transcript, simulation.bus.messages, simulation.bus.deliveries, counters]
    assert alone == together


@pytest.mark.parametrize(
    "backend", [pytest.param(PLAIN, marks=[pytest.mark.slow, pytest.mark.nightly]), compiled()], ids=["plain", "compiled"]
)
def test_what_all_work_out_together_changes_nothing(backend: Backend, monkeypatch: pytest.MonkeyPatch) -> None:
    """A round of all who hear the same in one call, and everybody by himself."""
    calls = []

    def update_regions(*task: Any) -> list[RegionUpdate]:
        calls.append(len(task[3]))
        return backend.update_regions(*task)

    counted = backend._replace(update_regions=update_regions)
    together = transcript(backend=counted)
    assert sum(count > 1 for count in calls) > 10 and max(calls) > 5
    calls.clear()
    monkeypatch.setattr("agents.round.batched_round", lambda *asked: None)
    assert transcript(backend=counted) == together
    assert set(calls) == {1}


def test_compiled_loops_change_nothing() -> None:
    assert compiled() is not PLAIN
    assert transcript(backend=PLAIN) == transcript(backend=compiled())


@pytest.mark.slow
@pytest.mark.nightly
def test_the_order_of_hashes_changes_nothing() -> None:
    program = "from tests.swarm.test_determinism import transcript; from agents.backend import PLAIN; print(transcript(backend=PLAIN))"
    seen = set()
    for hash_seed in ("0", "4711"):
        environment = {**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [sys.executable, "-c", program], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=100, check=True
        )
        seen.add(done.stdout)
    assert seen == {transcript(backend=PLAIN) + "\n"}
