"""The `covey` command: names, options and help; the work is in `deploy.cli`, imported when it is wanted."""

import os
import signal

if __name__ == "__main__":
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(130))  # Ctrl-C while this file imports; nothing runs yet

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported by anybody

from cyclopts import Parameter

from deploy.cli import completion as completing
from deploy.cli.app import KEEP, LOOK, RUN, STUDY, Kept, Named, Open, Options, Page, Record, Run, Trace, app
from deploy.cli.commands import setup as set_up  # noqa: F401 -- they add their commands
from deploy.cli.commands.study import study
from deploy.cli.options import FLAG, WHOLE, RunOptions, Showing

DEMO_PACE = 2.5  # world seconds per second: the 200 s of the demo take 80 s


@app.command(group=RUN, help_epilogue="Example: covey demo --seed 3")
def demo(
    *,
    page: Page = True,
    open: Open = False,
    fast: Annotated[bool, FLAG] = False,
    record: Record = False,
    options: Options = RunOptions(),
) -> int:
    """Watch a swarm work: 16 agents, 8 targets, 3 deaths at mid-run, a table.

    At a pace that the eye can follow (80 s), or --fast. In a terminal the page stays until Enter or Ctrl-C.
    """
    from deploy.cli import start as running

    paced = not fast and not options.lockstep and options.rate is None
    settings = [f"run.pace={DEMO_PACE}", *options.settings] if paced else options.settings
    chosen = replace(options, lockstep=options.lockstep or options.rate is None, settings=settings)
    resolved = chosen.scenario("convergence")
    running.demo(resolved, chosen.wish(resolved), Showing(options.json, record, page or open, open, stays=True), options.spawn)


@app.command(group=RUN, help_epilogue="Example: covey up efficacy --team 3 --rate 2 --page")
def up(
    scenario: Named = "convergence",
    /,
    *,
    detach: Annotated[bool, FLAG] = False,
    page: Page = False,
    open: Open = False,
    record: Record = False,
    options: Options = RunOptions(),
) -> int:
    """Run a scenario with real processes."""
    from deploy.cli import start as running

    resolved = options.scenario(scenario)
    running.up(resolved, options.wish(resolved), detach, Showing(options.json, record, page or open, open), options.spawn)


@app.command(group=RUN, help_epilogue="Example: covey simulate efficacy --kill 30%@300 --seed 7 --json")
def simulate(scenario: Named = "convergence", /, *, record: Record = False, trace: Trace = None, options: Options = RunOptions()) -> int:
    """Run the same nodes in one process, in virtual time.

    With --rate the world waits for nobody, as on a clock. The result is printed, and kept as a run only with --run NAME or --record.
    """
    from deploy.cli import simulate as simulating

    clock: Literal["lockstep", "realtime"] = "lockstep" if options.rate is None or options.lockstep else "realtime"
    resolved = options.scenario(scenario)
    return simulating.simulate_here(resolved, options.wish(resolved), options.json, record, trace, clock)


@app.command(group=LOOK, help_epilogue="Example: covey ps -a")
def ps(
    *, all: Annotated[bool, Parameter(name=("--all", "-a"), negative="")] = False, run: Run = None, json: Annotated[bool, FLAG] = False
) -> int:
    """Every process of a running swarm: who lives, who died, when and how.

    -a: of all running swarms of this folder, and a line for each run that has ended.
    """
    from deploy.cli import control as acting

    return acting.ps(run, json, all)


@app.command(group=LOOK, help_epilogue="Example: covey watch\n         covey watch --page 9000")
def watch(*, page: Page = False, run: Run = None) -> int:
    """A live map and table of a running swarm; with --page in the browser.

    Keys: the arrows choose a process, k kills it, p pauses it or lets it go on, r restarts it, q quits.
    """
    from deploy.cli import control as acting
    from deploy.cli import listen as looking

    return looking.watch_page(page, run) if page else acting.watch(run)


@app.command(group=LOOK, help_epilogue="Example: covey logs -f s3 world\n         covey logs --run hunt --lines 20")
def logs(
    *names: Annotated[str, Parameter(help="Processes, such as s3, world, supervisor; default: all.", completer=completing.processes)],
    follow: Annotated[bool, Parameter(name=("--follow", "-f"), negative="")] = False,
    lines: Annotated[int | None, WHOLE, Parameter(name=("--lines", "-n"), help="Only the last so many.")] = None,
    json: Annotated[bool, Parameter(help="The lines as they are in the files.", negative="")] = False,
    run: Annotated[str | None, Parameter(help="Name of the run; default: the newest.", completer=completing.runs)] = None,
) -> int:
    """What the processes of a run have written, by time.

    Also of a run that has ended. -f: go on until the run ends.
    """
    from deploy.cli import logs as reading

    return reading.logs(names, run, follow, lines, json)


@app.command(group=LOOK, help_epilogue="Example: covey echo 'estimate/*' --count 3")
def echo(key: str = "**", /, *, count: Annotated[int | None, WHOLE] = None, run: Run = None) -> int:
    """What is said under a key; unknown messages raw.

    Key: truth, estimate/s3, 'gossip/*', or any key expression.
    """
    from deploy.cli import listen as looking

    return looking.echo(key, count, run)


