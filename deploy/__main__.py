"""The `covey` command: names, options and help; the work is in `deploy.commands`, imported when it is wanted."""

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported by anybody

from cyclopts import App, CycloptsError, Parameter

from deploy.commands.options import FLAG, RunOptions, switch_or_text
from deploy.commands.study_options import study

Options = Annotated[RunOptions, Parameter(name="*")]
Run = Annotated[str | None, Parameter(help="Name of the run; default: the newest that is running.")]
Record = Annotated[bool | Path, Parameter(help="Record everything into this .mcap file; default: the run directory.", negative="")]
Trace = Annotated[Path | None, Parameter(help="Write the time series into this .npz, .parquet or .csv file.")]
Page = Annotated[
    bool | str, Parameter(help="Show the run on a page in the browser: a port (0: any free one), or host:port.", converter=switch_or_text)
]

app = App(
    name="covey", help="A masterless swarm of mobile sensors: every sensor is a process, and any of them may be killed.", version_flags=[]
)


@app.command
def demo(*, page: Page = True, record: Record = False, options: Options = RunOptions()) -> int:
    """Watch a swarm work: 16 agents find 8 targets, 3 agents are killed at mid-run, a table at the end."""
    from deploy.commands import running

    chosen = replace(options, run=options.run or "demo", lockstep=options.lockstep or options.rate is None)
    running.demo(chosen.scenario("convergence"), options.json, record, page, options.spawn)


@app.command
def up(
    scenario: str = "convergence",
    /,
    *,
    detach: Annotated[bool, FLAG] = False,
    page: Page = False,
    record: Record = False,
    options: Options = RunOptions(),
) -> int:
    """Run a scenario with real processes: a name (convergence, efficacy, heterogeneity, quick) or a TOML file."""
    from deploy.commands import running

    running.up(options.scenario(scenario), options.json, detach, record, page, options.spawn)


@app.command
def simulate(scenario: str = "convergence", /, *, record: Record = False, trace: Trace = None, options: Options = RunOptions()) -> int:
    """Run the same nodes in one process, in virtual time; with --rate the world waits for nobody, as on a clock."""
    from deploy.commands import simulating

    clock: Literal["lockstep", "realtime"] = "lockstep" if options.rate is None or options.lockstep else "realtime"
    return simulating.simulate_here(options.scenario(scenario), options.json, record, trace, clock)


@app.command
def check(scenario: str = "convergence", /, *, options: Options = RunOptions()) -> int:
    """Is the scenario right, and can this machine run it?"""
    from deploy.commands import checking

    return checking.check(options.scenario(scenario))


@app.command
def ps(*, run: Run = None, json: Annotated[bool, FLAG] = False) -> int:
    """Every process of a running swarm: who lives, who died, when and how."""
    from deploy.commands import acting

    return acting.ps(run, json)


@app.command
def watch(*, page: Page = False, run: Run = None) -> int:
    """A live map and table of a running swarm; with --page on a page in the browser."""
    from deploy.commands import acting, looking

    return looking.watch_page(page, run) if page else acting.watch(run)


@app.command
def record(file: Path | None = None, /, *, run: Run = None) -> int:
    """Record a running swarm from outside, until Ctrl-C or its end; default: into its run directory."""
    from deploy.commands import looking

    return looking.record(file, run)


@app.command
def echo(key: str = "**", /, *, count: int | None = None, run: Run = None) -> int:
    """What is said under a key: truth, estimate/s3, 'gossip/*', or any key expression; unknown messages raw."""
    from deploy.commands import looking

    return looking.echo(key, count, run)


@app.command
def hz(key: str = "**", /, *, seconds: float | None = None, run: Run = None) -> int:
    """How often and how much is said under a key."""
    from deploy.commands import looking

    return looking.hz(key, seconds, run)


@app.command
def ls(*, seconds: float = 2.0, run: Run = None) -> int:
    """Who is there, and every key under which something is said within a few seconds."""
    from deploy.commands import looking

    return looking.ls(seconds, run)


@app.command
def down(*, run: Run = None) -> int:
    """End a running swarm."""
    from deploy.commands import acting

    return acting.down(run)


@app.command
def kill(who: str = "", /, *, random: int | None = None, run: Run = None) -> int:
    """Kill (SIGKILL) agents of a running swarm: a name, names with commas, a number, or a share such as 30%."""
    return _act("kill", who, random, run)


@app.command
def pause(who: str = "", /, *, random: int | None = None, run: Run = None) -> int:
    """Stop agents in their tracks (SIGSTOP)."""
    return _act("pause", who, random, run)


@app.command
def resume(who: str = "100%", /, *, random: int | None = None, run: Run = None) -> int:
    """Let paused agents go on (SIGCONT); all of them unless said."""
    return _act("resume", who, random, run)


@app.command
def restart(who: str = "100%", /, *, random: int | None = None, run: Run = None) -> int:
    """Bring agents back under their names; all the dead unless said."""
    return _act("restart", who, random, run)


