"""`runs` and `rm`: the runs that are kept, listed and removed."""

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from deploy.cli.terminal import table_console
from deploy.storage.kept_runs import KeptRun, age_of, kept_runs, removable, remove
from deploy.storage.run_directory import RunDirectory, runs_folder
from protocol.settings import BadSetting

STYLES = {"running": "green", "interrupted": "yellow", "failed": "red"}


def runs(as_json: bool) -> int:
    """List the runs that are kept, the newest first."""
    found = kept_runs()
    if as_json:
        print(json.dumps([kept._asdict() for kept in found]))
        return 0
    console = table_console()
    if not found:
        console.print(f"no run is kept in {runs_folder()}", soft_wrap=True)
        return 0
    table = Table(box=None)
    for head in ("name", "scenario", "seed", "when", "state", "OSPA, m", "recording"):
        table.add_column(head, justify="right" if head in ("seed", "OSPA, m", "recording") else "left", overflow="fold")
    for kept in found:
        table.add_row(*_cells(kept), style=STYLES.get(kept.state, ""))
    console.print(table)
    return 0


def _cells(kept: KeptRun) -> list[str]:
    when = time.strftime("%Y-%m-%d %H:%M", time.localtime(kept.began))
    scenario = Path(kept.scenario).name + (" (simulated)" if kept.simulated else "")
    ospa = "" if kept.ospa is None else f"{kept.ospa:.2f}"
    size = f"{kept.recording_bytes / 1e6:.1f} MB" if kept.recording_bytes else ""
    return [kept.name, scenario, "" if kept.seed is None else str(kept.seed), when, kept.state, ospa, size]


def rm(names: Sequence[str], everything: bool, older_than: str | None, yes: bool) -> int:
    """Remove the runs that are named, or after a question all ended ones or those of some age."""
    if bool(names) + everything + (older_than is not None) != 1:
        raise BadSetting("rm: give names of runs, or --all, or --older-than 7d; `covey runs` lists them")
    if names:
        return _remove([removable(name) for name in names])
    found = kept_runs()
    limit = time.time() - age_of(older_than) if older_than is not None else None
    chosen = [kept for kept in found if kept.state != "running" and (limit is None or kept.began < limit)]
    running = ", ".join(kept.name for kept in found if kept.state == "running")
    if running:
        print(f"still running, and kept: {running}")
    if not chosen:
        print("no run to remove")
        return 0
    if not yes and not _agreed(chosen):
        return 0
    return _remove([removable(kept.name) for kept in chosen])


def _agreed(chosen: Sequence[KeptRun]) -> bool:
    """Whether the user in the terminal answers yes; raises BadSetting without a terminal."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise BadSetting(f"rm: would remove {len(chosen)} runs; add -y, for there is no terminal to ask")
    print("\n".join(kept.name for kept in chosen))
    try:
        return input(f"remove these {len(chosen)} runs? [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        return False


def _remove(directories: Sequence[RunDirectory]) -> int:
    for name, directory in {directory.name: directory for directory in directories}.items():
        remove(directory)
        print(f"removed {name}")
    return 0
