"""The supervisor: starts the world and the agents, notices deaths, makes the result, and leaves no orphan.

It is no part of the swarm: agents find each other by themselves and go on without it in every respect but one, they end with it.
Everything runs in one event loop in the main thread (children must be started from there).
"""

import asyncio
import logging
import math
import signal
import time
from collections.abc import Callable
from typing import Any, Literal

import msgspec

from agents.membership.agreement import MOST_WARNINGS
from deploy.faults.faults import check_faults
from deploy.live.control import Answer, ControlServer
from deploy.live.operations import Operations
from deploy.live.processes import Child, packages, process_rows
from deploy.live.seeds import endpoints, seed_listeners
from deploy.live.startup import Startup, check_certificates
from deploy.live.zygote import Zygote
from deploy.scenario import Scenario, bodies_of, check_names, world_names
from deploy.scoring.result import Result
from deploy.scoring.scorer import Scorer, Status
from deploy.scoring.scores import write_scores
from deploy.storage.kept_runs import link_latest
from deploy.storage.run_directory import RunDirectory
from protocol.endpoints import check_endpoints
from protocol.live import Driver
from protocol.observer_messages import Truth
from protocol.settings import BadSetting, NetworkSettings
from protocol.whole_file import write_whole

GRACE = 2.5  # s for children to end by themselves
WORLD_SECONDS = 60.0  # that a run which nobody attends stands still without a world before it ends
LAST_LOOKS = 100  # every 10 ms, for the last ticks of a run
EXIT_CRASHED, EXIT_BAD_INPUT = 1, 2  # of a run in which a process ended by an exception; of one that refused its input
LAST_BODY_SECONDS = 10.0  # and run.patience, and a tick: between the first and the last body that ends with the run, at most

log = logging.getLogger(__name__)


