"""What the supervisor answers and decides, without a process of its own: its children are started by nobody."""

import asyncio
import errno
import json
import signal
from pathlib import Path

import pytest

from deploy.faults.faults import Action, Schedule
from deploy.live import supervisor as supervising
from deploy.live.processes import Child
from deploy.live.supervisor import Supervisor
from deploy.scenario import FaultSettings, resolve
from deploy.storage.kept_runs import kept_runs
from deploy.storage.run_directory import RunDirectory
from protocol.node import Alive
from protocol.observer_messages import Truth
from protocol.settings import BadSetting


@pytest.fixture
def supervisor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Supervisor:
    return made(tmp_path, monkeypatch)


def made(
    folder: Path, monkeypatch: pytest.MonkeyPatch, host: str = "world", attended: bool = True, team: str = "E2", **options: object
) -> Supervisor:
    """A supervisor of a team, of two agents by default, whose start has not begun."""
    monkeypatch.setenv("COVEY_RUNS", str(folder))
    directory = RunDirectory("one")
    directory.logs.mkdir(parents=True)
    options = {"run.name": "one", "team.composition": team, "bodies.host": host, **options}
    return Supervisor(resolve("quick", options), directory, print, attended=attended)


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
    with pytest.raises(BadSetting, match=r"^who = '1': only 0 agents qualify"):
        ask(supervisor, "restart", "1")


class Process:
    """A process that runs until it is killed, or that has ended with this code."""

    stdin = None
    pid = None

    def __init__(self, code: int | None = None) -> None:
        self.returncode = code

    def poll(self) -> int | None:
        return self.returncode

    def wait(self) -> int:
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: signal.Signals) -> None:
        """Nothing that ends it."""

    def kill(self) -> None:
        self.returncode = -signal.SIGKILL


def let_run(supervisor: Supervisor, codes: dict[str, int]) -> int | None:
    """Let all processes run, and these end with their codes one after the other; the exit code of the run, None if it goes on."""

    async def run() -> int | None:
        over = supervisor._over = asyncio.get_running_loop().create_future()
        for child in supervisor.children.values():
            child.incarnation, child.process = 1, Process()  # type: ignore[assignment]
        for name, code in codes.items():
            supervisor.children[name].process = Process(code)  # type: ignore[assignment]
            supervisor._reap()
        supervisor._end_standstill()
        return over.result() if over.done() else None

    return asyncio.run(run())


KILLED = -signal.SIGKILL


@pytest.mark.parametrize(
    ("codes", "end"),
    [
        ({"s1.body": KILLED}, None),  # the other body goes on
        ({"s1.body": KILLED, "s2.body": KILLED}, 1),  # nobody attends and nobody has restarted one in time
        ({"s1.body": 0, "s2.body": KILLED}, 0),  # at the last tick
        ({"s1.body": KILLED, "s2.body": 0}, 0),
    ],
)
def test_a_run_of_bodies_ends_with_the_last_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], codes: dict[str, int], end: int | None
) -> None:
    monkeypatch.setattr(supervising, "WORLD_SECONDS", 0.0)
    assert let_run(made(tmp_path, monkeypatch, "own", attended=False), codes) == end
    assert ("stands still until `covey restart s2.body --run one`" in capsys.readouterr().out) == (end == 1)


@pytest.mark.parametrize(("seconds", "end"), [(-100.0, 0), (100.0, None)])
def test_a_run_ends_without_a_body_that_has_not_come_to_the_last_tick_for_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], seconds: float, end: int | None
) -> None:
    """It is paused, or its platform hangs."""
    monkeypatch.setattr(supervising, "LAST_BODY_SECONDS", seconds)
    assert let_run(made(tmp_path, monkeypatch, "own"), {"s1.body": 0}) == end
    assert ("the run is over and ends without s2.body" in capsys.readouterr().out) == (end == 0)


def test_a_run_whose_last_body_refuses_its_input_ends_and_waits_for_no_restart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(BadSetting, match=r"s2\.body ended with exit code 2"):
        let_run(made(tmp_path, monkeypatch, "own", attended=False), {"s1.body": 2, "s2.body": 2})
    told = capsys.readouterr().out
    assert "s2.body died" in told and "stands still" not in told


def test_a_bridge_of_a_partition_is_one_that_is_not_paused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    supervisor = made(tmp_path, monkeypatch, team="E3", **{"network.link_faults": True})
    assert let_run(supervisor, {}) is None
    supervisor.children["s1"].paused = True
    supervisor.operations.act(Action("partition", ["s3"], None, {"kind": "bridge"}))
    assert supervisor.operations._links.reception("s3").cut == ("s1",)


