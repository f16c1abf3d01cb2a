"""Faults played on names alone: what changes nothing, what cannot be carried out, and that draws are those of the run."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from deploy.__main__ import app
from deploy.faults.rehearsal import FaultFinding, rehearse
from deploy.scenario import FaultSettings, Scenario, resolve, with_deaths
from deploy.simulation import Simulation


def fault(at: float, verb: str, who: str = "", **more: Any) -> FaultSettings:
    return FaultSettings(at=at, verb=verb, who=who, **more)


def scenario(*faults: FaultSettings, seed: int = 1, **settings: Any) -> Scenario:
    """Four agents for 10 s at four ticks a second."""
    found = resolve("quick", {"team.composition": "A4", "run.seconds": 10.0, "run.seed": seed, "targets.count": 1, **settings})
    return msgspec.structs.replace(found, faults=faults)


@pytest.mark.parametrize(
    ("faults", "found"),
    [
        ([fault(3.0, "restart", "s1")], ["restart at 3 s changes nothing for s1: alive"]),
        ([fault(3.0, "kill", "s1"), fault(3.1, "restart", "s1,s2")], ["restart at 3.25 s changes nothing for s2: alive"]),
        ([fault(3.0, "kill", "s1"), fault(4.0, "kill", "s1")], ["kill at 4 s changes nothing for s1: dead"]),
        ([fault(3.0, "kill", "s1", seconds=1.0), fault(4.0, "pause", "s1")], []),
        ([fault(3.0, "pause", "s1"), fault(4.0, "pause", "s1")], ["pause at 4 s changes nothing for s1: dead or paused"]),
        ([fault(3.0, "resume", "s1")], ["resume at 3 s changes nothing for s1: not paused"]),
        (
            [fault(3.0, "pause", "s1"), fault(4.0, "kill", "s1"), fault(5.0, "resume", "s1")],
            ["resume at 5 s changes nothing for s1: not paused"],
        ),
        ([fault(3.0, "kill", "100%"), fault(4.0, "slow", "s1", value=0.1)], ["slow at 4 s changes nothing for s1: dead"]),
        ([fault(3.0, "kill", "0")], ["kill at 3 s strikes nobody"]),
        ([fault(3.0, "drop", "0%", value=0.1)], ["drop at 3 s strikes nobody"]),
        ([fault(3.0, "restart", "100%")], ["restart at 3 s strikes nobody"]),
        ([fault(3.0, "partition", "100%")], ["partition at 3 s cuts nothing: nobody is on the other side"]),
        ([fault(3.0, "partition", "3", options={"kind": "bridge"})], ["partition at 3 s cuts nothing: nobody is on the other side"]),
        (
            [fault(3.0, "partition", "100%"), fault(2.0, "join", options={"class": "A"})],
            ["partition at 3 s cuts nothing: nobody is on the other side"],
        ),
        ([fault(3.0, "partition", "s1,s2"), fault(3.0, "heal"), fault(3.0, "freeze", value=1.0), fault(3.0, "jump", "1", value=1.0)], []),
        ([fault(2.0, "join", options={"class": "A"}), fault(3.0, "kill", "guest0"), fault(4.0, "restart", "guest0")], []),
        ([fault(3.0, "heal")], ["heal at 3 s changes nothing: all links are clear"]),
        (
            [fault(3.0, "drop", value=0.1), fault(4.0, "heal"), fault(5.0, "heal"), fault(6.0, "throttle", value=0.0)],
            ["heal at 5 s changes nothing: all links are clear", "throttle at 6 s changes nothing: value = 0 only ends an earlier one"],
        ),
        ([fault(3.0, "partition", "s1", seconds=2.0), fault(4.0, "heal")], []),
        ([fault(3.0, "throttle", value=0.0)], ["throttle at 3 s changes nothing: value = 0 only ends an earlier one"]),
        ([fault(3.0, "starve", "1", value=0.5), fault(4.0, "starve", "1", value=0.0), fault(4.0, "drop", value=0.0)], []),
        ([fault(3.0, "kill", "world"), fault(4.0, "restart", "world")], []),
        ([fault(3.0, "pause", "s1", seconds=90.0), fault(9.75, "kill", "s1", seconds=90.0)], []),
    ],
)
def test_what_changes_nothing_is_told(faults: list[FaultSettings], found: list[str]) -> None:
    assert rehearse(scenario(*faults)) == [FaultFinding(text, False) for text in found]


def test_what_too_few_agents_qualify_for_is_refused() -> None:
    faults = fault(3.0, "kill", "3"), fault(4.0, "kill", "2"), fault(5.0, "restart", "3"), fault(6.0, "restart", "1")
    assert rehearse(scenario(*faults)) == [
        FaultFinding("faults[1].who = '2': only 1 agent qualifies at 4 s", True),
        FaultFinding("faults[3].who = '1': only 0 agents qualify at 6 s", True),
    ]


@pytest.mark.parametrize("seed", range(6))
def test_draws_are_those_of_a_simulation(seed: int) -> None:
    faults = (
        fault(1.0, "kill", "2"),
        fault(2.0, "restart", "1"),
        fault(2.5, "twin", "1"),
        fault(3.5, "kill", "1"),
        fault(4.0, "join", "g", options={"class": "A"}),
        fault(5.0, "pause", "50%", seconds=1.0),
        fault(6.5, "kill", "2", seconds=1.0),
        fault(8.0, "kill", "1"),
        fault(9.0, "restart", "s1,s2,s3,s4,g"),
    )
    given = scenario(*faults, seed=seed)
    simulation, alive = Simulation(given), list[str]()

    def note(strike: Any, action: Any) -> None:
        if action.names == ["s1", "s2", "s3", "s4", "g"]:
            alive.extend(name for name in action.names if name in simulation.injector.alive())
        strike(action)

    strike = simulation.injector.strike
    simulation.injector.strike = lambda action: note(strike, action)  # type: ignore[method-assign]
    simulation.run()
    assert [finding.text for finding in rehearse(given)] == [f"restart at 9 s changes nothing for {', '.join(alive)}: alive"]


def test_check_and_simulate_say_what_changes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "idle.toml"
    file.write_text("[run]\nseconds = 2.0\n[team]\ncomposition = 'A2'\n[[faults]]\nat = 1.0\nverb = 'restart'\nwho = 's1'\n")
    for command, line in ("check", "faults     restart at 1 s"), ("simulate", "covey: restart at 1 s"):
        assert app([command, str(file)], exit_on_error=False, result_action="return_value") == 0
        assert f"{line} changes nothing for s1: alive\n" in "".join(capsys.readouterr())


def test_a_demo_of_one_agent_kills_nobody() -> None:
    assert with_deaths(scenario(**{"team.composition": "A1"})).faults == ()
    assert [death.who for death in with_deaths(scenario()).faults] == ["3"]
