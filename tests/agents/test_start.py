"""What the process of an agent starts with."""

import pytest

from agents.__main__ import start
from agents.backend import PLAIN
from agents.compiled.backend import FAST
from agents.config import AgentConfig
from protocol.settings import BadSetting

TEAM = AgentConfig(members={"s1": "A"})


def test_an_agent_of_its_own_runs_the_compiled_loops_and_plain_numpy_only_where_they_are_switched_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert start(TEAM, "s1", 1).context.backend is FAST
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert start(TEAM, "s1", 1).context.backend is PLAIN


def test_a_stranger_is_refused_before_anything_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.compiled.warmup.warm", lambda: pytest.fail("compiles"))
    with pytest.raises(BadSetting, match=r"--name s9: the roster has no such member; it has s1"):
        start(TEAM, "s9", 1)
