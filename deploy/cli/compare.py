"""`compare`: one scenario under two kinds of diagram, side by side on the page."""

import asyncio
import contextlib
import logging

import msgspec

from deploy.cli.terminal import open_browser, stop_event
from deploy.live.warmup import announce
from deploy.page.comparison import ComparisonSource
from deploy.page.server import PageServer, address_of
from deploy.scenario import FaultSettings, Scenario
from protocol.settings import BadSetting


def compare(scenario: Scenario, against: str, page: bool | str, speed: float, opens: bool) -> int:
    """Simulate both in step and show them until Ctrl-C; three agents die at mid-run unless the scenario says otherwise."""
    kind, address = scenario.partition.kind, address_of(page or True)
    if against == kind:
        raise BadSetting(f"--against {against}: is the scenario's own diagram; compare it with another")
    if not scenario.faults:
        deaths = FaultSettings(at=scenario.run.seconds / 2.0, verb="kill", who=str(min(3, len(scenario.members) - 1)))
        scenario = msgspec.structs.replace(scenario, faults=(deaths,))
    assert address is not None
    announce()
    server = PageServer(ComparisonSource(scenario, (kind, against), speed), address)
    print(f"page: {(url := server.bind())}", flush=True)
    print(f"{scenario.run.scenario}: {kind} beside {against}, seed {scenario.run.seed}; Ctrl-C ends it", flush=True)
    if opens:
        print(open_browser(url), flush=True)
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_serve(server))
    return 0


async def _serve(server: PageServer) -> None:
    over = stop_event()
    await server.open()
    try:
        await over.wait()
    finally:
        await server.close()
