"""`ps`: the processes of a running swarm; with -a of all running swarms of this folder, and the runs that have ended."""

import contextlib
import json
import os
import re
import time
from typing import Any

from rich.console import Console
from rich.table import Table

from deploy.cli.display import process_table
from deploy.cli.logs import LogTails, runs_with_logs
from deploy.cli.terminal import table_console
from deploy.cli.watch import fit
from deploy.live.control import ControlClient
from deploy.storage.run_directory import RunDirectory, find_running
from protocol.settings import BadSetting, read_toml

DEATH = re.compile(r"^(\S+) ended: (.*)$")


def ps(run: str | None, as_json: bool, everything: bool = False) -> int:
    """All processes of a running swarm; with `everything` of all running swarms of this folder, and the runs that have ended."""
    if everything:
        return ps_all(run, as_json)
    data = ControlClient(find_running(run, supervised=True)).ask("status")["data"]
    if as_json:
        print(json.dumps(data))
    else:
        print_processes(data, table_console())
    return 0


def print_processes(data: dict[str, Any], console: Console) -> None:
    """Print the table of the processes of a swarm with as many columns as there is room for."""
    table = process_table(data)
    fit(table, console)
    console.print(table)


def ps_all(run: str | None, as_json: bool) -> int:
    """Print the running swarms as `ps` does, and below them what has ended."""
    if run is not None:
        raise BadSetting(f"--run {run}: -a shows all runs; leave one of both out")
    data, silent, gone = [], [], []
    for directory in runs_with_logs():
        if not directory.is_running():
            with contextlib.suppress(FileNotFoundError):  # it is being removed
                gone.append(ended_run(directory))
            continue
        try:
            data.append(ControlClient(find_running(directory.name, supervised=True)).ask("status")["data"])
        except BadSetting as error:  # it starts, or ends, or has no supervisor
            silent.append(str(error))
    if as_json:
        print(json.dumps({"running": data, "ended": gone}))
        return 0
    console = table_console()
    for one in data:
        print_processes(one, console)
    for why in silent:
        console.print(why)
    if gone:
        console.print(ended_table(gone))
    if not data and not gone and not silent:
        console.print("no run has been started here")
    return 0


def ended_run(directory: RunDirectory) -> dict[str, Any]:
    """Facts about a run that has ended: its scenario, its end, its dead agents and bodies, and its result file."""
    try:
        config = read_toml(directory.config)
    except BadSetting:  # it ended before it wrote its configuration
        config = {}
    entries = LogTails(directory, ("supervisor",)).read()
    deaths = [match for entry in entries if (match := DEATH.match(str(entry.fields.get("message", "")))) and not _left(*match.groups())]
    return {
        "run": directory.name,
        "scenario": config.get("run", {}).get("scenario", ""),
        "agents": len(config.get("members", {})),
        "ended_at": entries[-1].time if entries else directory.logs.stat().st_mtime,
        "deaths": [{"name": match[1], "end": match[2]} for match in deaths],
        "result": os.path.relpath(directory.result) if directory.result.exists() else None,
    }


def _left(name: str, end: str) -> bool:
    """Whether a process ended because the run did: the world, or a body after the last tick."""
    return name == "world" or (name.endswith(".body") and end == "exit code 0")


def ended_table(runs: list[dict[str, Any]]) -> Table:
    """The runs that have ended, one a line."""
    table = Table(title="ended", title_justify="left", box=None)
    for head in ("run", "scenario", "agents", "ended", "died before", "result"):
        table.add_column(head, justify="right" if head == "agents" else "left")
    for run in runs:
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run["ended_at"]))
        died = ", ".join(f"{death['name']} ({death['end']})" for death in run["deaths"])
        table.add_row(run["run"], run["scenario"], str(run["agents"]), when, died or "-", run["result"] or "none")
    return table
