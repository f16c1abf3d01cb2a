"""`demo` and `up`: commands that run a scenario with real processes. What supervises them is imported while the zygote imports as well."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NoReturn

import msgspec

from deploy.scenario import FaultSettings, Scenario
from deploy.swarm.processes import ROOT, Spawn, child_environment
from deploy.swarm.rundir import RunDirectory, runs_folder
from deploy.swarm.zygote import Zygote
from protocol.settings import BadSetting

DETACH_SECONDS = 90.0  # that a detached swarm may take to start


def run_live(
    scenario: Scenario, title: str, as_json: bool, record: bool | Path = False, page: bool | str = False, spawn: Spawn = "zygote"
) -> NoReturn:
    """Run a scenario with real processes, show its progress and its result, and end this process with the exit code."""
    directory = RunDirectory(scenario.run.name)
    lock = directory.claim()
    zygote = Zygote(child_environment(), directory.log("zygote")) if spawn == "zygote" else None
    from deploy.commands.attending import attend

    attend(scenario, directory, lock, zygote, title, as_json, record, page)


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
    sys.exit(0)
