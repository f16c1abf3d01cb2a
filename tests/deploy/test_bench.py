"""The benchmarks measure what they say: the central reference tracks as well as the swarm, captured rounds give the results of the run."""

import pytest

from agents.round import play
from agents.words import learn
from deploy.bench import central
from deploy.bench.capture import capture, cold
from deploy.bench.timing import median_seconds, table
from deploy.commands.benching import bench
from deploy.scenario import Scenario, resolve
from deploy.simulate import compiled, simulate
from protocol.settings import BadSetting


def small(seconds: float = 30.0) -> Scenario:
    options = {"team.composition": "A2,C3,D2", "arena.width": 40.0, "arena.height": 40.0, "targets.count": 6, "run.seconds": seconds}
    return resolve("efficacy", options)


def test_the_central_reference_does_the_same_work() -> None:
    """The swarm is one central filter cut into cells; estimates at borders and starts differ a little."""
    assert central.play(small(), compiled()) == pytest.approx(simulate(small()).steady_ospa, abs=0.5)


def test_a_captured_round_replays_to_the_command_that_was_given() -> None:
    rounds = capture(small(), 20)
    assert len(rounds) == 7
    for captured, again in zip(rounds, cold(rounds)):
        for gossip in (again.mine, *again.heard.values()):
            learn(gossip, captured.heard.get(gossip.sender, captured.mine).memo["sensor"], captured.me.config)
        assert play(*captured).command == play(*again).command


def test_a_table_has_the_columns_of_all_rows() -> None:
    assert table([{"a": 1, "b": 2.5}, {"c": "x"}]).split() == ["a", "b", "c", "1", "2.5", "x"]


def test_cpu_time_is_positive_and_warm_up_is_not_counted() -> None:
    calls: list[int] = []
    assert median_seconds(lambda: calls.append(sum(range(20000))), batches=3) >= 0.0
    assert len(calls) == 4


def test_an_unknown_benchmark_is_refused_by_name() -> None:
    with pytest.raises(BadSetting, match="bench 'speed': should be one of round, simulate"):
        bench("speed", False)
