"""`study`: run the trials of a study that are not done yet, show how far it is, and say what came out."""

import json
import math
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn
from rich.table import Table

from deploy.scenario import parse_set
from deploy.storage.run_directory import runs_folder
from deploy.studies.engines import Job, Numbered, Play, Rows, Shares, TrialFailed, on_a_cluster, on_this_machine, shared_shares
from deploy.studies.paired import compare, groups_of, summarise
from deploy.studies.study import Design, Folder, design, methods_of, plan
from deploy.studies.trials import Row, cost, run_trial
from protocol.settings import BadSetting

PLAIN_WIDTH = 180  # columns where there is no terminal
PLAIN_PERIOD = 20.0  # s between two lines where there is no terminal


def study(found: Design, into: Path, workers: int | None, scheduler: str | None, as_json: bool) -> int:
    """Run a study to its end; what is finished already is not run again."""
    console = console_of(as_json)
    trials, folder = plan(found), Folder(into)
    with folder.claimed():
        rows = play_open(found.scenario, folder, trials, workers, scheduler, console, run_trial)
        folder.publish(rows)
    show(rows, console)
    console.print(f"{_short(folder.csv)} and .parquet; covey figures {_short(into)}", soft_wrap=True)
    if as_json:
        print(json.dumps({"study": found.scenario, "trials": len(rows), "folder": str(into), "groups": summaries(rows)}))
    return 0


def console_of(as_json: bool) -> Console:
    """For people: standard output, or standard error where that is for programs."""
    console = Console(stderr=as_json, highlight=False)
    return console if console.is_terminal else Console(stderr=as_json, highlight=False, width=PLAIN_WIDTH)


def play_open(
    name: str, folder: Folder, trials: Sequence[Job], workers: int | None, scheduler: str | None, console: Console, play: Play
) -> list[Row]:
    """The rows of all trials in their order: those that the folder has not are played first."""
    done = folder.finished()
    open_trials = [(number, trial) for number, trial in enumerate(trials) if trial.key() not in done]
    count = len(trials) - len(open_trials)
    console.print(f"{name}: {len(trials)} trials" + (f", {count} of them done already" if count else "") + f"; {folder.path}")
    if open_trials:
        _run(folder, trials, open_trials, workers or os.cpu_count() or 1, scheduler, console, play)
    finished = folder.finished()
    return [finished[trial.key()] for trial in trials]


def _short(path: Path) -> str:
    """A path as one would type it here."""
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)


def given(trials: int | None, seed: int | None, teams: str | None, targets: str | None, methods: str | None) -> dict[str, Any]:
    """The fields of a design that the command line names; raises BadSetting naming the option."""
    if trials is not None and trials < 1:
        raise BadSetting(f"--trials {trials}: should be at least 1")
    if seed is not None and not 0 <= seed < 2**62:
        raise BadSetting(f"--seed {seed}: should be a whole number from 0 to 2**62")
    numbers = _parts(targets)
    if numbers is not None and not all(part.isdecimal() for part in numbers):
        raise BadSetting(f"--targets {targets}: should be whole numbers with commas, such as 30,40,50")
    counts = None if numbers is None else tuple(map(int, numbers))
    named = {"trials": trials, "first_seed": seed, "teams": _parts(teams), "targets": counts, "methods": _parts(methods)}
    return {field: value for field, value in named.items() if value is not None}


def _parts(text: str | None) -> tuple[str, ...] | None:
    """The words between commas, each once."""
    return None if text is None else tuple(dict.fromkeys(part.strip() for part in text.split(",")))


def options_of(triple: str | None, capacity: str | None, dt: float | None, seconds: float | None, settings: list[str]) -> dict[str, Any]:
    """The dotted settings that the command line names."""
    named = {"team.triple": triple, "capacity.mode": capacity, "run.dt": dt, "run.seconds": seconds}
    return {**{dotted: value for dotted, value in named.items() if value is not None}, **dict(map(parse_set, settings))}


def chosen(name: str, quick: bool, given: dict[str, Any], options: dict[str, Any]) -> Design:
    """A study with the options of the command line laid over it."""
    found = design(name, quick)
    return msgspec.structs.replace(found, **given, options={**found.options, **options})


def default_folder(name: str, quick: bool) -> Path:
    """Where a study goes unless it is said."""
    return runs_folder() / f"study-{name}{'-quick' if quick else ''}"


def _run(
    folder: Folder, trials: Sequence[Job], todo: Sequence[Numbered], workers: int, scheduler: str | None, console: Console, play: Play
) -> None:
    """Run what is to do, row by row into the folder."""
    shares = shared_shares(len(trials))
    engine = on_a_cluster(todo, scheduler, play) if scheduler else on_this_machine(todo, min(workers, len(todo)), shares, play)
    ahead = Ahead(trials, todo, shares)
    previous = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that workers are ended on the way out
    try:
        with closing(engine), _bar(console, len(trials), ahead) as show_progress:
            _follow(engine, folder, trials, ahead, show_progress)
    except TrialFailed as error:
        raise BadSetting(f"a trial failed, the others are kept: {error}") from error
    except KeyboardInterrupt:
        console.print(f"stopped; {ahead.finished} of {len(trials)} trials are kept in {folder.path}, the same command goes on")
        raise
    finally:
        signal.signal(signal.SIGTERM, previous)


