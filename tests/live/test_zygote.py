"""Agents that are forked from the zygote are processes of their own and end with whoever asked for them."""

import os
import signal
import time
from pathlib import Path

import pytest

from deploy.live.processes import child_environment
from deploy.live.zygote import Forked, Zygote

pytestmark = pytest.mark.live


def ended(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


@pytest.fixture
def zygote(tmp_path: Path) -> Zygote:
    made = Zygote(child_environment(), tmp_path / "zygote.log")
    while not made.is_ready:
        made.collect()
        time.sleep(0.02)
    return made


def pid_of(child: Forked) -> int:
    """Its process id, as soon as the zygote has told it."""
    while child.pid is None:
        child.zygote.collect()
    return child.pid


def test_bad_input_ends_the_child_with_code_2_and_one_line(zygote: Zygote, tmp_path: Path) -> None:
    child = zygote.fork(["--name", "s1", "--config", str(tmp_path / "none.toml"), "--supervised"], tmp_path / "s1.log")
    assert child.wait() == 2
    assert "none.toml: there is no such file" in (tmp_path / "s1.log").read_text(encoding="utf-8")
    zygote.close()


def test_a_killed_child_is_reported_and_the_others_live_until_the_zygote_goes(zygote: Zygote, tmp_path: Path) -> None:
    config = tmp_path / "run.toml"
    config.write_text('[members]\ns1 = "A"\ns2 = "A"\n', encoding="utf-8")
    one, other = (zygote.fork(["--name", name, "--config", str(config), "--supervised"], tmp_path / f"{name}.log") for name in ("s1", "s2"))
    assert pid_of(one) != pid_of(other) and os.getpgid(pid_of(one)) == one.pid
    one.kill()
    assert one.wait() == -signal.SIGKILL
    assert other.poll() is None
    zygote.close()
    end = time.monotonic() + 20.0
    while not ended(pid_of(other)) and time.monotonic() < end:
        time.sleep(0.02)
    assert ended(pid_of(other))


@pytest.mark.skipif(not hasattr(os, "SCHED_BATCH"), reason="Linux only")
@pytest.mark.slow
@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_in_lockstep_agents_let_each_other_finish_and_in_real_time_nobody_is_held_back(zygote: Zygote, tmp_path: Path, clock: str) -> None:
    config = tmp_path / "run.toml"
    config.write_text(f'[run]\nclock = "{clock}"\n[members]\ns1 = "A"\n', encoding="utf-8")
    child = zygote.fork(["--name", "s1", "--config", str(config), "--supervised"], tmp_path / "s1.log")
    wanted = os.SCHED_BATCH if clock == "lockstep" else os.SCHED_OTHER
    end = time.monotonic() + 20.0
    while time.monotonic() < end and (threads := policies(pid_of(child))) != {wanted}:
        time.sleep(0.02)
    assert threads == {wanted}
    zygote.close()


def policies(pid: int) -> set[int]:
    """How the threads of a process are scheduled, once Zenoh has some as well."""
    threads = [int(entry.name) for entry in Path(f"/proc/{pid}/task").iterdir()]
    return {os.sched_getscheduler(thread) for thread in threads} if len(threads) > 2 else set()
