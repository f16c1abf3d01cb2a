"""What the process of an agent starts with."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

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


def test_an_agent_has_loaded_its_loops_when_it_starts() -> None:
    """In a process of its own, in which no other test has called a loop."""
    program = "from agents.__main__ import start; from agents.config import AgentConfig; start(AgentConfig(members={'s1': 'A'}), 's1', 1)"
    program += "; from agents.compiled.cell_kernels import cut_cells; print(len(cut_cells.signatures))"
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
    done = subprocess.run([sys.executable, "-c", program], env=kept, capture_output=True, text=True, timeout=110, check=False)
    assert done.stdout.strip().isdecimal() and int(done.stdout) > 0, done.stdout + done.stderr


def test_a_stranger_is_refused_before_anything_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.compiled.warmup.warm", lambda: pytest.fail("compiles"))
    with pytest.raises(BadSetting, match=r"--name s9: the roster has no such member; it has s1"):
        start(TEAM, "s9", 1)
    with pytest.raises(BadSetting, match=r"--name world: is the name of another process; should be one of its own"):
        start(TEAM, "world", 1)


def agent_with_cache(folder: Path, at: Path) -> "subprocess.Popen[str]":
    """The process of an agent that keeps its compiled loops in a folder."""
    config = at / "agents.toml"
    config.write_text('[members]\ns1 = "A"\n')
    words = [sys.executable, "-m", "agents", "--name", "s1", "--config", str(config)]
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
    return subprocess.Popen(words, env={**kept, "NUMBA_CACHE_DIR": str(folder)}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_cache_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    agent = agent_with_cache(tmp_path / "file", tmp_path)
    complaints = [line for line in agent.communicate(timeout=60)[1].splitlines() if not line.startswith('{"time"')]
    line = f"agents: {tmp_path / 'file' / 'covey'}: compiled loops cannot be kept there: Not a directory"
    assert agent.returncode == 2 and complaints == [f"{line}; NUMBA_CACHE_DIR names another folder, and NUMBA_DISABLE_JIT=1 does without"]


@pytest.mark.slow
def test_ctrl_c_while_the_loops_are_compiled_ends_the_process_without_a_traceback(tmp_path: Path) -> None:
    agent = agent_with_cache(tmp_path / "cache", tmp_path)
    end = time.monotonic() + 60.0
    while not any(tmp_path.glob("cache/covey/kernels-*/*/*.nbi")):
        assert time.monotonic() < end and agent.poll() is None
        time.sleep(0.05)
    agent.send_signal(signal.SIGINT)
    assert "Traceback" not in agent.communicate(timeout=60)[1]
    assert agent.returncode == 130
