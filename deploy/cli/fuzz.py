"""`fuzz`: play many seeds of the fuzzer and say which of them break something."""

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from deploy.simulation import compile_once
from deploy.verify.fuzz import MIXED, PROFILES, run
from protocol.settings import LARGEST_SEED, BadSetting


def fuzz(seeds: int, first: int, jobs: int | None, profile: str = MIXED) -> int:
    """Play `seeds` cases of a profile from `first` on; exit code 1 when one fails. Raises BadSetting."""
    if profile not in (MIXED, *PROFILES):
        raise BadSetting(f"--profile {profile}: should be one of {', '.join((MIXED, *PROFILES))}")
    if seeds < 1 or not 0 <= first <= LARGEST_SEED + 1 - seeds or (jobs is not None and jobs < 1):
        raise BadSetting(f"--seeds {seeds} --first {first}: should be at least one seed, of 0 to {LARGEST_SEED}, and at least one job")
    compile_once()
    started, console = time.perf_counter(), Console(stderr=True, highlight=False)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("seeds", total=seeds)

        def tell(done: int, failed: int) -> None:
            progress.update(task, completed=done, description=f"seeds, {failed} failed" if failed else "seeds")

        failures = run(range(first, first + seeds), jobs, tell, profile)
    for failure in failures:
        print(failure)
    wall = time.perf_counter() - started
    print(f"{seeds} seeds from {first} on: {len(failures)} failed, {wall:.0f} s")
    return 1 if failures else 0