def _follow(engine: Rows, folder: Folder, trials: Sequence[Job], ahead: "Ahead", tell: "Bar") -> None:
    for rows in engine:
        for number, row in rows:
            if row["key"] != trials[number].key():
                raise BadSetting(f"a worker runs another program ({row['code']}) than this one; start again with one version")
            folder.add(row)
            ahead.finish(number)
        tell.show()


class Ahead:
    """How much of a study is left: work is measured by the cost of a trial, speed by what this start has done in its time."""

    def __init__(self, trials: Sequence[Job], todo: Sequence[Numbered], shares: Shares) -> None:
        self._costs = {number: cost(trial.resolve()) for number, trial in todo}
        self._shares = shares
        self._open = set(self._costs)
        self.finished = len(trials) - len(todo)
        self._started = time.monotonic()

    def finish(self, number: int) -> None:
        """A trial is done."""
        self._open.discard(number)
        self.finished += 1

    def elapsed(self) -> float:
        """s since the start."""
        return time.monotonic() - self._started

    def share(self) -> float:
        """Share of the work of this start that is done."""
        left = sum(self._costs[number] * (1.0 - self._shares[number]) for number in self._open)
        return 1.0 - left / sum(self._costs.values())

    def seconds(self) -> float | None:
        """s that are left if it goes on like this; None until there is something to judge by."""
        share = self.share()
        return None if share < 0.01 or self.elapsed() < 2.0 else remaining(share, self.elapsed())

    def running(self) -> int:
        """Trials under way."""
        return sum(self._shares[number] > 0.0 for number in self._open)


def remaining(share: float, elapsed: float) -> float:
    """s that are left when `share` of the work took `elapsed` s."""
    return elapsed * (1.0 - share) / share


def words(seconds: float) -> str:
    """A duration as people say it, rounded up: 45 s, 12 min, 3 h 20 min."""
    if seconds < 90.0:
        return f"{max(1, math.ceil(seconds))} s"
    minutes = math.ceil(seconds / 60.0)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


class Bar:
    """Shows how far a study is: a bar in a terminal, a line now and then elsewhere."""

    def __init__(self, console: Console, ahead: Ahead, total: int, progress: Progress | None) -> None:
        self._console, self._ahead, self._total, self._progress = console, ahead, total, progress
        self._task: TaskID | None = progress.add_task("", total=total, completed=ahead.finished) if progress else None
        self._said_at = -PLAIN_PERIOD

    def show(self) -> None:
        """Show how far it is now."""
        left = self._ahead.seconds()
        text = f"about {words(left)} left" if left is not None else "estimating"
        if self._progress and self._task is not None:
            self._progress.update(self._task, completed=self._ahead.finished, description=text)
        elif time.monotonic() - self._said_at >= PLAIN_PERIOD:
            self._said_at = time.monotonic()
            done = f"{self._ahead.finished} of {self._total} trials, {self._ahead.running()} running"
            self._console.print(f"{done}, {self._ahead.elapsed():.0f} s so far, {text}", soft_wrap=True)


@contextmanager
def _bar(console: Console, total: int, ahead: Ahead) -> Iterator[Bar]:
    """A bar while it is on the screen."""
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    progress = Progress(*columns, console=console, transient=True) if console.is_terminal else None
    with progress or nullcontext():
        yield Bar(console, ahead, total, progress)


def show(rows: Sequence[Row], console: Console) -> None:
    """The medians by team, number of targets and method, and what the first method gains over the others on the same seeds."""
    methods = methods_of(rows)
    table = Table(title="steady OSPA, m: median (least - greatest)", title_justify="left", box=None)
    for head in ("team", "targets", *methods, *(f"{methods[0]} against {other}" for other in methods[1:]), "in view at the end"):
        table.add_column(head)
    for group in groups_of(rows):
        found = [summarise(rows, group, method) for method in methods]
        cells = [f"{one.ospa:.2f} ({one.low:.2f} - {one.high:.2f})" if one else "-" for one in found]
        pairs = [compare(rows, group, methods[0], other) for other in methods[1:]]
        gains = [f"{100 * pair.gain:+.0f} %, {pair.wins}/{len(pair.differences)}, {_p(pair.wilcoxon)}" if pair else "-" for pair in pairs]
        in_view = " / ".join(f"{100.0 * one.in_view:.0f}" if one else "-" for one in found)
        table.add_row(group.team, str(group.targets), *cells, *gains, f"{in_view} %")
    console.print(table)
    console.print(
        "gain: mean difference on the same seeds, seeds won, p of Wilcoxon's signed-rank test; in view: share of targets over the last 5 s",
        soft_wrap=True,
    )


def _p(value: float | None) -> str:
    return "p -" if value is None else f"p {value:.3f}" if value >= 0.001 else "p < .001"


def summaries(rows: Sequence[Row]) -> list[dict[str, object]]:
    """The table as plain values."""
    found = [summarise(rows, group, method) for group in groups_of(rows) for method in methods_of(rows)]
    return [{**one._asdict(), **one.group._asdict(), "group": None} for one in found if one]
