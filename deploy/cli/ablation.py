"""`study ablation`: run the open trials, write table and figure, print the table."""

import json
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from deploy.cli.study import checked_plan, console_of, plain
from deploy.studies.ablation import PARTS, MethodSummary, lines
from deploy.studies.design import OPEN_TEAMS, Design
from deploy.studies.open_trials import run_open_trials
from deploy.studies.results import StudyFolder
from deploy.studies.trials import run_trial


def run_ablation_study(found: Design, into: Path, workers: int | None, scheduler: str | None, as_json: bool) -> int:
    """Run the ablation to its end. Finished trials are not repeated."""
    from deploy.plots.ablation_figure import write

    console, folder = console_of(as_json), StudyFolder(into)
    with folder.claimed():
        rows = run_open_trials("ablation", folder, checked_plan(found), workers, scheduler, console, run_trial)
        folder.publish(rows)
        summary = lines(rows)
        paths = write(summary, into)
    console.print(table_of(summary))
    console.print(", ".join(path.name for path in paths) + f" in {into}", soft_wrap=True)
    if as_json:
        print(json.dumps({"study": "ablation", "trials": len(rows), "folder": str(into), "lines": [plain(line) for line in summary]}))
    return 0


def table_of(summary: Sequence[MethodSummary]) -> Table:
    """The table for people."""
    table = Table(
        title="mean OSPA and its parts, m; gain over the paper's method with its interval of 95 %", title_justify="left", box=None
    )
    for head in ("team", "targets", "method", "seeds", "OSPA", "GOSPA", *(part.replace("_", " ") for part in PARTS), "gain"):
        table.add_column(head, justify="left" if head in ("team", "method") else "right")
    for line in summary:
        gain = "-" if line.gain is None else f"{100 * line.gain:.0f} % ({100 * (line.low or 0.0):.0f} to {100 * (line.high or 0.0):.0f})"
        numbers = [f"{line.ospa:.2f}", f"{line.gospa:.1f}", *(f"{part:.2f}" for part in line.parts)]
        table.add_row(
            OPEN_TEAMS.get(line.group.team, line.group.team), str(line.group.targets), line.method, str(line.seeds), *numbers, gain
        )
    return table
