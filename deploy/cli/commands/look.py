"""Commands that look at a running swarm: names, options and help."""

from typing import Annotated

from cyclopts import Parameter

from deploy.cli import completion
from deploy.cli.app import LOOK, PageAddress, RunName, SwarmName, app
from deploy.cli.options import FLAG, WHOLE


@app.command(group=LOOK, help_epilogue="Example: covey ps -a")
def ps(
    *, all: Annotated[bool, Parameter(name=("--all", "-a"), negative="")] = False, run: RunName = None, json: Annotated[bool, FLAG] = False
) -> int:
    """Every process of a running swarm: who lives, who died, when and how.

    -a: of all running swarms of this folder, and a line for each run that has ended.
    """
    from deploy.cli import process_list

    return process_list.ps(run, json, all)


@app.command(group=LOOK, help_epilogue="Example: covey watch\n         covey watch --page 9000")
def watch(*, page: PageAddress = False, run: SwarmName = None) -> int:
    """A live map and table of a running swarm; with --page in the browser.

    Keys: the arrows choose a process, k kills it, p pauses it or lets it go on, r restarts it, q quits. A swarm
    elsewhere is shown with --page alone.
    """
    from deploy.cli import listen, watch

    return listen.watch_page(page, run) if page else watch.watch(run)


@app.command(group=LOOK, help_epilogue="Example: covey logs -f s3 world\n         covey logs --run hunt --lines 20")
def logs(
    *names: Annotated[str, Parameter(help="Processes, such as s3, world, supervisor; default: all.", completer=completion.processes)],
    follow: Annotated[bool, Parameter(name=("--follow", "-f"), negative="")] = False,
    lines: Annotated[int | None, WHOLE, Parameter(name=("--lines", "-n"), help="Only the last so many.")] = None,
    json: Annotated[bool, Parameter(help="The lines as they are in the files.", negative="")] = False,
    run: Annotated[str | None, Parameter(help="Name of the run; default: the newest.", completer=completion.runs)] = None,
) -> int:
    """What the processes of a run have written, by time.

    Also of a run that has ended. -f: go on until the run ends.
    """
    from deploy.cli import logs

    return logs.logs(names, run, follow, lines, json)


@app.command(group=LOOK, help_epilogue="Example: covey echo 'estimate/*' --count 3")
def echo(key: str = "**", /, *, count: Annotated[int | None, WHOLE] = None, run: SwarmName = None) -> int:
    """What is said under a key; unknown messages raw.

    Key: truth, estimate/s3, 'gossip/*', or any key expression.
    """
    from deploy.cli import listen

    return listen.echo(key, count, run)


@app.command(group=LOOK, help_epilogue="Example: covey hz 'gossip/*' --seconds 5")
def hz(key: str = "**", /, *, seconds: float | None = None, run: SwarmName = None) -> int:
    """How often and how much is said under a key."""
    from deploy.cli import listen

    return listen.hz(key, seconds, run)


@app.command(group=LOOK, help_epilogue="Example: covey ls")
def ls(*, seconds: float = 2.0, run: SwarmName = None) -> int:
    """Who is there, and every key under which something is said."""
    from deploy.cli import listen

    return listen.ls(seconds, run)
