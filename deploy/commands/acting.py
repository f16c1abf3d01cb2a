"""`ps`, `kill`, `pause`, `resume`, `restart`, `down` and `watch`: commands that act on a running swarm from another terminal."""

import json
import sys
import time
from typing import Any

from rich.console import Console, Group
from rich.live import Live

from deploy.commands.display import process_table, swarm_line
from deploy.field import swarm_map
from deploy.swarm.control import ControlClient
from deploy.swarm.rundir import find_running
from protocol.settings import BadSetting

WATCH_PERIOD = 0.5  # s
DOWN_SECONDS = 20.0
PLAIN_WIDTH = 160  # columns where there is no terminal


def act(verb: str, who: str, run: str | None, value: float | None = None, options: dict[str, Any] | None = None) -> int:
    """Ask the supervisor of a run to do something to somebody."""
    client = ControlClient(find_running(run))
    print(client.ask(verb, who, value, options)["ok"])
    return 0


def ps(run: str | None, as_json: bool) -> int:
    """All processes of a running swarm."""
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
    """A live table until the run ends; plain lines where there is no terminal."""
    client = ControlClient(find_running(run))
    console = Console(highlight=False)
    try:
        if not console.is_terminal:
            while True:
                print(watch_line(client.ask("status")["data"]), flush=True)
                time.sleep(2.0 * WATCH_PERIOD)
        with Live(console=console, refresh_per_second=4) as live:
            while True:
                data = client.ask("status")["data"]
                room = console.height - len(data["processes"]) - 6
                live.update(Group(swarm_map(data["swarm"], data["processes"], room), process_table(data)))
                time.sleep(WATCH_PERIOD)
    except BadSetting as error:
        console.print(str(error))
        return 0


def watch_line(data: dict[str, Any]) -> str:
    """A swarm in one line, the dead by name and how they ended."""
    rows = data["processes"]
    dead = ", ".join(f"{row['name']} ({row['end']})" for row in rows if row["state"] == "dead" and row["end"])
    paused = ", ".join(row["name"] for row in rows if row["state"] == "paused")
    return swarm_line(data["swarm"]) + (f"  dead: {dead}" if dead else "") + (f"  paused: {paused}" if paused else "")
