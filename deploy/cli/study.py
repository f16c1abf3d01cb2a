"""`study`: run the open trials of a study and print its result."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from deploy.cli.errors import lead_nowhere
from deploy.cli.scenario_checks import check_scenario
from deploy.scenario import resolve
from deploy.storage.run_directory import runs_folder
from deploy.studies.ablation import MethodSummary
from deploy.studies.design import Design, plan
from deploy.studies.open_trials import run_open_trials
from deploy.studies.paired import Comparison, Summary, compare, groups_of, summarise
from deploy.studies.results import StudyFolder
from deploy.studies.trials import Row, Trial, methods_of, run_trial

PLAIN_WIDTH = 180  # columns where there is no terminal


class StudyConsole(Console):
    """A console whose reader may go: the study goes on for hours, and its results are kept."""

    def on_broken_pipe(self) -> None:
        """Called while the error is handled."""
        lead_nowhere(2 if self.stderr else 1)
        self.quiet = True


def console_of(as_json: bool) -> Console:
    """The console for people: standard output, or standard error when standard output carries JSON."""
    console = StudyConsole(stderr=as_json, highlight=False, markup=False)
    return console if console.is_terminal else StudyConsole(stderr=as_json, highlight=False, markup=False, width=PLAIN_WIDTH)


def run_study(found: Design, into: Path, workers: int | None, scheduler: str | None, as_json: bool) -> int:
    """Run a study to its end. Finished trials are not repeated."""
    console = console_of(as_json)
    trials, folder = checked_plan(found), StudyFolder(into)
    with folder.claimed():
        rows = run_open_trials(found.scenario, folder, trials, workers, scheduler, console, run_trial)
        folder.publish(rows)
    show(rows, console)
    console.print(f"{_short(folder.csv)} and .parquet; covey figures {_short(into)}", soft_wrap=True)
    if as_json:
        head = {"study": found.scenario, "trials": len(rows), "folder": str(into)}
        print(json.dumps({**head, "groups": summaries(rows), "pairs": pairs(rows)}))
    return 0


def checked_plan(found: Design) -> list[Trial]:
    """The trials of a study, one of each method checked as `covey check` does it; raises BadSetting for the first mistake."""
    trials = plan(found)
    for method in found.methods:
        check_scenario(next(trial for trial in trials if trial.method == method).resolve())
    return trials


def _short(path: Path) -> str:
    """A path relative to the current folder where it lies below it."""
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)


def default_folder(name: str, quick: bool) -> Path:
    """The default folder of a study."""
    return runs_folder() / f"study-{name}{'-quick' if quick else ''}"


def take_seconds(options: dict[str, Any], scenario: str, otherwise: float) -> float:
    """Take `run.seconds` out of the settings of a study over this scenario, s; raises BadSetting for a value that it cannot have."""
    return resolve(scenario, {"run.seconds": options.pop("run.seconds", otherwise)}).run.seconds


def show(rows: Sequence[Row], console: Console) -> None:
    """The medians by team, number of targets and method, and what the first method gains over the others on the same seeds."""
    methods = methods_of(rows)
    table = Table(title="steady OSPA, m: median (least - greatest)", title_justify="left", box=None)
    for head in ("team", "targets", *methods, *(f"{methods[0]} against {other}" for other in methods[1:]), "in view at the end"):
        table.add_column(head)
    for group in groups_of(rows):
        found = [summarise(rows, group, method) for method in methods]
        cells = [f"{one.ospa:.2f} ({one.low:.2f} - {one.high:.2f})" if one else "-" for one in found]
        gains = [_gain(compare(rows, group, methods[0], other)) for other in methods[1:]]
        in_view = " / ".join(f"{100.0 * one.in_view:.0f}" if one else "-" for one in found)
        table.add_row(group.team, str(group.targets), *cells, *gains, f"{in_view} %")
    console.print(table)
    console.print(
        "gain: mean difference on the same seeds with its interval of 95 %, seeds won, p of Wilcoxon's signed-rank test; "
        "in view: share of targets over the last 5 s",
        soft_wrap=True,
    )


def _gain(pair: Comparison | None) -> str:
    """A comparison in a cell."""
    if pair is None:
        return "-"
    low, high = pair.low or 0.0, pair.high or 0.0
    gain = "-" if pair.gain is None else f"{100 * pair.gain:+.0f} % ({100 * low:.0f} to {100 * high:.0f})"
    return f"{gain}, {pair.wins}/{len(pair.seeds)}, {_p(pair.wilcoxon)}"


def _p(value: float | None) -> str:
    return "p -" if value is None else f"p {value:.3f}" if value >= 0.001 else "p < .001"


def summaries(rows: Sequence[Row]) -> list[dict[str, object]]:
    """The table as plain values."""
    found = [summarise(rows, group, method) for group in groups_of(rows) for method in methods_of(rows)]
    return [plain(one) for one in found if one]


def pairs(rows: Sequence[Row]) -> list[dict[str, object]]:
    """The comparisons of the first method with each other one as plain values."""
    first, *others = methods_of(rows)
    found = [compare(rows, group, first, other) for group in groups_of(rows) for other in others]
    return [plain(pair) for pair in found if pair]


def plain(one: Summary | Comparison | MethodSummary) -> dict[str, object]:
    """A tuple with its group's fields in place of the group."""
    fields = one._asdict()
    return {**fields.pop("group")._asdict(), **fields}
