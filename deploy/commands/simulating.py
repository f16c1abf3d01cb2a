"""`simulate`: a scenario in one process, in virtual time."""

import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

from rich.console import Console

from deploy.commands.display import show_result
from deploy.onlookers import Onlookers, open_recorder, recording_path
from deploy.records.trace import Trace, check_trace
from deploy.scenario import Scenario
from deploy.simulate import Simulation
from deploy.swarm.rundir import RunDirectory
from deploy.swarm.warm import announce
from protocol.messages import Truth


def simulate_here(
    scenario: Scenario,
    as_json: bool,
    record: bool | Path = False,
    trace: Path | None = None,
    clock: Literal["lockstep", "realtime"] = "lockstep",
) -> int:
    """Run the same nodes in this process in virtual time; a recording goes into the run directory unless a file is named."""
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
