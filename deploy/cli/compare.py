"""`compare`: one scenario under two diagrams or control laws, side by side on the page."""

import asyncio
import contextlib
import logging

from deploy.cli.errors import tell_remarks
from deploy.cli.scenario_checks import simulation_remarks
from deploy.cli.terminal import open_browser, stop_event
from deploy.page.address import address_of
from deploy.page.comparison import SPEEDS, ComparisonSource
from deploy.page.server import PageServer
from deploy.page.simulated_swarm import SimulatedSwarm
from deploy.scenario import Scenario, law_in_words, with_deaths
from deploy.simulation import compile_once
from protocol.settings import BadSetting


def compare(one: Scenario, other: Scenario, page: bool | str, speed: float, opens: bool) -> int:
    """Simulate both in step and show them until Ctrl-C; three agents die at mid-run unless the scenario says otherwise.

    Both are variants of one scenario; raises BadSetting where they are the same. `speed`: world seconds per second.
    """
    first, second = difference(one, other)
    address = address_of(page)
    if address is None:
        raise BadSetting("--no-page: a comparison is seen on its page alone; `covey simulate` gives figures without one")
    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise BadSetting(f"--speed {speed:g}: should be a number from {SPEEDS[0]:g} to {SPEEDS[1]:g}")
    tell_remarks(simulation_remarks(one, "lockstep"))
    compile_once()
    sides = SimulatedSwarm(first, with_deaths(one)), SimulatedSwarm(second, with_deaths(other))
    server = PageServer(ComparisonSource(sides, speed), address)
    print(f"page: {(url := server.bind())}", flush=True)
    print(f"{one.run.scenario}: {first} beside {second}, seed {one.run.seed}; Ctrl-C ends it", flush=True)
    if opens:
        print(open_browser(url), flush=True)
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_serve(server))
    return 0


def difference(one: Scenario, other: Scenario) -> tuple[str, str]:
    """What tells two variants of a scenario apart, for people: their diagrams, or their control laws. Raises BadSetting."""
    diagrams, laws = (one.partition.kind, other.partition.kind), (one.control.mode, other.control.mode)
    if diagrams[0] != diagrams[1]:
        return diagrams
    if laws[0] == laws[1]:
        raise BadSetting(
            f"--against: should differ from {diagrams[0]} and {laws[0]}, which the scenario has: voronoi, search-and-track, ..."
        )
    return law_in_words(laws[0]), law_in_words(laws[1])


async def _serve(server: PageServer) -> None:
    over = stop_event()
    await server.open()
    try:
        await over.wait()
    finally:
        await server.close()
