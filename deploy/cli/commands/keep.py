"""Commands on what is kept of runs: names, options and help."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from deploy.cli import completion
from deploy.cli.app import KEEP, PageAddress, RecordingName, SwarmName, app
from deploy.cli.options import FLAG


@app.command(group=KEEP, help_epilogue="Example: covey runs")
def runs(*, json: Annotated[bool, FLAG] = False) -> int:
    """The runs that are kept, the newest first.

    Scenario, seed, when, state, steady OSPA and size of the recording.
    """
    from deploy.cli import runs

    return runs.runs(json)


@app.command(group=KEEP, help_epilogue="Example: covey rm hunt hunt-2\n         covey rm --older-than 7d")
def rm(
    *names: Annotated[str, Parameter(completer=completion.runs)],
    all: Annotated[bool, FLAG] = False,
    older_than: str | None = None,
    yes: Annotated[bool, Parameter(name=["--yes", "-y"], negative="")] = False,
) -> int:
    """Remove kept runs: by name, all ended ones, or the old ones.

    Running ones are refused. --older-than takes 30m, 12h, 7d or 2w. --all and --older-than ask first; where there is no terminal they
    need -y.
    """
    from deploy.cli import runs

    return runs.rm(names, all, older_than, yes)


@app.command(group=KEEP, help_epilogue="Example: covey record hunt.mcap")
def record(file: Path | None = None, /, *, run: SwarmName = None) -> int:
    """Record a running swarm from outside.

    Until Ctrl-C or its end; without a file into its run directory.
    """
    from deploy.cli import listen

    return listen.record(file, run)


@app.command(group=KEEP, help_epilogue="Example: covey replay hunt --speed 4")
def replay(recording: RecordingName, /, *, page: PageAddress = True, speed: float = 1.0, publish: Annotated[bool, FLAG] = False) -> int:
    """Play a recording on the page: play, pause, scrub, speed.

    --publish: also under the same keys.
    """
    from deploy.cli import recordings

    return recordings.replay(recording, page, speed, publish)


@app.command(group=KEEP, help_epilogue="Example: covey score hunt --csv ticks.csv")
def score(recording: RecordingName, /, *, csv: Path | None = None, json: Annotated[bool, FLAG] = False) -> int:
    """OSPA, GOSPA and the rest from a recording alone."""
    from deploy.cli import recordings

    return recordings.score(recording, csv, json)


@app.command(group=KEEP, help_epilogue="Example: covey export hunt --to geojson --origin 50.7 -1.2")
def export(
    recording: RecordingName,
    /,
    *,
    to: Literal["csv", "parquet", "foxglove", "rerun", "mot", "geojson", "cot"] = "csv",
    out: Path | None = None,
    origin: Annotated[tuple[float, float] | None, Parameter(negative="")] = None,
    began: str | None = None,
) -> int:
    """A recording as tables, or as files of other tools.

    foxglove: an MCAP file that it draws; rerun needs the package rerun-sdk; mot: a folder as of the MOT challenge.
    geojson and cot (Cursor-on-Target, an event a line) lie on Earth: --origin LATITUDE LONGITUDE says where (0, 0) of the arena is, unless
    the world is one of ships; --began 2016-01-12T13:02:11Z when the run began, else the clock of the recorder.
    """
    from deploy.cli import recordings

    return recordings.export(recording, to, out, origin, began)


@app.command(group=KEEP, help_epilogue="Example: covey figures hunt --animate\n         covey figures runs/study-efficacy")
def figures(
    what: RecordingName, /, *, into: Path | None = None, animate: Annotated[bool, FLAG] = False, explain: Annotated[bool, FLAG] = False
) -> int:
    """Figures for a paper, of a recorded run or of a study: PDF and PNG.

    Of a run: start, end, trajectories; a moving picture with --animate; the method in pictures with --explain.
    """
    from deploy.installation import need_study_packages

    need_study_packages("figures")
    from deploy.cli import figures

    return figures.draw(what, into, animate, explain)
