"""`demo` and `up`: commands that run a scenario with real processes. What supervises them is imported while the zygote imports as well."""

import os
import signal
import subprocess
import sys
import time
from typing import NoReturn

import msgspec

from deploy.cli.options import DisplayOptions
from deploy.cli.scenario_checks import check_platform_class
from deploy.installation import command, environment
from deploy.live.processes import Spawn, child_environment
from deploy.live.zygote import Zygote
from deploy.scenario import Scenario, bodies_of, refuse_oracle, targets_in_words, unsimulated, with_deaths, with_run_name
from deploy.scoring.tick_rate import too_small
from deploy.storage.kept_runs import new_run_directory
from deploy.storage.run_directory import runs_folder
from protocol.endpoints import check_loopback
from protocol.settings import BadSetting
from world.platform import SIMULATED

DETACHED = "COVEY_DETACHED"  # the environment variable that hands a detached run its name
MOST_BESIDE = 64  # agents of a swarm that is simulated beside a demo
DETACH_SECONDS = 90.0  # that a detached swarm may take to start


def run_live(scenario: Scenario, requested_name: str | None, title: str, showing: DisplayOptions, spawn: Spawn) -> NoReturn:
    """Run a scenario with real processes, show its progress and its result, and end this process with the exit code.

    `requested_name`: the name that the user gives the run; None: one of the date and the scenario.
    """
    refuse_oracle(scenario)
    check_platform_class(scenario)
    check_loopback()
    detached = os.environ.pop(DETACHED, None)  # the name that the waiting command has chosen
    directory, lock = new_run_directory(detached or requested_name, scenario.run.scenario)
    scenario = with_run_name(scenario, directory.name)
    other = f"; runs/{requested_name} holds an earlier run" if detached is None and requested_name not in (None, directory.name) else ""
    try:
        zygote = Zygote(child_environment(), directory.log("zygote")) if spawn == "zygote" else None
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # while modules are imported it would end this process at once
        from deploy.cli.foreground import run_in_foreground

        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        run_in_foreground(scenario, directory, lock, zygote, f"run {directory.name}{other}: {title}", showing)
    finally:
        directory.leave_unless_begun()


def demo(scenario: Scenario, requested_name: str | None, showing: DisplayOptions, spawn: Spawn = "zygote") -> NoReturn:
    """A scenario live, with 3 agents killed at mid-run unless the options say otherwise."""
    scenario = with_deaths(scenario)
    agents, run = len(scenario.members), scenario.run
    bodies = "as many of their bodies" if bodies_of(scenario) else "one world"
    who = f"{agents} agent processes and {bodies}, {targets_in_words(scenario)}"
    title = f"{who}, {run.seconds:g} s of world time, {_speed(scenario)}; Ctrl-C ends it"
    run_live(scenario, requested_name, title, showing, spawn)


def other_law(scenario: Scenario) -> str | None:
    """The control law that a demo shows beside that of the scenario; None where there is none, or it cannot be simulated in time."""
    struck = {name.strip() for fault in scenario.faults for name in fault.who.split(",")}
    if scenario.bodies.platform != SIMULATED or scenario.recorded.kind == "mrclam":
        return None  # robots have one driver, and recorded ones drive as they drove
    if len(scenario.members) > MOST_BESIDE or struck & unsimulated(scenario):
        return None
    return {"lloyd": "search-and-track", "search-and-track": "lloyd"}.get(scenario.control.mode)


def with_max_rate(scenario: Scenario, rate: float) -> Scenario:
    """The scenario at so many world seconds per second, at most."""
    return msgspec.structs.replace(scenario, run=msgspec.structs.replace(scenario.run, max_rate=rate))


def _speed(scenario: Scenario) -> str:
    """How fast time passes, for people."""
    run = scenario.run
    if run.clock == "realtime":
        return f"{run.rate:g} x real time"
    if run.max_rate:
        return f"at most {run.max_rate:g} x real time ({run.seconds / run.max_rate:.0f} s; --fast for as fast as it goes)"
    return "as fast as it goes"


def up(scenario: Scenario, requested_name: str | None, detach: bool, showing: DisplayOptions, spawn: Spawn = "zygote") -> NoReturn:
    """Run a scenario in the foreground, or detached."""
    if detach and DETACHED not in os.environ:
        _detach(scenario, requested_name)
    run = scenario.run
    clock = "lockstep" if run.clock == "lockstep" else f"rate {run.rate:g}"
    title = f"{run.scenario}, {len(scenario.members)} agents, {clock}; other terminal: covey ps | kill | watch"
    run_live(scenario, requested_name, title, showing, spawn)


def _detach(scenario: Scenario, requested_name: str | None) -> NoReturn:
    """Start the same command without --detach in a session of its own, and wait until its control socket answers."""
    directory, lock = new_run_directory(requested_name, scenario.run.scenario)
    os.close(lock)
    words = [word for word in sys.argv[1:] if word not in ("--detach", "-d")]
    with directory.output.open("w+b") as log:
        process = subprocess.Popen(
            [*command("deploy"), *words],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env={**environment(), "COVEY_RUNS": str(runs_folder()), DETACHED: directory.name},
            start_new_session=True,
        )
        end = time.monotonic() + DETACH_SECONDS
        while process.poll() is None and not directory.control.exists() and time.monotonic() < end:
            time.sleep(0.05)
        if process.poll() is not None and process.returncode != 0:
            directory.leave_unless_begun()
            log.seek(0)
            lines = log.read().decode(errors="replace").strip().splitlines()
            raise BadSetting((lines or ["the run ended at once"])[-1].removeprefix("covey: "))
    if process.poll() is None and not directory.control.exists():
        raise BadSetting(f"run {directory.name} has not started within {DETACH_SECONDS:g} s; see {directory.output}")
    print(f"run {directory.name} is up, process {process.pid}; covey ps | watch | down --run {directory.name}")
    if directory.page.exists():
        print(f"page: {directory.page.read_text(encoding='utf-8').strip()}")
    if advice := too_small(scenario):
        print(advice)
    sys.exit(0)
