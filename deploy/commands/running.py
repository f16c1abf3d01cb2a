"""`demo`, `up` and `simulate`: commands that run a scenario to its end."""

import asyncio
import logging
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Literal, NoReturn

import msgspec
from rich.console import Console

from deploy.commands.display import Display, result_table
from deploy.monitor.picture import Picture
from deploy.monitor.server import PageServer, address_of
from deploy.monitor.source import LiveSource
from deploy.onlookers import Onlookers, open_recorder, recording_path
from deploy.result import Result
from deploy.scenario import FaultSettings, Scenario
from deploy.swarm.processes import ROOT
from deploy.swarm.rundir import RunDirectory, runs_folder
from deploy.swarm.supervisor import Spawn, Supervisor
from deploy.swarm.warm import announce
from protocol.messages import Truth
from protocol.process import JsonLines, leave
from protocol.settings import BadSetting

DETACH_SECONDS = 90.0  # that a detached swarm may take to start


def run_live(
    scenario: Scenario, title: str, as_json: bool, record: bool | Path = False, page: bool | str = False, spawn: Spawn = "zygote"
) -> NoReturn:
    """Run a scenario with real processes, show its progress and its result, and end this process with the exit code."""
    directory = RunDirectory(scenario.run.name)
    lock = directory.claim()
    if spawn == "zygote":
        announce()
    handler = logging.FileHandler(directory.log("supervisor"))
    handler.setFormatter(JsonLines(scenario.run.name, "supervisor"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    with Display(to_stderr=as_json) as display:
        supervisor = Supervisor(scenario, directory, display.event, display.status, spawn=spawn)
        server = page_of(supervisor, page)
        if server is not None:
            display.event(f"page: {server.bind()}")
        display.event(title)
        path = recording_path(record, directory.path)
        recorder = open_recorder(path, supervisor.scenario) if path else None
        code = asyncio.run(_attended(supervisor, Onlookers(supervisor.scorer, recorder, server)))
        if recorder is not None and recorder.stopped:
            display.event(f"{path}: {recorder.stopped}; the recording ended early, {recorder.lost} messages are not in it")
    os.close(lock)
    if supervisor.result is not None and code == 0:
        show_result(supervisor.result, directory.path, as_json)
    leave(code)


async def _attended(supervisor: Supervisor, onlookers: Onlookers) -> int:
    async with onlookers:
        return await supervisor.run()


def page_of(supervisor: Supervisor, page: bool | str) -> PageServer | None:
    """The page of a run; None when none is wanted."""
    address = address_of(page)
    if address is None:
        return None
    return PageServer(LiveSource(supervisor.scorer, Picture(supervisor.scenario), supervisor.directory), address)


def show_result(result: Result, path: Path | None, as_json: bool) -> None:
    """The result as a table, or as the last line of standard output."""
    console = Console(stderr=as_json, highlight=False)
    where = f"; logs and result in {os.path.relpath(path)}" if path else ""
    console.print(result_table(result, f"{result.scenario}, seed {result.seed}: {result.agents} agents{where}"))
    if as_json:
        print(result.to_json())


def demo(scenario: Scenario, as_json: bool, record: bool | Path = False, page: bool | str = True, spawn: Spawn = "zygote") -> NoReturn:
    """Section IV-A live, with 3 of 16 agents killed at mid-run unless the options say otherwise."""
    if not scenario.faults:
        deaths = FaultSettings(at=scenario.run.seconds / 2.0, verb="kill", who=str(min(3, len(scenario.members) - 1)))
        scenario = msgspec.structs.replace(scenario, faults=(deaths,))
    agents, targets, run = len(scenario.members), scenario.targets.count, scenario.run
    pace = "as fast as it goes" if run.clock == "lockstep" else f"{run.rate:g} x real time"
    title = f"{agents} agent processes and one world, {targets} targets, {run.seconds:g} s of world time, {pace}; Ctrl-C ends it"
    run_live(scenario, title, as_json, record, page, spawn)


def up(
    scenario: Scenario, as_json: bool, detach: bool, record: bool | Path = False, page: bool | str = False, spawn: Spawn = "zygote"
) -> NoReturn:
    """Run a scenario in the foreground, or detached."""
    if detach:
        _detach(scenario)
    run = scenario.run
    pace = "lockstep" if run.clock == "lockstep" else f"rate {run.rate:g}"
    run_live(
        scenario,
        f"run {run.name}: {run.scenario}, {len(scenario.members)} agents, {pace}; other terminal: covey ps | kill | watch",
        as_json,
        record,
        page,
        spawn,
    )


def _detach(scenario: Scenario) -> NoReturn:
    """Start the same command without --detach in a session of its own, and wait until its control socket answers."""
    directory = RunDirectory(scenario.run.name)
    os.close(directory.claim())  # complains if the run is running
    words = [word for word in sys.argv[1:] if word not in ("--detach", "-d")]
    output = runs_folder() / scenario.run.name / "up.log"
    with output.open("wb") as log:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "COVEY_RUNS": str(runs_folder())}
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "deploy", *words],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env=environment,
            start_new_session=True,
        )
    end = time.monotonic() + DETACH_SECONDS
    while process.poll() is None and not directory.control.exists() and time.monotonic() < end:
        time.sleep(0.05)
    if process.poll() is not None and process.returncode != 0:
        lines = output.read_text(errors="replace").strip().splitlines()
        raise BadSetting((lines or ["the run ended at once"])[-1].removeprefix("covey: "))
    print(f"run {scenario.run.name} is up, process {process.pid}; covey ps | watch | down --run {scenario.run.name}")
    leave(0)


def simulate_here(
    scenario: Scenario,
    as_json: bool,
    record: bool | Path = False,
    trace: Path | None = None,
    clock: Literal["lockstep", "realtime"] = "lockstep",
) -> int:
    """Run the same nodes in this process in virtual time; a recording goes into the run directory unless a file is named."""
    from deploy.records.trace import Trace, check_trace
    from deploy.simulate import Simulation

    if trace is not None:
        check_trace(trace)
    announce()
    simulation = Simulation(scenario, clock=clock)
    series = Trace(simulation)
    folder = RunDirectory(scenario.run.name).path
    path = recording_path(record, folder)
    if path is not None:
        Onlookers(simulation.scorer, open_recorder(path, simulation.scenario, virtual=True))
    console = Console(stderr=True, highlight=False)
    with console.status("") if console.is_terminal else nullcontext() as spinner:
        show = (lambda text: spinner.update(text)) if spinner else console.print
        pace = Pace(show, 0.25 if spinner else 5.0)

        def heard(truth: Truth) -> None:
            series.tell(truth)
            pace.tell(truth.tick + 1, scenario.run.ticks)

        simulation.on_truth = heard
        result = simulation.run()
    if trace is not None:
        series.write(trace, result)
    show_result(result, None, as_json)
    if path is not None:
        console.print(f"recorded in {os.path.relpath(path)}")
    return 0


class Pace:
    """Says now and then how far a simulation is."""

    def __init__(self, show: Callable[[str], None], period: float) -> None:
        self._show, self._period = show, period
        self._said_at = time.monotonic()

    def tell(self, done: int, ticks: int) -> None:
        """Say it if `period` s have passed since it was last said."""
        if time.monotonic() - self._said_at >= self._period:
            self._said_at = time.monotonic()
            self._show(f"{100 * done // ticks:3d} %  tick {done} of {ticks}")
