"""What is seen of a run with real processes from its first second to its result."""

import asyncio
import logging
import os
from pathlib import Path
from typing import NoReturn

from deploy.commands.display import Display, show_result
from deploy.monitor.picture import Picture
from deploy.monitor.server import PageServer, address_of
from deploy.monitor.source import LiveSource
from deploy.onlookers import Onlookers, open_recorder, recording_path
from deploy.scenario import Scenario
from deploy.swarm.rundir import RunDirectory
from deploy.swarm.supervisor import Supervisor
from deploy.swarm.warm import announce
from deploy.swarm.zygote import Zygote
from protocol.process import JsonLines, leave
from protocol.settings import BadSetting


def attend(
    scenario: Scenario,
    directory: RunDirectory,
    lock: int,
    zygote: Zygote | None,
    title: str,
    as_json: bool,
    record: bool | Path,
    page: bool | str,
) -> NoReturn:
    """Supervise the run whose folder is claimed (`lock`), show its progress and its result, and end this process with the exit code."""
    if zygote is not None:
        announce()
    handler = logging.FileHandler(directory.log("supervisor"))
    handler.setFormatter(JsonLines(scenario.run.name, "supervisor"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    with Display(to_stderr=as_json) as display:
        try:
            supervisor = Supervisor(scenario, directory, display.event, display.status, zygote)
        except BadSetting:
            if zygote is not None:
                zygote.close()
            raise
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
