"""`study bodies`: play the open runs, show the progress, print the table."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from deploy.cli.study import console_of, take_seconds
from deploy.studies.bodies import MODELS, RADIUS, SCENARIO, plan, play, summary
from deploy.studies.open_trials import run_open_trials
from deploy.studies.results import StudyFolder
from deploy.studies.trials import Row
from protocol.settings import BadSetting

FULL = {"trials": 200, "seconds": 300.0}
QUICK = {"trials": 4, "seconds": 60.0}


def run_body_study(
    quick: bool, fields: dict[str, Any], options: dict[str, Any], into: Path, workers: int | None, scheduler: str | None, as_json: bool
) -> int:
    """Play all runs and write results.csv and results.parquet. Finished runs are not repeated."""
    from deploy.installation import need_packages

    size, options = QUICK if quick else FULL, dict(options)
    seconds = take_seconds(options, SCENARIO, size["seconds"])
    models = fields.get("methods", tuple(MODELS))
    if "teams" in fields:
        if len(fields["teams"]) > 1:
            raise BadSetting(f"--teams {','.join(fields['teams'])}: should be one team in this study")
        options["team.composition"] = fields["teams"][0].replace("+", ",")
    if "targets" in fields:
        if len(fields["targets"]) > 1:
            raise BadSetting(f"--targets {','.join(map(str, fields['targets']))}: should be one number in this study")
        options["targets.count"] = fields["targets"][0]
    if "mujoco" in models:
        need_packages("study bodies", ("mujoco",), "mujoco")
    runs = plan(int(fields.get("trials", size["trials"])), fields.get("first_seed", 1), seconds, models, options)
    console, folder = console_of(as_json), StudyFolder(into)
    with folder.claimed():
        rows = run_open_trials("bodies", folder, runs, workers, scheduler, console, play)
        folder.publish(rows)
    lines = summary(rows)
    console.print(table_of(lines))
    console.print(f"results.csv, results.parquet in {into}", soft_wrap=True)
    if as_json:
        print(json.dumps({"study": "bodies", "runs": len(rows), "folder": str(into), "lines": lines}))
    return 0


def table_of(lines: Sequence[Row]) -> Table:
    """The table for people."""
    title = f"two bodies touch at {2.0 * RADIUS:g} m; ratio of steady OSPA to points of the same seeds: median (quartiles)"
    table = Table(title=title, title_justify="left", box=None)
    heads = ("bodies", "runs", "seeds", "wrecks", "touches", "in runs", "least distance, m", "median of runs, m", "ratio", "ratio of means")
    for head in heads:
        table.add_column(head, justify="left" if head == "bodies" else "right")
    for line in lines:
        seeds, runs = f"{line['first_seed']} to {line['last_seed']}", f"{line['runs']} x {line['seconds']:g} s"
        counts = [str(line[name]) for name in ("wrecks", "touches", "runs_with_touches")]
        distances = [f"{line[name]:.3f}" for name in ("least_distance", "median_distance")]
        ratios = ["-", "-"]
        if line["pairs"]:
            ratios = [f"{line['ratio']:.2f} ({line['ratio_low']:.2f} - {line['ratio_high']:.2f})", f"{line['ratio_of_means']:.2f}"]
        table.add_row(line["model"], runs, seeds, *counts, *distances, *ratios)
    return table
