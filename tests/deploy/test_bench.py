"""The benchmarks measure what they say: the central reference tracks as well as the swarm, captured rounds give the results of the run."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from agents.round import run_round
from deploy.bench import central, empty
from deploy.bench.__main__ import bench
from deploy.bench.capture import capture, cold
from deploy.bench.simulations import scale
from deploy.bench.timing import in_turns, median_seconds, table
from deploy.installation import command, environment
from deploy.scenario import Scenario, resolve
from deploy.simulation import Simulation, compiled
from protocol.settings import BadSetting


def small(seconds: float = 30.0) -> Scenario:
    options = {"team.composition": "A2,C3,D2", "arena.width": 40.0, "arena.height": 40.0, "targets.count": 6, "run.seconds": seconds}
    return resolve("efficacy", options)


@pytest.mark.slow
def test_the_central_reference_does_the_same_work() -> None:
    """The swarm is one central filter cut into cells; estimates at borders and starts differ a little."""
    assert central.play(small(), compiled()) == pytest.approx(Simulation(small()).run().steady_ospa, abs=0.5)


def test_a_captured_round_replays_to_the_command_that_was_given() -> None:
    rounds = capture(small(), 20)
    assert len(rounds) == 7
    for captured, again in zip(rounds, cold(rounds)):
        assert run_round(*captured).command == run_round(*again).command


def test_a_table_has_the_columns_of_all_rows() -> None:
    assert table([{"a": 1, "b": 2.5}, {"c": "x"}]).split() == ["a", "b", "c", "1", "2.5", "x"]


def test_cpu_time_is_positive_and_warm_up_is_not_counted() -> None:
    calls: list[int] = []
    assert median_seconds(lambda: calls.append(sum(range(20000))), batches=3) >= 0.0
    assert len(calls) == 4


def test_kinds_of_work_take_turns() -> None:
    done: list[str] = []
    times = in_turns({"a": lambda: done.append("a"), "b": lambda: done.append("b")}, 2)
    assert done == ["a", "b", "a", "b"] and [len(found) for found in times.values()] == [2, 2]


@pytest.mark.slow
def test_ctrl_c_ends_a_benchmark_with_its_swarm_and_leaves_no_folder(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [*command("deploy"), "bench", "live"],
        env={**environment(), "TMPDIR": str(tmp_path)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # as in a terminal, also under `nohup`
        start_new_session=True,
        stderr=subprocess.DEVNULL,
    )
    while not any("the first tick" in log.read_text() for log in tmp_path.glob("tmp*/bench/logs/supervisor.jsonl")):
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(60) == 130
    assert not list(tmp_path.glob("tmp*"))


@pytest.mark.slow
@pytest.mark.nightly
def test_growing_crowds_are_measured_in_the_same_ticks() -> None:
    rows = list(scale((24, 48), enough=50))
    said = [(row["agents"], row["interest"], row["swarms"]) for row in rows]
    assert said == [(24, "all", 2), (24, "neighbours", 2), (48, "all", 1), (48, "neighbours", 1)]
    assert [row["of the smallest"] for row in rows[:2]] == [1.0, 1.0] and rows[0]["listened to"] == 23.0
    assert all(row["ms per agent-round"] > 0.0 and row["certified"] > 0.95 and 4.0 < row["messages"] < 5.5 for row in rows[1::2])


def test_only_real_time_is_measured_for_so_long() -> None:
    with pytest.raises(BadSetting, match="--seconds 5: is for `bench realtime`, from 1 to 86400"):
        bench("codec", False, 5.0)
    with pytest.raises(BadSetting, match="--seconds 0"):
        bench("realtime", False, 0.0)


def test_an_unknown_benchmark_is_refused_by_name() -> None:
    with pytest.raises(BadSetting, match="bench 'speed': should be one of round, simulate"):
        bench("speed", False)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("nix", "bench 'nix': should be one of round, simulate"),
        ("round --seconds 3", "--seconds 3: is for `bench realtime`, from 1 to 86400"),
    ],
)
def test_the_command_becomes_the_program(words: str, line: str) -> None:
    start = [*command("deploy"), "bench", *words.split()]
    done = subprocess.run(start, env=environment(), capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2 and done.stderr.startswith(f"covey: {line}") and done.stderr.count("\n") == 1


def test_agents_with_empty_rounds_say_as_much_and_play_every_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.agent.run_round", empty.play)
    simulation = Simulation(resolve("quick", {"run.seconds": 3.0}))
    result = simulation.run()
    assert (result.rounds, result.ticks) == (6 * 12, 12)
    assert {agent.counters["late"] for agent in simulation.agents.values()} == {0}
