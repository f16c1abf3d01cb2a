"""`simulate`: a scenario in one process, in virtual time."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from types import FrameType
from typing import Literal

import msgspec

from deploy.cli.display import Display, show_result
from deploy.cli.errors import BAD_INPUT, FAILED, complain
from deploy.cli.scenario_checks import check_platform_class, simulation_remarks
from deploy.recording.observers import Observers, open_recorder, recording_path
from deploy.recording.trace import Trace, check_trace
from deploy.scenario import Scenario, with_run_name
from deploy.scoring.result import Result
from deploy.scoring.scores import write_scores
from deploy.simulation import Simulation, compile_once
from deploy.storage.kept_runs import link_latest, new_run_directory
from deploy.storage.run_directory import RunDirectory
from protocol.observer_messages import Truth
from protocol.settings import BadSetting
from protocol.whole_file import write_whole


def simulate_here(
    scenario: Scenario,
    requested_name: str | None,
    as_json: bool,
    record: bool | Path = False,
    trace: Path | None = None,
    clock: Literal["lockstep", "realtime"] = "lockstep",
) -> int:
    """Run the same nodes in this process in virtual time; the exit code.

    The result is kept as a run when it is named (`requested_name`) or recorded without a file's name. Of a simulation that a signal or
    a wrong class of the user's has ended it is that of the ticks so far.
    """
    if trace is not None:
        check_trace(trace)
    check_platform_class(scenario)
    compile_once()
    if requested_name is None and record is not True:
        path = recording_path(record, Path())
        result, series = _play(_simulation(scenario, clock, path), scenario, clock)
        return _show(result, None, as_json, path, series, trace)
    directory, lock = new_run_directory(requested_name, scenario.run.scenario)
    scenario = with_run_name(scenario, directory.name)
    try:
        path = recording_path(record, directory.path)
        simulation = _simulation(scenario, clock, path)
        directory.write_config(scenario, simulated=True)
    finally:
        directory.leave_unless_begun()
    link_latest(directory)
    try:
        result, series = _play(simulation, scenario, clock)
        _keep(directory, result, simulation)
    except Exception as error:
        code = BAD_INPUT if isinstance(error, BadSetting) else FAILED
        _keep(directory, msgspec.structs.replace(simulation.scored(), exit_code=code), simulation)
        raise
    finally:
        os.close(lock)
    return _show(result, directory.path, as_json, path, series, trace)


def _keep(directory: RunDirectory, result: Result, simulation: Simulation) -> None:
    """Write the result and the scores; a disk that is full is told."""
    try:
        write_whole(directory.result, f"{result.to_json()}\n".encode())
        write_scores(directory.scores, simulation.scorer.scores)
    except OSError as error:
        complain(f"{directory.result}: {error.strerror}; the result is not kept", FAILED)


def _simulation(scenario: Scenario, clock: Literal["lockstep", "realtime"], path: Path | None) -> Simulation:
    """A simulation that can begin, and is recorded into that file; raises BadSetting."""
    simulation = Simulation(scenario, clock=clock)
    if path is not None:
        Observers(simulation.scorer, open_recorder(path, simulation.scenario, virtual=True))
    return simulation


def _play(simulation: Simulation, scenario: Scenario, clock: Literal["lockstep", "realtime"]) -> tuple[Result, Trace]:
    """The result, and what a trace holds."""
    series = Trace(simulation)
    display = Display(to_stderr=True)
    for remark in simulation_remarks(scenario, clock):
        display.event(f"covey: {remark}")
    simulation.scorer.on_report = lambda told: display.event(f"[{told.time:.1f} s] {told.text}")
    with display.console.status("") if display.console.is_terminal else nullcontext() as spinner:
        show = (lambda text: spinner.update(text)) if spinner else display.event
        progress = ProgressLine(show, 0.25 if spinner else 5.0)

        def heard(truth: Truth) -> None:
            series.tell(truth)
            progress.tell(truth.tick + 1, scenario.run.ticks)

        simulation.on_truth = heard
        with _stopped_by_signals(simulation) as received:
            result = simulation.run()
    code = 128 + received[0] if received else 0
    return msgspec.structs.replace(result, exit_code=code), series


@contextmanager
def _stopped_by_signals(simulation: Simulation) -> Iterator[list[int]]:
    """The numbers of the signals that have stopped the simulation. From the first one on signals do again what they did before.

    A signal that is ignored, as SIGHUP is under `nohup`, stays so.
    """
    received = list[int]()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def stop(number: int, frame: FrameType | None) -> None:
        received.append(number)
        simulation.is_stopped = True
        restore()

    numbers = [number for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield received
    finally:
        restore()


def _show(result: Result, folder: Path | None, as_json: bool, recorded: Path | None, series: Trace, trace: Path | None) -> int:
    """Show the result and write the trace, which may fail."""
    code = show_result(result, folder, as_json)
    if recorded is not None:
        with suppress(OSError):
            print(f"recorded in {os.path.relpath(recorded)}", file=sys.stderr, flush=True)
    if trace is not None:
        series.write(trace, result)
    return result.exit_code or code


class ProgressLine:
    """Prints the progress of a simulation from time to time."""

    def __init__(self, show: Callable[[str], None], period: float) -> None:
        self._show, self._period = show, period
        self._said_at = time.monotonic()

    def tell(self, done: int, ticks: int) -> None:
        """Print the progress if `period` s have passed since the last line."""
        if time.monotonic() - self._said_at >= self._period:
            self._said_at = time.monotonic()
            self._show(f"{100 * done // ticks:3d} %  tick {done} of {ticks}")
