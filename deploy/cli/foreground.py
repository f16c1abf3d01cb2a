"""What is seen of a run with real processes from its first second to its result."""

import asyncio
import logging
import os
import signal
from typing import TYPE_CHECKING, NoReturn

from deploy.cli.display import Display, show_result
from deploy.cli.errors import OK
from deploy.cli.options import DisplayOptions
from deploy.cli.terminal import is_at_terminal, open_browser, until_key
from deploy.live.supervisor import EXIT_CRASHED, Supervisor
from deploy.live.zygote import Zygote
from deploy.page.address import address_of
from deploy.page.picture import Picture
from deploy.page.simulated_swarm import SimulatedSwarm
from deploy.page.source import LiveSource
from deploy.recording.observers import Observers, open_recorder, recording_path
from deploy.scenario import Scenario, law_in_words
from deploy.scoring.result import Result
from deploy.scoring.tick_rate import too_small
from deploy.storage.run_directory import RunDirectory
from protocol.process import JsonLines, leave
from protocol.settings import BadSetting
from protocol.whole_file import write_whole

if TYPE_CHECKING:
    from deploy.page.server import PageServer


def run_in_foreground(
    scenario: Scenario, directory: RunDirectory, lock: int, zygote: Zygote | None, title: str, showing: DisplayOptions
) -> NoReturn:
    """Supervise the run whose folder is claimed (`lock`), show its progress and its result, and end this process with the exit code."""
    handler = logging.FileHandler(directory.log("supervisor"))
    handler.setFormatter(JsonLines(scenario.run.name, "supervisor"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.raiseExceptions = False  # a log on a full disk neither ends the run nor prints a traceback
    with Display(to_stderr=showing.json) as display:
        try:
            supervisor = Supervisor(scenario, directory, display.event, display.status, zygote, is_at_terminal())
        except BadSetting:
            if zygote is not None:
                zygote.close()
            raise
        other = SimulatedSwarm(f"{law_in_words(showing.beside.control.mode)}, simulated", showing.beside) if showing.beside else None
        server, address = page_of(supervisor, showing.page, showing.stays, other), ""
        if server is not None:
            address = server.bind()
        path = recording_path(showing.record, directory.path)
        recorder = open_recorder(path, supervisor.scenario) if path else None
        if server is not None:
            write_whole(directory.page, f"{address}\n".encode())
            display.event(f"page: {address}")
            if showing.open:
                display.event(open_browser(address))
        display.event(title)
        display.event(too_small(scenario))
        stays = showing.stays and not showing.json and server is not None and is_at_terminal()

        async def work() -> int:
            async with Observers(supervisor.scorer, recorder, server):
                code = await supervisor.run()
                os.close(lock)
                display.close()
                if recorder is not None and recorder.stopped:
                    display.event(f"{path}: {recorder.stopped}; the recording ended early, {recorder.lost} messages are not in it")
                shown = OK
                if supervisor.result is not None:
                    shown = show_result(supervisor.result, directory.path, showing.json)
                    if other is not None and supervisor.result.ticks and supervisor.result.has_targets:
                        display.event(beside_in_words(supervisor.result, other))
                if stays and code in (0, EXIT_CRASHED):
                    display.event(f"the page stays at {address} until Enter or Ctrl-C")
                    await until_key()
            # Closing, a loop closes the pipe that signals wake it by, and lets go of them only then: one in between would be a complaint.
            signal.set_wakeup_fd(-1)
            return code or shown

        code = asyncio.run(work())
    leave(code)


def beside_in_words(result: Result, other: SimulatedSwarm) -> str:
    """How well the swarm beside did in the same world."""
    other.play(result.ticks - 1)
    if other.failure is not None:
        return f"{other.name} in the same world: {other.failure}"
    theirs = other.simulation.result().mean_ospa
    return f"{other.name} in the same world: mean OSPA {theirs:.2f} m; this run: {result.mean_ospa:.2f} m"


def page_of(supervisor: Supervisor, page: bool | str, tour: bool, other: SimulatedSwarm | None = None) -> "PageServer | None":
    """The page of a run; None when none is wanted. `tour`: it offers its guided tour. `other`: a swarm beside it."""
    address = address_of(page)
    if address is None:
        return None
    from deploy.page.server import PageServer

    scenario = supervisor.scenario
    name = f"{law_in_words(scenario.control.mode)}, live" if other else ""
    return PageServer(LiveSource(supervisor.scorer, Picture(scenario), supervisor.directory, tour, name, other), address)
