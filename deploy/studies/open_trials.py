"""Runs the trials that the folder of a study lacks, and shows how far the study is."""

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from deploy.simulation import compile_once
from deploy.studies.engines import (
    FinishedTrials,
    Job,
    Numbered,
    Play,
    SharedProgress,
    TrialFailed,
    on_a_cluster,
    on_this_machine,
    shared_progress,
)
from deploy.studies.results import StudyFolder
from deploy.studies.trials import Row, cost, newest_source
from protocol.settings import BadSetting

PLAIN_PERIOD = 20.0  # s between two lines where there is no terminal


def run_open_trials(
    name: str, folder: StudyFolder, trials: Sequence[Job], workers: int | None, scheduler: str | None, console: Console, play: Play
) -> list[Row]:
    """The rows of all trials in their order. Trials that the folder lacks are run first."""
    done, keys = folder.finished(), [trial.key() for trial in trials]
    open_trials = [(number, trial) for number, trial in enumerate(trials) if keys[number] not in done]
    count = len(trials) - len(open_trials)
    console.print(f"{name}: {len(trials)} trials" + (f", {count} of them done already" if count else "") + f"; {folder.path}")
    if open_trials:
        _run(folder, trials, keys, open_trials, workers or os.cpu_count() or 1, scheduler, console, play)
    finished = folder.finished()
    return [finished[key] for key in keys]


def _run(
    folder: StudyFolder,
    trials: Sequence[Job],
    keys: Sequence[str],
    todo: Sequence[Numbered],
    workers: int,
    scheduler: str | None,
    console: Console,
    play: Play,
) -> None:
    """Run the open trials; every row goes into the folder when it is finished."""
    if not scheduler:
        compile_once()
    shares = shared_progress(len(trials))
    engine = on_a_cluster(todo, scheduler, play) if scheduler else on_this_machine(todo, min(workers, len(todo)), shares, play)
    work = RemainingWork(trials, todo, shares)
    try:
        with _exits_on_sigterm(), closing(engine), _bar(console, len(trials), work) as bar:
            _follow(engine, folder, trials, keys, work, bar)
    except TrialFailed as error:
        raise BadSetting(f"a trial failed, those that are done are kept: {error}") from error
    except KeyboardInterrupt:
        console.print(f"stopped; {work.finished} of {len(trials)} trials are kept in {folder.path}, the same command goes on")
        raise


@contextmanager
def _exits_on_sigterm() -> Iterator[None]:
    """Meanwhile SIGTERM raises SystemExit, so that workers are ended on the way out. Outside of the main thread nothing changes."""
    if threading.current_thread() is not threading.main_thread():  # Python lets no other thread set a handler
        yield
        return
    previous = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


def _follow(
    engine: FinishedTrials, folder: StudyFolder, trials: Sequence[Job], keys: Sequence[str], work: "RemainingWork", bar: "ProgressBar"
) -> None:
    """Keep the rows that come; `keys` are those of the trials when the study began. Raises BadSetting for a row of another key."""
    for rows in engine:
        for number, row in rows:
            if row["key"] != keys[number]:
                changed = _what_changed(trials[number], keys[number], row["code"])
                raise BadSetting(f"{changed}; {work.finished} of {len(trials)} trials are kept")
            folder.add(row)
            work.finish(number)
        bar.show()


def _what_changed(trial: Job, key: str, code: str) -> str:
    """What has changed since the study began, and the remedy, when a worker of program `code` gives a row of another key for a trial."""
    if trial.key() != key:
        changed = f"{trial.file()}: it, or a file that it names, was changed while the study ran"
        return f"{changed}; undo that and start the study again, or all trials are played anew"
    return (
        f"a worker runs another program ({code}) than this one: it has another version, or a source was changed while the study ran"
        f" ({newest_source()} was the last); start the study again"
    )


class RemainingWork:
    """The remaining work of a study: costs of the open trials, and the speed since this start."""

    def __init__(self, trials: Sequence[Job], todo: Sequence[Numbered], shares: SharedProgress) -> None:
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

    def seconds_left(self) -> float | None:
        """Estimated s that are left; None before there are enough data."""
        share = self.share()
        return None if share < 0.01 or self.elapsed() < 2.0 else remaining(share, self.elapsed())

    def running(self) -> int:
        """Trials under way."""
        return sum(self._shares[number] > 0.0 for number in self._open)


def remaining(share: float, elapsed: float) -> float:
    """s that are left when `share` of the work took `elapsed` s."""
    return elapsed * (1.0 - share) / share


def duration_text(seconds: float) -> str:
    """A duration as people say it, rounded up: 45 s, 12 min, 3 h 20 min."""
    if seconds < 90.0:
        return f"{max(1, math.ceil(seconds))} s"
    minutes = math.ceil(seconds / 60.0)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


class ProgressBar:
    """Shows the progress of a study: a bar in a terminal, a line from time to time elsewhere."""

    def __init__(self, console: Console, work: RemainingWork, total: int, progress: Progress | None) -> None:
        self._console, self._work, self._total, self._progress = console, work, total, progress
        self._task: TaskID | None = progress.add_task("", total=total, completed=work.finished) if progress else None
        self._said_at = -PLAIN_PERIOD

    def show(self) -> None:
        """Show how far it is now."""
        left = self._work.seconds_left()
        text = f"about {duration_text(left)} left" if left is not None else "estimating"
        if self._progress and self._task is not None:
            self._progress.update(self._task, completed=self._work.finished, description=text)
        elif time.monotonic() - self._said_at >= PLAIN_PERIOD:
            self._said_at = time.monotonic()
            done = f"{self._work.finished} of {self._total} trials, {self._work.running()} running"
            self._console.print(f"{done}, {self._work.elapsed():.0f} s so far, {text}", soft_wrap=True)


@contextmanager
def _bar(console: Console, total: int, work: RemainingWork) -> Iterator[ProgressBar]:
    """A bar while it is on the screen."""
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    progress = Progress(*columns, console=console, transient=True) if console.is_terminal else None
    with progress or nullcontext():
        yield ProgressBar(console, work, total, progress)
