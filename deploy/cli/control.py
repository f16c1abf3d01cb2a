"""`ps`, `kill`, `pause`, `resume`, `restart`, `down` and `watch`: commands that act on a running swarm from another terminal."""

import json
import sys
import time
from typing import Any

from rich.console import Console

from deploy.cli import process_list as ended
from deploy.cli import watch as board
from deploy.cli.display import process_table, swarm_line
from deploy.live.control import ControlClient
from deploy.storage.run_directory import find_running
from protocol.settings import BadSetting

WATCH_PERIOD = 0.5  # s
DOWN_SECONDS = 20.0
PLAIN_WIDTH = 160  # columns where there is no terminal


def meant(verb: str, names: tuple[str, ...], random: int | None, otherwise: str | None) -> str:
    """Who is meant, as one text: names, a share or a number; `otherwise` when nobody is named. Raises BadSetting."""
    if not names and random is None and otherwise is None:
        raise BadSetting(f"{verb}: nobody is named; give names such as s3, a number such as 4, or a share such as 30%")
    if random is not None and names:
        raise BadSetting(f"--random {random}: draws agents; {' '.join(names)} names them: give one of both")
    drawn = [name for name in names if name.isdecimal() or name.endswith("%")]
    if drawn and len(names) > 1:
        raise BadSetting(f"{' '.join(names)}: should be names, or one number or share such as {drawn[0]}")
    return str(random) if random is not None else ",".join(names) or str(otherwise)


def act(verb: str, who: str, run: str | None, value: float | None = None, options: dict[str, Any] | None = None) -> int:
    """Ask the supervisor of a run to do something to somebody."""
    client = ControlClient(find_running(run))
    print(client.ask(verb, who, value, options)["ok"])
    return 0


def ps(run: str | None, as_json: bool, everything: bool = False) -> int:
    """All processes of a running swarm; with `everything` of all running swarms of this folder, and the runs that have ended."""
    if everything:
        return ended.ps_all(run, as_json)
    data = ControlClient(find_running(run)).ask("status")["data"]
    if as_json:
        print(json.dumps(data))
    else:
        Console(highlight=False, width=None if sys.stdout.isatty() else PLAIN_WIDTH).print(process_table(data))
    return 0


def down(run: str | None) -> int:
    """End a run and wait until it has ended."""
    directory = find_running(run)
    ControlClient(directory).ask("down")
    end = time.monotonic() + DOWN_SECONDS
    while directory.is_running():
        if time.monotonic() > end:
            raise BadSetting(f"--run {directory.name}: still running after {DOWN_SECONDS:g} s")
        time.sleep(0.05)
    print(f"run {directory.name} is down")
    return 0


def watch(run: str | None) -> int:
    """A live picture until the run ends or q is pressed; plain lines where there is no terminal."""
    client = ControlClient(find_running(run))
    console = Console(highlight=False)
    try:
        if not console.is_terminal:
            while True:
                print(watch_line(client.ask("status")["data"]), flush=True)
                time.sleep(2.0 * WATCH_PERIOD)
        board.show(client.ask, console)
        return 0
    except BadSetting as error:
        console.print(str(error))
        return 0


def watch_line(data: dict[str, Any]) -> str:
    """A swarm in one line, the dead by name and how they ended."""
    rows = data["processes"]
    dead = ", ".join(f"{row['name']} ({row['end']})" for row in rows if row["state"] == "dead" and row["end"])
    paused = ", ".join(row["name"] for row in rows if row["state"] == "paused")
    return swarm_line(data["swarm"]) + (f"  dead: {dead}" if dead else "") + (f"  paused: {paused}" if paused else "")
