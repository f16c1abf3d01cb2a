"""`study robustness`: play the bouts, show how far it is, and say what came out."""

import json
import math
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from deploy.commands.studying import default_folder
from deploy.scenario import parse_set
from deploy.studies.robustness import LEVELS, Row, plan, run, summary, table, write
from protocol.settings import BadSetting

FAULT_AT, SECONDS, TRIALS = 100.0, 200.0, 10
QUICK = {"at": 40.0, "seconds": 90.0, "trials": 2}


def study(
    quick: bool,
    trials: int | None,
    seed: int | None,
    team: str | None,
    targets: str | None,
    dt: float | None,
    seconds: float | None,
    settings: list[str],
    into: Path | None,
    workers: int | None,
    as_json: bool,
    refused: dict[str, Any],
) -> int:
    """Play all bouts and write curves, table and figure."""
    for option, value in refused.items():
        if value is not None:
            raise BadSetting(f"{option} {value}: not an option of the robustness study")
    options = dict(parse_set(text) for text in settings)
    named = {"team.composition": team, "targets.count": targets and _whole(targets), "run.dt": dt or (0.5 if quick else None)}
    options |= {name: value for name, value in named.items() if value is not None}
    at = QUICK["at"] if quick else FAULT_AT
    length = seconds or (QUICK["seconds"] if quick else SECONDS)
    number = trials or (int(QUICK["trials"]) if quick else TRIALS)
    kinds = [kind for kind in LEVELS if kind != "delay"] if quick else list(LEVELS)
    bouts = plan(number, 100 if seed is None else seed, at, length, kinds, options)
    console = Console(stderr=True, highlight=False)
    columns = (TextColumn("bouts"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("bouts", total=len(bouts))
        played = run(bouts, workers, lambda done: progress.update(task, completed=done))
    folder = into or default_folder("robustness", quick)
    paths = write(played, folder)
    cells = summary(table(played))
    (console if as_json else Console(highlight=False)).print(table_of(cells, number))
    console.print(", ".join(path.name for path in paths) + f" in {folder}", soft_wrap=True)
    if as_json:
        print(json.dumps({"study": "robustness", "bouts": len(bouts), "folder": str(folder), "cells": [_finite(cell) for cell in cells]}))
    return 0


def _whole(text: str) -> int:
    if not text.isdecimal():
        raise BadSetting(f"--targets {text}: should be one whole number")
    return int(text)


def _finite(cell: Row) -> Row:
    return {name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in cell.items()}


def table_of(cells: list[Row], trials: int) -> Table:
    """The medians for people."""
    found = Table(title=f"medians of {trials} seeds; OSPA in m", title_justify="left")
    for head in ("fault", "level", "before", "first 10 s", "from 30 s on", "reference", "ratio", "recovered after s", "largest hole %"):
        found.add_column(head, justify="left" if head == "fault" else "right")
    for cell in cells:
        numbers = [f"{cell[name]:.2f}" for name in ("before", "first", "settled", "reference", "ratio")]
        recovered = f"{cell['recovery_s']:.1f}" if math.isfinite(cell["recovery_s"]) else "never"
        found.add_row(cell["kind"], f"{cell['level']:g}", *numbers, recovered, f"{100.0 * cell['largest_hole']:.2f}")
    return found
