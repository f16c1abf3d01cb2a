"""Engines: they run the trials of a study somewhere and hand the rows back as they come.

`on_this_machine` has one worker process per core, `on_a_cluster` the workers of a dask.distributed scheduler. Both yield
(number of the trial, its row) in the order in which trials finish, and end what they started when they are closed early. What a trial
is, and the function that plays one, is the study's (`Job`, `Play`).
"""

import multiprocessing
import signal
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from deploy.installation import how_to_install
from deploy.scenario import Scenario
from deploy.studies.trials import Row, run_trial
from protocol.process import die_with_parent
from protocol.settings import BadSetting

TICK = 0.25  # s between two looks at what is running
FinishedTrials = Generator[list[tuple[int, Row]], None, None]
Play = Callable[..., Row]  # of a trial and a function that takes the share of finished ticks


class Job(Protocol):
    """A trial as the machinery of studies knows it."""

    def key(self) -> str:
        """What tells it from all others, the program included; its row has the same."""

    def file(self) -> Path:
        """The file of its scenario."""

    def command(self) -> str:
        """What repeats it, or what it is."""

    def resolve(self) -> Scenario:
        """What is run."""


Numbered = tuple[int, Job]


class SharedProgress(Protocol):
    """The progress of each trial, 0 to 1, shared by all processes."""

    def __getitem__(self, number: int, /) -> float:
        """Of one trial."""

    def __setitem__(self, number: int, share: float, /) -> None:
        """A trial is so far."""


_shares: Any = None  # in a worker: how far each trial is, shared with the study

WORKER_ENDED = (
    "a worker process ended: a machine that lacks memory kills one, and fewer --workers need less; "
    'or a script calls covey.study outside of `if __name__ == "__main__":`, and each worker begins it anew'
)


class TrialFailed(Exception):
    """A trial ended with an error; the text says which and how."""


def _start_worker(shares: SharedProgress) -> None:
    global _shares
    _shares = shares
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the study, which ends its workers
    die_with_parent()


def _work(play: Play, number: int, trial: Job) -> Row:
    def tell(share: float) -> None:
        _shares[number] = share

    return play(trial, tell)


def on_this_machine(trials: Sequence[Numbered], workers: int, shares: SharedProgress, play: Play = run_trial) -> FinishedTrials:
    """The rows that have finished since the last step, every `TICK` s; `shares` holds the progress of each running trial."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _start_worker, (shares,))
    try:
        futures = {pool.submit(_work, play, number, trial): (number, trial) for number, trial in trials}
        while futures:
            done, _ = wait(futures, TICK, FIRST_COMPLETED)
            yield from _harvest({future: futures.pop(future) for future in done})
    finally:
        started = list((pool._processes or {}).values())  # other children of this process are its caller's
        pool.shutdown(wait=False, cancel_futures=True)
        for process in started:
            process.terminate()


def _harvest(done: "Mapping[Future[Row], Numbered]") -> FinishedTrials:
    """The rows of the trials that are done, as one step; only then it raises TrialFailed, where one has failed."""
    rows: list[tuple[int, Row]] = []
    failed: list[tuple[Job, Exception]] = []
    for future, (number, trial) in done.items():
        try:
            rows.append((number, future.result()))
        except Exception as error:
            failed.append((trial, error))
    yield rows
    for trial, why in failed:
        if isinstance(why, BrokenProcessPool):  # of all trials that were open then
            raise TrialFailed(WORKER_ENDED) from why
        raise TrialFailed(f"{trial.command()}: {type(why).__name__}: {why}") from why


def shared_progress(count: int) -> SharedProgress:
    """Shared memory for the progress of all trials."""
    shares: SharedProgress = multiprocessing.get_context("spawn").Array("d", max(1, count))
    return shares


def on_a_cluster(trials: Sequence[Numbered], address: str, play: Play = run_trial) -> FinishedTrials:
    """The rows that have finished since the last step; the workers of the scheduler at `address` need Covey on their path."""
    try:
        from distributed import Client
    except ImportError:
        raise BadSetting(f"--scheduler {address}: needs distributed: {how_to_install(['distributed'], 'cluster')}") from None
    try:
        client = Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise BadSetting(f"--scheduler {address}: no scheduler answers there ({type(error).__name__})") from None
    try:
        yield from _from_cluster(client, trials, play)
    finally:
        with suppress(OSError, TimeoutError):
            client.close(timeout=2)


def _from_cluster(client: Any, trials: Sequence[Numbered], play: Play) -> FinishedTrials:
    futures = {client.submit(play, trial, key=f"covey-{trial.key()}"): (number, trial) for number, trial in trials}
    try:
        while futures:
            time.sleep(TICK)
            done = [future for future in futures if future.done()]
            yield from _harvest({future: futures.pop(future) for future in done})
    finally:
        client.cancel(list(futures))