class Supervisor:
    """One run, from the first process to the result."""

    def __init__(
        self,
        scenario: Scenario,
        directory: RunDirectory,
        on_event: Callable[[str], None] = lambda text: None,
        on_status: Callable[[Status], None] = lambda status: None,
        zygote: Zygote | None = None,
        attended: bool = True,
    ) -> None:
        """`zygote`: from now on the supervisor's, which ends it; None: agents are started from nothing. `attended`: at a terminal."""
        link_faults = scenario.network.link_faults
        check_faults(scenario.faults, list(scenario.members), world_names(scenario), live=True, link_faults=link_faults)
        check_endpoints(scenario.network)
        check_names(scenario)
        check_certificates(scenario)
        self.directory = directory
        self.result: Result | None = None
        self._listens = seed_listeners(scenario)
        seeds = tuple(dict.fromkeys([*self._listens.values(), *scenario.network.seeds]))
        admit = scenario.network.admit or tuple(scenario.members)
        network = msgspec.structs.replace(scenario.network, seeds=seeds, listen=NetworkSettings().listen, admit=admit)
        own = self._listens["monitor"]
        mode: Literal["peer", "router"] = "peer" if network.mode == "peer" else "router"
        self._own_network = msgspec.structs.replace(network, mode=mode, listen=(own,), seeds=tuple(seed for seed in seeds if seed != own))
        self.scenario = msgspec.structs.replace(scenario, network=network)
        self.scorer = Scorer(self.scenario, incarnation=time.time_ns() // 1_000_000)
        self.scorer.on_truth = self._on_truth
        self.scorer.on_twin = self._on_twin
        self.scorer.on_differing = self._on_differing
        self.scorer.on_report = lambda told: on_event(f"[{told.time:.1f} s] {told.text}")
        self.crashed: list[str] = []  # processes that have ended by an exception or a crash of their own
        self._advised, self._winding_down, self._warnings = False, False, 0
        self._attended = attended
        self._still_since: float | None = None  # when the world, or its last body, died
        self._last_bodies_by = math.inf  # once a body has ended with the run: when the others should have
        self.children = {name: Child(name, package, directory, self._words(name, seeds)) for name, package in packages(scenario).items()}
        self._zygote = zygote
        for name in scenario.members:
            self.children[name].zygote = self._zygote
        for name, body in bodies_of(scenario).items():
            self.children[body].body_of = name
        self._start = Startup(list(scenario.members), list(self.children.values()), self.scorer, zygote, directory.log("zygote"))
        self.operations = Operations(self.scenario, self.children, self.scorer, directory, self._start, self._tell, self._on_death)
        self._on_event, self._on_status = on_event, on_status
        self._over: asyncio.Future[int] | None = None
        self._started_at = time.monotonic()
        self._first_truth_at: float | None = None

    async def run(self) -> int:
        """Run to the end; the exit code. Raises BadSetting when a process refuses its input."""
        loop = asyncio.get_running_loop()
        self._over = loop.create_future()
        for number, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)):
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # which `nohup` has set
                loop.add_signal_handler(number, self._on_signal, code)
        loop.add_signal_handler(signal.SIGCHLD, self._reap)
        if self._zygote is not None:
            loop.add_reader(self._zygote.fileno(), self._hear, self._zygote)
        driver = Driver(self.scorer, self._own_network)
        control = ControlServer(self.directory, self._answer)
        monitor = start = None
        try:
            await driver.open()
            await control.open()
            self.directory.write_config(self.scenario)  # after all that may be refused: with it the run has begun
            link_latest(self.directory)
            monitor = asyncio.create_task(driver.serve())
            start = asyncio.create_task(self._start.start_all(self._tell))
            return await self._watch(driver, monitor, start)
        except Exception as error:
            if start is not None:  # what has begun has a result, of what was scored before
                self._make_result(EXIT_BAD_INPUT if isinstance(error, BadSetting) else EXIT_CRASHED, failed=True)
            raise
        finally:
            if start is not None:
                start.cancel()
                await asyncio.gather(start, return_exceptions=True)
            await control.close()  # first: by this watchers know that agents which leave now are dismissed
            await self._wind_down()
            if self._zygote is not None:
                loop.remove_reader(self._zygote.fileno())
                self._zygote.close()
            driver.stop(0, "the run is over")
            if monitor is not None:
                await asyncio.gather(monitor, return_exceptions=True)

    async def _watch(self, driver: Driver, monitor: "asyncio.Task[int]", start: "asyncio.Task[None]") -> int:
        """Report the status twice a second until the run is over."""
        assert self._over is not None
        while not self._over.done():
            await asyncio.wait([self._over], timeout=0.5)
            self._reap()  # in case a signal was merged with another
            self.operations.take_signals_from_outside()
            for child in self.children.values():
                child.write_what_waits()
            self._end_standstill()
            self.scorer.tick_rate.unread = driver.unread
            status = self._status()
            self._on_status(status)
            if status.tick_rate.advice and not self._advised:
                self._advised = True
                self._tell(status.tick_rate.advice)
            if start.done() and self._pending:
                start.result()
            if monitor.done() and self._pending:
                monitor.result()
                raise RuntimeError("the monitor's session has ended")
        code = self._over.result()
        if code == 0:
            await self._wait_for_the_last_ticks()
            code = EXIT_CRASHED if self.crashed else 0
        self._make_result(code)
        return code

    def _end_standstill(self) -> None:
        """End a run whose last bodies do not come to its end, or one whose world is dead and that nobody attends or has repaired."""
        now = time.monotonic()
        if any(child.is_running for child in self.children.values() if child.package == "world"):
            self._still_since = None
        if self._pending and now > self._last_bodies_by:
            late = [child.name for child in self.children.values() if child.body_of and child.is_running]
            self._tell(f"the run is over and ends without {', '.join(late)}, not at the last tick yet")
            self._end(0)
        elif self._pending and not self._attended and self._still_since is not None and now >= self._still_since + WORLD_SECONDS:
            self._tell(f"the world has been dead for {WORLD_SECONDS:.0f} s and nobody has restarted it: the run ends")
            self._end(EXIT_CRASHED)

    def _status(self) -> Status:
        """The status of the swarm, and what its start waits for."""
        return msgspec.structs.replace(self.scorer.status(time.monotonic()), waiting=self._start.waiting())

    async def _wait_for_the_last_ticks(self) -> None:
        """Let what was said before the end arrive, which takes its time on a busy machine.

        Returns once the last tick is scored, or after `LAST_LOOKS` without a new one. Where the swarm runs on, only what is there counts.
        """
        scorer, seen, looks = self.scorer, self.scorer.truth, 0
        runs_on = any(child.is_running for child in self.children.values() if child.package == "world")
        while looks < LAST_LOOKS and not scorer.is_up_to_date(whole=not runs_on):
            await asyncio.sleep(0.01)
            looks = looks + 1 if runs_on or scorer.truth is seen else 0
            seen = scorer.truth

    def _make_result(self, code: int, *, failed: bool = False) -> None:
        now = asyncio.get_running_loop().time()
        self.scorer.finish(now, failed=failed)
        try:
            write_scores(self.directory.scores, self.scorer.scores)  # first: the figures of tracks take a long time after a long run
        except OSError as error:
            self._tell(f"{self.directory.scores}: {error.strerror}; the scores are not kept")
        result = self.scorer.result(now - (self._first_truth_at or now))
        self.result = msgspec.structs.replace(result, exit_code=code, tick_rate=self.scorer.tick_rate.whole())
        try:
            write_whole(self.directory.result, f"{self.result.to_json()}\n".encode())
        except OSError as error:
            self._tell(f"{self.directory.result}: {error.strerror}; the result is not kept")

    async def _wind_down(self) -> None:
        """End all children: SIGTERM, then SIGKILL after `GRACE`; before the first tick at once. None is left."""
        self._winding_down = True
        for child in self.children.values():
            child.send(signal.SIGTERM)
            child.send(signal.SIGCONT)
        end = time.monotonic() + (GRACE if self.scorer.truth is not None else 0.0)
        while any(child.is_running for child in self.children.values()):
            if time.monotonic() > end:
                self._kill_all()
                if self._zygote is not None:  # with children of which no pid is known
                    self._zygote.kill()
            await asyncio.sleep(0.02)
            self._reap()

    def _kill_all(self) -> None:
        for child in self.children.values():
            child.send(signal.SIGKILL)

    def _on_signal(self, code: int) -> None:
        """The first signal ends the run, the second one at once."""
        if self._winding_down:
            self._kill_all()
        self._end(code)

    @property
    def _pending(self) -> "asyncio.Future[int] | None":
        """The exit code to come, while the run goes on; None before and after."""
        return self._over if self._over is not None and not self._over.done() else None

    def _end(self, code: int) -> None:
        if self._pending:
            self._pending.set_result(code)

    def _hear(self, zygote: Zygote) -> None:
        """Read the messages of the zygote, until it has ended."""
        zygote.collect()
        if zygote.is_gone:
            asyncio.get_running_loop().remove_reader(zygote.fileno())
            if zygote.is_ready and not self._winding_down:  # the start tells of an earlier end
                self._tell(
                    "the process that prepares agents has ended, and with it all that it has started; `covey restart` brings them back"
                )
        self._reap()

    def _reap(self) -> None:
        """Notice the end of children."""
        for child in self.children.values():
            if child.poll() and not self._winding_down:
                self._on_death(child)

    def _on_death(self, child: Child) -> None:
        log.info("%s ended: %s", child.name, child.end(), extra={"tick": self.scorer.truth.tick if self.scorer.truth else None})
        rest = [other for other in self.children.values() if child.package == other.package == "world" and other is not child]
        was_last = child.package == "world" and not any(other.is_running or not other.has_started for other in rest)
        if child.returncode == 0 and (was_last or child.body_of):
            late = LAST_BODY_SECONDS + self.scenario.run.patience + self.scenario.run.dt / self.scenario.run.rate
            self._last_bodies_by = min(self._last_bodies_by, time.monotonic() + late)
            if was_last:
                self._end(0)
            return
        if (child.returncode == EXIT_BAD_INPUT and not self._others_of_the_world(child)) or (
            self.scorer.truth is None and child.returncode == 1
        ):
            self._fail(BadSetting(child.last_log_line() or f"{child.name} ended with {child.end()}"))
        if self.scorer.truth is None and self.scenario.run.strict:
            why = self._start.waiting() if child.name == "world" else f"{child.name} died: {child.end()}"
            self._fail(BadSetting(f"{why}; --strict refuses to start with fewer than {len(self.scenario.members)} agents"))
        self._start.expect()
        self.operations.tell_scorer("kill", [child.name])
        words = f"{child.name} died: {child.end()}"
        if child.crashed or child.returncode == EXIT_BAD_INPUT:
            self.crashed.append(child.name)
            words += f": {child.last_log_line()}"
        is_over = was_last and any(other.returncode == 0 for other in rest)  # the other bodies have left at the last tick
        if was_last and not is_over and self._pending:
            self._still_since = time.monotonic()
            otherwise = "Ctrl-C ends the run" if self._attended else f"after {WORLD_SECONDS:.0f} s without it the run ends"
            words += f"; the swarm stands still until `covey restart {child.name} --run {self.directory.name}`, {otherwise}"
        self._tell(words)
        if is_over:
            self._end(0)

    def _others_of_the_world(self, child: Child) -> list[Child]:
        """The other bodies that have not failed, of a body; none where one world has all bodies."""
        bodies = [other for other in self.children.values() if child.body_of and other.body_of]
        return [other for other in bodies if other is not child and other.returncode != EXIT_BAD_INPUT]

    def _fail(self, error: Exception) -> None:
        if self._pending:
            self._pending.set_exception(error)

    def _tell(self, text: str) -> None:
        when = f"{self.scorer.truth.time:.1f} s" if self.scorer.truth else "start"
        self._on_event(f"[{when}] {text}")

    def _on_truth(self, truth: Truth) -> None:
        """The world's time has moved on: carry out the faults that are due."""
        if self._first_truth_at is None:
            self._first_truth_at = asyncio.get_running_loop().time()
            log.info("the first tick", extra={"seconds": round(self._first_truth_at - self._started_at, 3)})
            if complaint := self._start.check(truth):
                self._warn(complaint)
        self.operations.run_due_faults(truth.time)

    def _on_twin(self, name: str, known: int, other: int) -> None:
        """Warn about two processes of one name, unless the younger one was just started here in place of a killed one."""
        child = self.children.get(name)
        if child is None or child.incarnation != max(known, other):
            self._warn(f"two processes are called {name}, incarnations {known} and {other}: the older one stops itself")

    def _on_differing(self, name: str, fields: tuple[str, ...]) -> None:
        self._warn(f"the settings of {name} are not those of the run in {', '.join(fields)}: the others refuse it")

    def _warn(self, text: str) -> None:
        """Log and tell a warning about others, unless there have been many: anybody can cause them."""
        self._warnings += 1
        if self._warnings <= MOST_WARNINGS:
            log.warning(text)
            self._tell(text)

    # ------------------------------------------------------------------ verbs

    async def _answer(self, request: dict[str, Any]) -> Answer:
        """Carry out a request of the control socket."""
        match request.get("verb", ""):
            case "status":
                return {"ok": "", "data": self.status()}
            case "faults":
                return {"ok": "", "data": self.scorer.faults}
            case "down":
                self._end(0)
                return {"ok": "going down"}
        return {"ok": self.operations.run_request(request)}

    def status(self) -> dict[str, Any]:
        """The data of `ps` and `watch`: the scores of the swarm, and every process."""
        swarm = msgspec.to_builtins(self._status())
        rows = process_rows(self.children, self.scenario.members, swarm.pop("agents"))
        head = {"run": self.directory.name, "scenario": self.scenario.run.scenario, "endpoint": self._own_network.listen[0]}
        return {**head, "swarm": swarm, "processes": rows, "faults": self.scorer.faults}

    def _words(self, name: str, seeds: tuple[str, ...]) -> list[str]:
        """The command-line options of a process: its endpoints, and of an agent its sensor class."""
        members = self.scenario.members
        return [*endpoints(name, self._listens, seeds), *(["--sensor", members[name]] if name in members else [])]
