"""The oracle: bodies go to the true targets, in a simulation only, and nothing else is told."""

import msgspec
import pytest

from deploy.cli import scenario_file
from deploy.oracle import OracleLaw
from deploy.scenario import FaultSettings, Scenario, refuse_oracle, resolve
from deploy.simulation import Simulation
from protocol.settings import BadSetting

SMALL = {"team.composition": "A6", "targets.count": 3, "run.seconds": 12.0, "run.dt": 0.25}


def scenario(mode: str) -> Scenario:
    return resolve("convergence", {**SMALL, "control.mode": mode})


def test_the_oracle_keeps_every_target_in_view_where_it_has_more_sensors_than_targets() -> None:
    """At 2 m/s a body is anywhere in the arena of 40 m within 12 s, or nearly."""
    simulation = Simulation(scenario("oracle"))
    simulation.run()
    last = simulation.scorer.scores[-1]
    assert (last.in_view, last.targets) == (3, 3)


def test_no_target_is_left_to_a_body_whose_agent_has_died() -> None:
    """Four bodies are left for three targets that stand still."""
    faults = tuple(FaultSettings(at=2.0, verb="kill", who=name) for name in ("s1", "s2"))
    standing = {"targets.speed": 0.0, "targets.border": "reflect", "filter.border": "reflect", "run.seconds": 20.0}
    simulation = Simulation(msgspec.structs.replace(resolve("convergence", {**SMALL, **standing, "control.mode": "oracle"}), faults=faults))
    simulation.run()
    assert len(simulation.scorer.result(0.0).kills) == 2
    assert simulation.scorer.scores[-1].in_view == 3
    law = simulation.agents["s3"].context.law
    assert isinstance(law, OracleLaw) and not {"s1", "s2"} & {name for name in simulation.agents if law._oracle.goal(name)}


def test_standing_bodies_do_not() -> None:
    simulation = Simulation(scenario("static"))
    simulation.run()
    assert simulation.scorer.scores[-1].in_view < 3


def test_a_live_run_with_the_oracle_is_refused_in_one_line() -> None:
    with pytest.raises(BadSetting, match=r"control.mode = 'oracle': .*covey simulate"):
        refuse_oracle(scenario("oracle"))
    refuse_oracle(scenario("lloyd"))


def test_check_names_a_certificate_that_is_missing_here(capsys: pytest.CaptureFixture[str]) -> None:
    found = scenario("lloyd")
    network = msgspec.structs.replace(found.network, ca="nokeys/ca.pem", certificate="nokeys/{name}.pem", key="nokeys/{name}.key")
    assert scenario_file.check(msgspec.structs.replace(found, network=network)) == 0
    assert "missing    network.ca = 'nokeys/ca.pem': No such file or directory; `covey keys` makes" in capsys.readouterr().out


def test_check_says_that_seconds_which_are_no_multiple_of_dt_are_rounded(capsys: pytest.CaptureFixture[str]) -> None:
    for seconds, dt in ((10.0, 3.0), (10.0, 0.25)):
        scenario_file.check(resolve("quick", {"run.seconds": seconds, "run.dt": dt}))
    said = [line.strip() for line in capsys.readouterr().out.splitlines() if "multiple" in line]
    assert said == ["run.seconds = 10 is no multiple of run.dt: the run lasts 9 s"]


def test_check_prints_remarks_on_given_poses(capsys: pytest.CaptureFixture[str]) -> None:
    scenario_file.check(resolve("quick", {"bodies.poses": {"s1": [1.0, 2.0, 0.0]}}))
    assert "bodies     bodies.poses is not read: bodies.start should be 'given'" in capsys.readouterr().out


def test_check_says_that_a_live_run_refuses_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert scenario_file.check(scenario("oracle")) == 0 and scenario_file.check(scenario("lloyd")) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("control")]
    assert said == ["control    oracle knows the true targets: of `covey simulate` alone, `covey up` refuses it"]
