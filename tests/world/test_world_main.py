"""The world process keeps its newest Truth, starts again from it, and says in one line what is wrong with its input."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from deploy.scenario import resolve, toml_text
from protocol import codec
from protocol.fields import pack
from protocol.messages import Halt
from protocol.node import Alive, Started, Timer, received
from protocol.observer_messages import Truth
from protocol.settings import BadSetting
from tests.world.stage import command, config, feed, started
from world.__main__ import end_body, keep_halts, keep_truths, log_counts, read_halt, read_truth
from world.body import Body
from world.config import WorldConfig, WorldRun
from world.halt import Hold
from world.world import World

ROOT = Path(__file__).resolve().parents[2]
CONFIG = WorldConfig(run=WorldRun(start_timeout=1.0), members={"s1": "A"})


def kept_world(path: Path) -> World:
    """A world that keeps its newest Truth in a file."""
    world = World(CONFIG, 1)
    keep_truths(world, path)
    return world


def run_a_little(node: World) -> list[Truth]:
    """Two ticks of real time with one silent agent."""
    effects = node.handle(Started(), 0.0) + node.handle(Alive("agent", "s1", 1), 0.0)
    effects += node.handle(Timer(), 1.0) + node.handle(Timer(), 1.25)
    return [effect for effect in effects if isinstance(effect, Truth)]


def world_process(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "world", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL, check=False)


def test_the_newest_truth_is_kept_and_a_world_can_go_on_from_it(tmp_path: Path) -> None:
    node = kept_world(tmp_path / "truth")
    truths = run_a_little(node)
    kept = read_truth(tmp_path / "truth", "covey")
    assert (kept.tick, truths[-1].tick) == (1, 1)
    assert kept.targets.tobytes() == truths[-1].targets.tobytes()
    assert World(CONFIG, 2, kept).tick == 3
    assert [file.name for file in tmp_path.iterdir()] == ["truth"]


def test_a_file_that_cannot_be_written_does_not_stop_the_world(tmp_path: Path) -> None:
    truths = run_a_little(kept_world(tmp_path / "no such folder" / "truth"))
    assert [truth.tick for truth in truths] == [0, 1]


def test_after_a_failed_write_no_old_truth_is_left_from_which_a_world_would_go_back_in_time(tmp_path: Path) -> None:
    node = kept_world(tmp_path / "truth")
    run_a_little(node)
    assert (tmp_path / "truth").exists()
    (tmp_path / f".{os.getpid()}.truth").mkdir()  # where the next one would be written
    node.handle(Timer(), 1.5)
    assert not (tmp_path / "truth").exists()


def test_a_file_that_is_missing_or_broken_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match=r"--restore .*truth: No such file or directory"):
        read_truth(tmp_path / "truth", "covey")
    (tmp_path / "truth").write_bytes(b"\xc1 nonsense")
    with pytest.raises(BadSetting, match="truth: no kept Truth: "):
        read_truth(tmp_path / "truth", "covey")


def test_the_arrays_of_a_kept_truth_are_checked(tmp_path: Path) -> None:
    bad = Truth(sender="world", incarnation=1, tick=1, time=0.25, targets_bytes=pack(np.array([[np.nan, 0.0]]), "<f8"))
    (tmp_path / "truth").write_bytes(codec.encode(bad))
    with pytest.raises(BadSetting, match="targets: every number"):
        read_truth(tmp_path / "truth", "covey")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[targets]\ncount = -1\n", "targets.count = -1: "),
        ("[members]\ns1 = 'Z'\n", "sensor class 'Z' does not exist"),
        ("[targets]\nmotion = 'wavy'\n", "targets.motion = 'wavy'"),
    ],
)
def test_a_bad_scenario_ends_the_process_with_one_line_and_exit_code_2(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "run.toml").write_text(text)
    done = world_process("--config", str(tmp_path / "run.toml"))
    assert done.returncode == 2
    assert complaint in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_missing_restore_file_ends_the_process_with_exit_code_2(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("")
    done = world_process("--config", str(tmp_path / "run.toml"), "--restore", str(tmp_path / "gone"))
    assert done.returncode == 2
    assert done.stderr.startswith("world: --restore ")


def test_a_level_of_the_logs_that_is_none_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run.toml").write_text("")
    monkeypatch.setenv("COVEY_LOG", "FOO")
    done = world_process("--config", str(tmp_path / "run.toml"))
    assert (done.returncode, done.stderr) == (2, "world: COVEY_LOG FOO: should be DEBUG, INFO or WARNING\n")


def test_a_fresh_start_forgets_what_an_earlier_run_has_kept(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("[members]\ns1 = 'Z'\n")
    (tmp_path / "truth").write_bytes(b"of an earlier run")
    world_process("--config", str(tmp_path / "run.toml"), "--keep", str(tmp_path / "truth"))
    assert not (tmp_path / "truth").exists()


@pytest.mark.parametrize("held", [True, False])
def test_a_world_that_was_halted_stands_when_it_is_started_again_until_the_release(tmp_path: Path, held: bool) -> None:
    first, _ = started(config())
    keep_halts(first.hold, tmp_path / "halt", "covey")
    feed(first, received(Halt(sender="operator-1", incarnation=7, held=True)))
    if not held:
        feed(first, received(Halt(sender="operator-2", incarnation=8, held=False)))
    again, _ = started(config())
    keep_halts(again.hold, tmp_path / "halt", "covey")
    before = dict(again.bodies.poses)
    feed(again, received(Halt(sender="operator-0", incarnation=6, held=not held)))  # an order from before that one
    feed(again, command("s1", 0), command("s2", 0))
    assert again.tick == 1 and (again.bodies.poses == before) == held


def test_a_kept_halt_that_cannot_be_read_is_named_and_lets_nothing_move(tmp_path: Path) -> None:
    (tmp_path / "halt").write_bytes(b"\xc1 nonsense")
    with pytest.raises(BadSetting, match=r"halt: no kept Halt: .*; remove it only when all may move"):
        keep_halts(Hold(), tmp_path / "halt", "covey")
    (tmp_path / "run.toml").write_text("")
    done = world_process("--config", str(tmp_path / "run.toml"), "--keep-halt", str(tmp_path / "halt"))
    assert done.returncode == 2 and "no kept Halt" in done.stderr


def test_the_newest_halt_is_the_one_that_is_kept(tmp_path: Path) -> None:
    hold = Hold()
    keep_halts(hold, tmp_path / "halt", "covey")
    assert not (tmp_path / "halt").exists()
    for incarnation in (2, 5, 3):
        hold.take(Halt(sender="operator-1", incarnation=incarnation, held=incarnation != 3))
    kept = read_halt(tmp_path / "halt", "covey")
    assert (kept.incarnation, kept.held) == (5, True)


def test_a_halt_that_cannot_be_written_says_what_a_restart_will_find(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    hold, blocked = Hold(), tmp_path / f".{os.getpid()}.halt"
    keep_halts(hold, tmp_path / "halt", "covey")
    blocked.mkdir()
    hold.take(Halt(sender="operator-1", incarnation=1, held=True))
    blocked.rmdir()
    hold.take(Halt(sender="operator-1", incarnation=2, held=True))
    blocked.mkdir()
    hold.take(Halt(sender="operator-1", incarnation=3, held=False))
    assert "this halt is not kept, and a restart finds no order" in caplog.messages[0]
    assert "this release is not kept, and the order before it is what a restart finds" in caplog.messages[1]
    assert hold.holds is False and read_halt(tmp_path / "halt", "covey").incarnation == 2


def test_what_was_counted_is_logged_once_when_a_process_ends(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    world, _ = started(config())
    feed(world, command("s1", 5), command("nobody", 0), Timer(), now=5.0)
    log_counts(world)
    end_body(Body(CONFIG, "s1", 1))
    first, second = (vars(record) for record in caplog.records)
    assert (first["ticks_without_command"], first["ignored_commands"], first["rejected_messages"], first["re_anchored"]) == (2, 2, 0, 0)
    assert (second["ticks_without_command"], second["ignored_commands"], second["clock_corrections"]) == (0, 0, 0)


def test_a_world_beside_bodies_of_their_own_and_a_body_beside_a_world_are_refused(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text("[bodies]\nhost = 'own'\n[members]\ns1 = 'A'\n")
    (tmp_path / "world.toml").write_text("[members]\ns1 = 'A'\n")
    central = world_process("--config", str(tmp_path / "own.toml"))
    assert (central.returncode, central.stdout) == (2, "") and "bodies.host = 'own': every agent has a body process" in central.stderr
    body = world_process("--body", "s1", "--config", str(tmp_path / "world.toml"))
    assert (body.returncode, body.stdout) == (2, "") and "bodies.host = 'world': should be 'own' for --body" in body.stderr


class Unplugged:
    """A platform whose cable has come loose."""

    def __init__(self, name: str) -> None:
        self.stop = self.drive = lambda *_: None

    def read(self, tick: int) -> None:
        raise OSError("no such port")


def test_the_body_of_a_platform_that_fails_ends_with_a_code_after_which_it_is_started_again(tmp_path: Path) -> None:
    platform = f"{__name__}:{Unplugged.__name__}"
    settings = {"team.composition": "A1", "bodies.host": "own", "bodies.platform": platform, "bodies.epoch": time.time()}
    (tmp_path / "run.toml").write_text(toml_text(resolve("quick", settings)))
    done = world_process("--body", "s1", "--config", str(tmp_path / "run.toml"))
    assert done.returncode == 1
    assert "raised OSError: no such port (test_world_main.py, line " in done.stderr.splitlines()[-1]