@app.command
def score(recording: str, /, *, csv: Path | None = None, json: Annotated[bool, FLAG] = False) -> int:
    """OSPA, GOSPA and the rest from a recording alone: a file, or the name of a run."""
    from deploy.commands import keeping

    return keeping.score(recording, csv, json)


app.command(study)


@app.command
def figures(what: str, /, *, into: Path | None = None, animate: Annotated[bool, FLAG] = False) -> int:
    """Figures for a paper, as PDF and PNG: of a study, or of a recorded run (start, end, trajectories; a moving picture with --animate)."""
    from deploy.commands import figuring, keeping

    if figuring.is_study(Path(what)):
        return figuring.figures_of_study(Path(what), into)
    return keeping.figures(what, into, animate)


@app.command
def export(recording: str, /, *, to: Literal["csv", "parquet", "foxglove", "rerun"] = "csv", out: Path | None = None) -> int:
    """A recording as tables (csv, parquet), as an MCAP file that Foxglove draws, or as a file for Rerun (needs its package)."""
    from deploy.commands import keeping

    return keeping.export(recording, to, out)


@app.command
def replay(recording: str, /, *, page: Page = True, speed: float = 1.0, publish: Annotated[bool, FLAG] = False) -> int:
    """Play a recording on the page (play, pause, scrub, speed); with --publish also under the same keys."""
    from deploy.commands import keeping

    return keeping.replay(recording, page, speed, publish)


@app.command
def bench(what: str = "all", /, *, json: Annotated[bool, FLAG] = False, seconds: float | None = None) -> int:
    """Measure this machine: round, simulate, live, realtime, scale, start, codec, memory, peers, page, replay, or all of them.

    --seconds: how long realtime runs each of its swarms; a minute if it is not given.
    """
    from deploy.commands import benching

    return benching.bench(what, json, seconds)


@app.command
def partition(who: str, /, *, kind: Literal["both", "one-way", "bridge"] = "both", run: Run = None) -> int:
    """Cut agents off from the rest of a running swarm that allows it (network.link_faults = true)."""
    from deploy.commands import acting

    return acting.act("partition", who, run, options={"kind": kind})


@app.command
def heal(*, run: Run = None) -> int:
    """Make all links of a running swarm clear again."""
    from deploy.commands import acting

    return acting.act("heal", "", run)


@app.command
def drop(share: float, who: str = "", /, *, burst: float = 0.0, run: Run = None) -> int:
    """Lose a share (0 to 1) of the messages from and to some agents, all unless said; --burst: in runs of so many."""
    from deploy.commands import acting

    return acting.act("drop", who, run, share, {"burst": burst})


@app.command
def delay(seconds: float, who: str = "", /, *, jitter: float = 0.0, run: Run = None) -> int:
    """Deliver the messages from and to some agents, all unless said, so many seconds late."""
    from deploy.commands import acting

    return acting.act("delay", who, run, seconds, {"jitter": jitter})


@app.command
def fuzz(*, seeds: int = 300, first: int = 1, jobs: int | None = None) -> int:
    """Deterministic simulation: small swarms under faults drawn from a seed, all invariants checked; exit code 1 when a seed fails."""
    from deploy.commands import fuzzing

    return fuzzing.fuzz(seeds, first, jobs)


@app.command
def keys(
    *names: str,
    into: Path = Path("keys"),
    scenario: str | None = None,
    host: tuple[str, ...] = (),
    days: int = 730,
    force: Annotated[bool, FLAG] = False,
) -> int:
    """An authority and certificates for mutual TLS: for these names, or for all of a scenario; `up --keys DIR` uses them."""
    from deploy.commands import keys as making

    return making.keys(list(names), scenario, into, host, days, force)


@app.command
def version() -> int:
    """Versions of Covey, of its wire format and of what it stands on."""
    import json

    from deploy.result import VERSION
    from deploy.swarm.rundir import versions

    print(f"covey {VERSION}")
    print(json.dumps(versions(), indent=2))
    return 0


def _act(verb: str, who: str, random: int | None, run: str | None) -> int:
    from deploy.commands import acting

    return acting.act(verb, str(random) if random is not None else who, run)


def main() -> None:
    """Run the command line; exit codes 0 done, 2 bad input, 130 / 143 on signals."""
    sys.path.append(os.getcwd())  # where a user's own sensor models and controllers are
    sys.exit(_main())


def _main() -> int:
    try:
        return app(exit_on_error=False, print_error=False) or 0
    except CycloptsError as error:
        return _complain(" ".join(str(error).split()))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        sys.stderr.close()
        return 0
    except ValueError as error:
        from protocol.settings import BadSetting

        if not isinstance(error, BadSetting):
            raise
        return _complain(str(error))


def _complain(text: str) -> int:
    print(f"covey: {text}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
