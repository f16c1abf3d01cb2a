"""Commands that run a scenario: names, options and help."""

from dataclasses import replace
from typing import Annotated

from deploy.cli.app import RUN, OpenPage, Options, PageAddress, RecordFile, ScenarioName, TraceFile, app
from deploy.cli.options import FLAG, DisplayOptions, RunOptions

DIAGRAMS = ("power", "voronoi", "voronoi-cod")
DEMO_SECONDS = 80.0  # that the world time of a demo takes


@app.command(group=RUN, help_epilogue="Example: covey demo --seed 3\n         covey demo students03")
def demo(
    scenario: ScenarioName = "convergence",
    /,
    *,
    page: PageAddress = True,
    open: OpenPage = False,
    fast: Annotated[bool, FLAG] = False,
    record: RecordFile = False,
    options: Options = RunOptions(),
) -> int:
    """Watch a swarm work: 16 agents, 8 targets, 3 deaths at mid-run, a table; or another scenario.

    At a pace that the eye can follow (80 s), or --fast. Beside it the page shows the same world under search-and-track, simulated in step.
    In a terminal the page stays until Enter or Ctrl-C.
    """
    from deploy.cli import start

    paced = not fast and not options.lockstep and options.rate is None
    chosen = replace(options, lockstep=options.lockstep or options.rate is None)
    resolved = chosen.scenario(scenario)
    if paced and not resolved.run.max_rate:
        resolved = start.with_max_rate(resolved, resolved.run.seconds / DEMO_SECONDS)
    showing = DisplayOptions(options.json, record, page or open, open, stays=True)
    if paced and showing.page and (law := start.other_law(resolved)):
        showing = replace(showing, beside=start.with_deaths(chosen.variant(scenario, {"control.mode": law})))
    start.demo(resolved, chosen.requested_name(resolved), showing, options.spawn)


@app.command(
    group=RUN, help_epilogue="Example: covey compare convergence --seed 3 --open\n         covey compare --against search-and-track"
)
def compare(
    scenario: ScenarioName = "convergence",
    /,
    *,
    against: str = "voronoi",
    page: PageAddress = True,
    open: OpenPage = False,
    speed: float = 2.0,
    options: Options = RunOptions(),
) -> int:
    """Simulate a scenario under two diagrams or two control laws, side by side on the page.

    Same seed and faults, in step. --against: power, voronoi, voronoi-cod, or a law such as search-and-track or module:Class.
    --speed: world seconds per second.
    """
    from deploy.cli import compare

    setting = "partition.kind" if against in DIAGRAMS else "control.mode"
    one, other = options.scenario(scenario), options.variant(scenario, {setting: against})
    return compare.compare(one, other, page, speed, open)


@app.command(group=RUN, help_epilogue="Example: covey up efficacy --team 3 --rate 2 --page")
def up(
    scenario: ScenarioName = "convergence",
    /,
    *,
    detach: Annotated[bool, FLAG] = False,
    page: PageAddress = False,
    open: OpenPage = False,
    record: RecordFile = False,
    options: Options = RunOptions(),
) -> int:
    """Run a scenario with real processes."""
    from deploy.cli import start

    resolved = options.scenario(scenario)
    start.up(resolved, options.requested_name(resolved), detach, DisplayOptions(options.json, record, page or open, open), options.spawn)


@app.command(group=RUN, help_epilogue="Example: covey simulate efficacy --kill 30%@300 --seed 7 --json")
def simulate(
    scenario: ScenarioName = "convergence", /, *, record: RecordFile = False, trace: TraceFile = None, options: Options = RunOptions()
) -> int:
    """Run the same nodes in one process, in virtual time.

    With --rate the world waits for nobody, as on a clock. The result is printed, and kept as a run only with --run NAME or --record.
    """
    from deploy.cli.simulate import simulate_here

    resolved = options.scenario(scenario)
    clock = options.overrides().get("run.clock", "lockstep")  # that of a file is the one of processes
    return simulate_here(resolved, options.requested_name(resolved), options.json, record, trace, clock)
