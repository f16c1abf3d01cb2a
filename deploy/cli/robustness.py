"""`study robustness`: run the open bouts, show the progress, print the result."""

import json
import math
from pathlib import Path
from typing import Any

from rich.table import Table

from deploy.cli.study import console_of, take_seconds
from deploy.studies.open_trials import run_open_trials
from deploy.studies.results import StudyFolder
from deploy.studies.robustness import FRESH, LEVELS, NONE, SCENARIO, Row, plan, play, summary, table
from protocol.settings import BadSetting

FULL = {"at": 60.0, "seconds": 150.0, "trials": 10}
QUICK = {"at": 40.0, "seconds": 90.0, "trials": 2}
DT = 0.5  # s unless it is said


def settings_of(team: str | None, targets: str | None, methods: str | None) -> dict[str, Any]:
    """The settings that team and targets stand for; raises BadSetting for options that this study does not have."""
    if methods is not None:
        raise BadSetting(f"--methods {methods}: not an option of the robustness study; --set partition.kind=voronoi chooses another")
    if targets is not None and not targets.isdecimal():
        raise BadSetting(f"--targets {targets}: should be one whole number")
    named = {"team.composition": team, "targets.count": None if targets is None else int(targets)}
    return {name: value for name, value in named.items() if value is not None}


def kinds_of(faults: str | None) -> tuple[str, ...]:
    """The kinds of bouts that are played for faults with commas between them, their references included; raises BadSetting."""
    named = tuple(LEVELS) if faults is None else tuple(part.strip() for part in faults.split(","))
    for name in named:
        if name not in LEVELS:
            raise BadSetting(f"--faults {faults}: should be one or more of {', '.join(LEVELS)}")
    return (NONE, *named, *([FRESH] if "kill" in named else []))


def run_robustness_study(
    quick: bool,
    trials: int | None,
    seed: int | None,
    faults: str | None,
    options: dict[str, Any],
    into: Path,
    workers: int | None,
    scheduler: str | None,
    as_json: bool,
) -> int:
    """Play all bouts and write curves, tables and figure."""
    from deploy.plots.robustness_figure import write

    size = QUICK if quick else FULL
    options = {"run.dt": DT, **options}
    seconds = take_seconds(options, SCENARIO, size["seconds"])
    number = int(size["trials"]) if trials is None else trials
    kinds, folder = kinds_of(faults), StudyFolder(into)
    bouts = [bout for bout in plan(number, 100 if seed is None else seed, size["at"], seconds, options) if bout.kind in kinds]
    console = console_of(as_json)
    with folder.claimed():
        rows = run_open_trials("robustness", folder, bouts, workers, scheduler, console, play)
        paths = write(rows, into)
    cells = summary(table(rows))
    console.print(table_of(cells, number))
    console.print(", ".join(path.name for path in paths) + f" in {into}", soft_wrap=True)
    if as_json:
        print(json.dumps({"study": "robustness", "bouts": len(bouts), "folder": str(into), "cells": [_finite(cell) for cell in cells]}))
    return 0


def _finite(cell: Row) -> Row:
    return {name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in cell.items()}


def table_of(cells: list[Row], trials: int) -> Table:
    """The medians for people."""
    found = Table(title=f"medians of {trials} seeds (lower - upper quartile); OSPA in m", title_justify="left", box=None)
    heads = ("fault", "level", "agents left", "before", "first 10 s", "from 30 s on", "reference", "ratio", "recovered after s", "hole %")
    for head in heads:
        found.add_column(head, justify="left" if head == "fault" else "right")
    for cell in cells:
        numbers = [f"{cell[name]:.2f}" for name in ("before", "first", "settled", "reference")]
        ratio = f"{cell['ratio']:.2f} ({cell['ratio_low']:.2f} - {cell['ratio_high']:.2f})"
        recovered = f"{cell['recovery_s']:.1f}" if math.isfinite(cell["recovery_s"]) else "never"
        hole = f"{100.0 * cell['largest_hole']:.2f}"
        found.add_row(cell["kind"], f"{cell['level']:g}", str(cell["agents"]), *numbers, ratio, recovered, hole)
    return found
