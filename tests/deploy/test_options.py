"""Options of the command line become settings of the scenario."""

import pytest

from deploy.cli.options import RunOptions, parse_kill
from deploy.scenario import FaultSettings
from protocol.settings import BadSetting


def test_options_lie_over_the_file_and_the_rest_stays() -> None:
    options = RunOptions(seed=9, team="A1,B2", targets=5, dt=0.5, seconds=10.0, lockstep=True, kill=["30%@5"], settings=["filter.gate=4"])
    scenario = options.scenario("convergence")
    assert (scenario.run.seed, scenario.run.dt, scenario.run.ticks, scenario.run.clock) == (9, 0.5, 20, "lockstep")
    assert scenario.members == {"s1": "A", "s2": "B", "s3": "B"}
    assert (scenario.targets.count, scenario.filter.gate, scenario.arena.width) == (5, 4.0, 40.0)
    assert scenario.faults == (FaultSettings(at=5.0, verb="kill", who="30%"),)


def test_a_rate_means_real_time() -> None:
    scenario = RunOptions(rate=2.0).scenario("quick")
    assert (scenario.run.clock, scenario.run.rate) == ("realtime", 2.0)


@pytest.mark.parametrize(
    ("text", "who", "at"), [("30%@300", "30%", 300.0), ("4@0", "4", 0.0), ("s3@50.5", "s3", 50.5), ("s3,s4@1e2", "s3,s4", 100.0)]
)
def test_a_kill_says_who_and_when(text: str, who: str, at: float) -> None:
    assert parse_kill(text) == FaultSettings(at=at, verb="kill", who=who)


@pytest.mark.parametrize("text", ["", "@", "30%", "@300", "s3@", "s3@soon", "s3@-1", "s3@nan", "s3@inf"])
def test_a_kill_that_cannot_be_read_says_how_it_should_read(text: str) -> None:
    with pytest.raises(BadSetting, match=r"--kill .*should read who@when"):
        parse_kill(text)


def test_a_kill_of_somebody_unknown_is_refused_before_anything_starts() -> None:
    with pytest.raises(BadSetting, match="s77"):
        RunOptions(kill=["s77@1"]).scenario("quick")


def test_loss_and_delay_are_faults_from_the_start_and_allow_link_faults() -> None:
    scenario = RunOptions(loss=0.1, delay=0.5).scenario("quick")
    assert scenario.faults == (FaultSettings(at=0.0, verb="drop", value=0.1), FaultSettings(at=0.0, verb="delay", value=0.5))
    assert scenario.network.link_faults and not RunOptions().scenario("quick").network.link_faults


@pytest.mark.parametrize("options", [RunOptions(loss=1.5), RunOptions(loss=-0.1), RunOptions(delay=-1.0)])
def test_an_impossible_loss_or_delay_is_refused(options: RunOptions) -> None:
    with pytest.raises(BadSetting, match=r"--(loss|delay)"):
        options.scenario("quick")