@app.command(group=LOOK, help_epilogue="Example: covey hz 'gossip/*' --seconds 5")
def hz(key: str = "**", /, *, seconds: float | None = None, run: Run = None) -> int:
    """How often and how much is said under a key."""
    from deploy.cli import listen as looking

    return looking.hz(key, seconds, run)


@app.command(group=LOOK, help_epilogue="Example: covey ls")
def ls(*, seconds: float = 2.0, run: Run = None) -> int:
    """Who is there, and every key under which something is said."""
    from deploy.cli import listen as looking

    return looking.ls(seconds, run)


@app.command(group=KEEP, help_epilogue="Example: covey runs")
def runs(*, json: Annotated[bool, FLAG] = False) -> int:
    """The runs that are kept, the newest first.

    Scenario, seed, when, state, steady OSPA and size of the recording.
    """
    from deploy.cli import runs as listing

    return listing.runs(json)


@app.command(group=KEEP, help_epilogue="Example: covey rm hunt hunt-2\n         covey rm --older-than 7d")
def rm(
    *names: Annotated[str, Parameter(completer=completing.recordings)],
    all: Annotated[bool, FLAG] = False,
    older_than: str | None = None,
    yes: Annotated[bool, Parameter(name=["--yes", "-y"], negative="")] = False,
) -> int:
    """Remove kept runs: by name, all ended ones, or the old ones.

    Running ones are refused. --older-than takes 30m, 12h, 7d or 2w. --all and --older-than ask first; where there is no terminal they
    need -y.
    """
    from deploy.cli import runs as listing

    return listing.rm(names, all, older_than, yes)


@app.command(group=KEEP, help_epilogue="Example: covey record hunt.mcap")
def record(file: Path | None = None, /, *, run: Run = None) -> int:
    """Record a running swarm from outside.

    Until Ctrl-C or its end; without a file into its run directory.
    """
    from deploy.cli import listen as looking

    return looking.record(file, run)


@app.command(group=KEEP, help_epilogue="Example: covey replay hunt --speed 4")
def replay(recording: Kept, /, *, page: Page = True, speed: float = 1.0, publish: Annotated[bool, FLAG] = False) -> int:
    """Play a recording on the page: play, pause, scrub, speed.

    --publish: also under the same keys.
    """
    from deploy.cli import recordings as keeping

    return keeping.replay(recording, page, speed, publish)


@app.command(group=KEEP, help_epilogue="Example: covey score hunt --csv ticks.csv")
def score(recording: Kept, /, *, csv: Path | None = None, json: Annotated[bool, FLAG] = False) -> int:
    """OSPA, GOSPA and the rest from a recording alone."""
    from deploy.cli import recordings as keeping

    return keeping.score(recording, csv, json)


@app.command(group=KEEP, help_epilogue="Example: covey export hunt --to foxglove")
def export(recording: Kept, /, *, to: Literal["csv", "parquet", "foxglove", "rerun"] = "csv", out: Path | None = None) -> int:
    """A recording as tables, or as a file for Foxglove or Rerun.

    foxglove: an MCAP file that it draws; rerun needs the package rerun-sdk.
    """
    from deploy.cli import recordings as keeping

    return keeping.export(recording, to, out)


@app.command(group=KEEP, help_epilogue="Example: covey figures hunt --animate\n         covey figures runs/study-efficacy")
def figures(what: Kept, /, *, into: Path | None = None, animate: Annotated[bool, FLAG] = False) -> int:
    """Figures for a paper, of a recorded run or of a study: PDF and PNG.

    Of a run: start, end, trajectories; a moving picture with --animate.
    """
    from deploy.extras import need

    need("figures")
    from deploy.cli import figuring
    from deploy.cli import recordings as keeping

    if figuring.is_study(Path(what)):
        return figuring.figures_of_study(Path(what), into)
    return keeping.figures(what, into, animate)


app.command(study, group=STUDY, help_epilogue="Example: covey study efficacy --quick")


@app.command(group=STUDY, help_epilogue="Example: covey bench round")
def bench(what: str = "all", /, *, json: Annotated[bool, FLAG] = False, seconds: float | None = None) -> int:
    """Measure this machine.

    What: round, simulate, live, realtime, scale, start, codec, memory, peers, page, replay, or all of them.
    --seconds: how long realtime runs each of its swarms; a minute if it is not given.
    """
    from deploy.bench import __main__ as benching

    return benching.bench(what, json, seconds)


@app.command(group=STUDY, help_epilogue="Example: covey fuzz --seeds 20")
def fuzz(*, seeds: Annotated[int, WHOLE] = 300, first: Annotated[int, WHOLE] = 1, jobs: Annotated[int | None, WHOLE] = None) -> int:
    """Small swarms under faults drawn from a seed, all invariants checked.

    Exit code 1 when a seed fails.
    """
    from deploy.cli import fuzz as fuzzing

    return fuzzing.fuzz(seeds, first, jobs)


def main() -> None:
    """Run the command line; exit codes 0 done, 1 failed, 2 bad input, 130 / 143 on signals."""
    from deploy.cli import errors as last_net

    signal.signal(signal.SIGINT, signal.default_int_handler)
    last_net.open_standard_files()
    sys.exit(last_net.caught(lambda: app(exit_on_error=False, print_error=False, result_action="return_value") or 0))


if __name__ == "__main__":
    main()
