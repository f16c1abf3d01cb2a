"""What the supervisor answers and decides, without a process of its own: its children are started by nobody."""

import asyncio
from pathlib import Path

import pytest

from deploy.live.supervisor import Supervisor
from deploy.scenario import resolve
from deploy.storage.run_directory import RunDirectory
from protocol.settings import BadSetting


@pytest.fixture
def supervisor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Supervisor:
    return made(tmp_path, monkeypatch)


def made(folder: Path, monkeypatch: pytest.MonkeyPatch, host: str = "world", attended: bool = True) -> Supervisor:
    """A supervisor of two agents whose start has not begun."""
    monkeypatch.setenv("COVEY_RUNS", str(folder))
    directory = RunDirectory("one")
    directory.logs.mkdir(parents=True)
    options = {"run.name": "one", "team.composition": "E2", "bodies.host": host}
    return Supervisor(resolve("quick", options), directory, attended=attended)


def ask(supervisor: Supervisor, verb: str, who: str = "") -> str:
    """The answer of the supervisor in words."""
    return str(asyncio.run(supervisor._answer({"verb": verb, "who": who}))["ok"])


@pytest.mark.parametrize("verb", ["kill", "restart"])
def test_nobody_is_killed_or_restarted_before_it_has_been_started(supervisor: Supervisor, verb: str) -> None:
    with pytest.raises(BadSetting, match="s2 has not been started yet"):
        ask(supervisor, verb, "s2")
    assert supervisor.children["s2"].incarnation == 0


def test_who_has_not_been_started_waits_and_is_not_dead(supervisor: Supervisor) -> None:
    assert ask(supervisor, "restart", "50%") == "nobody to restart"
    assert {row["state"] for row in supervisor.status()["processes"]} == {"waiting"}
    with pytest.raises(BadSetting, match="only 0 agents qualify"):
        ask(supervisor, "restart", "1")