class Unheard:
    """A driver of a monitor that hears nothing; `failure` ends it."""

    unread = 0
    failure: Exception | None = None

    def __init__(self, *_: object) -> None:
        self._over = asyncio.Event()

    async def open(self) -> None: ...

    async def serve(self) -> int:
        if self.failure is not None:
            raise self.failure
        await self._over.wait()
        return 0

    def stop(self, code: int, reason: str) -> None:
        self._over.set()


def test_a_run_that_is_refused_before_a_process_has_started_has_never_begun(
    supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_long(directory: RunDirectory) -> Path:
        raise BadSetting("TMPDIR is too long")

    monkeypatch.setattr(supervising, "Driver", Unheard)
    monkeypatch.setattr(RunDirectory, "socket_path", too_long)
    with pytest.raises(BadSetting, match="TMPDIR"):
        asyncio.run(supervisor.run())
    supervisor.directory.leave_unless_begun()
    assert kept_runs() == [] and not supervisor.directory.path.exists()


def test_who_looks_on_can_tell_that_a_run_is_ended_before_its_processes_are(
    supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    async def end() -> None:
        seen.append(supervisor.directory.control.exists())
        supervisor._end(0)
        await asyncio.sleep(3600.0)

    async def wind_down() -> None:
        seen.append(supervisor.directory.control.exists())

    monkeypatch.setattr(supervising, "Driver", Unheard)
    monkeypatch.setattr(supervising, "LAST_LOOKS", 0)
    monkeypatch.setattr(supervisor._start, "start_all", lambda tell: end())
    monkeypatch.setattr(supervisor, "_wind_down", wind_down)
    assert asyncio.run(supervisor.run()) == 0
    assert seen == [True, False]


@pytest.mark.parametrize(("failure", "code"), [(BadSetting("a wrong sensor"), 2), (ZeroDivisionError("an error of our own"), 1)])
def test_a_run_that_an_error_ends_is_listed_as_failed_whatever_the_error(
    supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch, failure: Exception, code: int
) -> None:
    monkeypatch.setattr(supervising, "Driver", Unheard)
    monkeypatch.setattr(Unheard, "failure", failure)
    monkeypatch.setattr(supervisor._start, "start_all", lambda tell: asyncio.sleep(3600.0))
    with pytest.raises(type(failure)):
        asyncio.run(supervisor.run())
    [kept] = kept_runs()
    assert (kept.state, json.loads(supervisor.directory.result.read_text())["exit_code"]) == ("failed", code)


def fail(*_: object) -> None:
    raise OSError(errno.EAGAIN, "Resource temporarily unavailable")


@pytest.mark.parametrize("name", ["s2", "world"])
def test_a_process_that_cannot_be_restarted_is_told_with_the_reason_and_counts_as_dead(
    supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert let_run(supervisor, {}) is None
    monkeypatch.setattr(Child, "_fork", fail)
    with pytest.raises(BadSetting, match=f"{name} could not be restarted: Resource temporarily unavailable"):
        ask(supervisor, "restart", name)
    assert (supervisor.children[name].end(), supervisor.children[name].is_running) == ("killed by SIGKILL", False)
    assert f"{name} died: killed by SIGKILL" in capsys.readouterr().out
    assert (supervisor._still_since is not None) == (name == "world")


def test_a_pause_of_who_is_paused_and_a_resume_of_who_is_not_are_told(supervisor: Supervisor) -> None:
    assert let_run(supervisor, {}) is None
    with pytest.raises(BadSetting, match="s2 is not paused"):
        ask(supervisor, "resume", "s2")
    assert ask(supervisor, "pause", "s2") == "paused s2"
    with pytest.raises(BadSetting, match="s2 is paused already"):
        ask(supervisor, "pause", "s1,s2")
    assert not supervisor.children["s1"].paused
    assert ask(supervisor, "resume", "s2") == "resumed s2"


def test_an_order_of_which_a_part_is_impossible_does_nothing(supervisor: Supervisor, capsys: pytest.CaptureFixture[str]) -> None:
    assert let_run(supervisor, {"s2": KILLED}) is None
    with pytest.raises(BadSetting, match="s2 is not running; `covey restart s2` brings it back"):
        ask(supervisor, "kill", "s1,s2")
    assert supervisor.children["s1"].process.poll() is None  # type: ignore[union-attr]
    assert "killed" not in capsys.readouterr().out.replace("killed by", "")


def test_the_end_of_a_fault_passes_over_those_who_have_died_meanwhile(supervisor: Supervisor) -> None:
    supervisor.operations._schedule = Schedule(1, (FaultSettings(at=1.0, verb="pause", who="s1,s2", seconds=2.0),))

    async def run() -> list[list[str]]:
        for child in supervisor.children.values():
            child.incarnation, child.process = 1, Process()  # type: ignore[assignment]
        paused = []
        for tick in (4, 12):
            supervisor._on_truth(Truth(sender="world", incarnation=1, tick=tick, time=tick / 4.0))
            paused.append([name for name, child in supervisor.children.items() if child.paused])
            supervisor.children["s2"].process = Process(KILLED)  # type: ignore[assignment]
            supervisor._reap()
        return paused

    assert asyncio.run(run()) == [["s1", "s2"], []]


def test_a_fault_that_too_few_are_left_for_is_told_once_and_the_run_goes_on(
    supervisor: Supervisor, capsys: pytest.CaptureFixture[str]
) -> None:
    supervisor.operations._schedule = Schedule(1, (FaultSettings(at=1.0, verb="kill", who="2"),))
    assert let_run(supervisor, {"s2": KILLED}) is None

    async def run() -> None:
        for tick in (4, 5):
            supervisor._on_truth(Truth(sender="world", incarnation=1, tick=tick, time=tick / 4.0))

    asyncio.run(run())
    told = capsys.readouterr().out
    assert told.count("a fault of the scenario could not be carried out: faults[0].who = '2': only 1 agent qualifies") == 1


def test_a_run_whose_first_process_cannot_be_started_ends_with_the_reason_and_a_result(
    supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Child, "_fork", fail)
    name = next(iter(supervisor.children))
    with pytest.raises(BadSetting, match=f"{name} could not be started: Resource temporarily unavailable"):
        asyncio.run(supervisor.run())
    result = json.loads(supervisor.directory.result.read_text())
    assert (result["exit_code"], result["ticks"], supervisor.directory.scores.exists()) == (2, 0, True)


@pytest.mark.parametrize(
    ("who", "role", "name", "heard", "next_one"),
    [
        ("s2.body", "body", "s2", [7, 5], 8),  # a bridge was the body meanwhile
        ("s2", "agent", "s2", [1_796_000_000_000], 1_796_000_000_001),
        ("s2", "agent", "s1", [7], 2),
        ("s2", "body", "s2", [7], 2),
        ("s2", "agent", "s2", [2**63 - 1], 2**63 - 1),  # there is no larger one
    ],
)
def test_who_is_restarted_follows_the_newest_incarnation_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, who: str, role: str, name: str, heard: list[int], next_one: int
) -> None:
    """Its peers have heard of that one and would refuse a smaller one."""
    supervisor = made(tmp_path, monkeypatch, "own")
    let_run(supervisor, {})
    for incarnation in heard:
        supervisor.scorer.handle(Alive(role, name, incarnation), 0.0)
    monkeypatch.setattr(Child, "_fork", lambda self, extra: None)
    ask(supervisor, "restart", who)
    assert supervisor.children[who].incarnation == next_one


def test_a_world_runs_on_when_the_truth_for_the_next_one_cannot_be_written(supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch) -> None:
    assert let_run(supervisor, {}) is None
    supervisor.scorer.truth = Truth(sender="world", incarnation=1, tick=3, time=0.75)
    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(BadSetting, match="world could not be restarted: Resource temporarily unavailable"):
        ask(supervisor, "restart", "world")
    assert supervisor.children["world"].is_running


def test_warnings_about_others_end_after_64_for_anybody_can_cause_them(supervisor: Supervisor, capsys: pytest.CaptureFixture[str]) -> None:
    """Tokens of ever new incarnations wrote 900 lines a second into the terminal and the log."""
    for number in range(100):
        supervisor._on_twin(f"x{number % 3}", number, number + 1)
        supervisor._on_differing("s1", ("filter.gate",))
    told = capsys.readouterr().out.splitlines()
    assert len(told) == 64 and sum("two processes are called x" in line for line in told) == 32


class GoneZygote:
    """The supervisor's end of a zygote that has ended after its start."""

    is_ready = is_gone = True

    def fileno(self) -> int:
        return 0

    def collect(self) -> None:
        """Nothing is left to be read."""


def test_the_end_of_the_process_that_forks_agents_is_told_before_all_of_them_die(
    supervisor: Supervisor, capsys: pytest.CaptureFixture[str]
) -> None:
    async def hear() -> None:
        supervisor._hear(GoneZygote())  # type: ignore[arg-type]

    asyncio.run(hear())
    assert "the process that prepares agents has ended, and with it all that it has started; `covey restart`" in capsys.readouterr().out
