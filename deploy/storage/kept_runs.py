"""The kept runs under `runs`: their names, the latest one, their results, and their removal.

The default name is <date>-<scenario>-<n>. A name that an ended run has gets the next number, such as hunt-2: no run writes into the
directory of another. `latest` is a link to the run that began last.
"""

import contextlib
import itertools
import json
import os
import re
import shutil
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from deploy.storage.run_directory import LATEST_LINK, RunDirectory, is_running_already, run_directories, runs_folder
from protocol.settings import BadSetting

LONGEST = 64  # characters of a name, which is a part of every key
NAME = re.compile(r"^(?!\.+\Z)[A-Za-z0-9_.-]{1,64}\Z")
INTERRUPTED = (129, 130, 143)  # exit codes of a run that a signal has stopped
DRAWING = ".foxglove.mcap"  # how the files of `covey export --to foxglove` end
UNITS = {"m": 60.0, "h": 3600.0, "d": 86400.0, "w": 604800.0}  # s


class KeptRun(NamedTuple):
    """One run as `covey runs` lists it."""

    name: str
    scenario: str
    seed: int | None
    began: float  # Unix time, s
    state: str  # running, ended, failed, interrupted
    ospa: float | None  # steady, m; None: there is no result, none of any tick, or no true target
    recording_bytes: int
    simulated: bool


def new_run_directory(requested_name: str | None, scenario: str) -> tuple[RunDirectory, int]:
    """A directory that no run has used, and the descriptor that holds it; raises BadSetting.

    `requested_name`: the name that the user gives; None: one of the date and the scenario.
    """
    if requested_name is not None:
        check_name(requested_name)
    for name in _dated(scenario) if requested_name is None else _successors(requested_name):
        directory = RunDirectory(name)
        if name == requested_name and directory.is_running():
            raise is_running_already(name)
        lock = directory.hold() if directory.is_free() else None
        if lock is not None and directory.is_free():
            directory.clear()
            return directory, lock
        if lock is not None:
            os.close(lock)
    raise AssertionError("names do not end")


def _successors(name: str) -> Iterator[str]:
    """hunt, hunt-2, hunt-3, ..."""
    yield name
    for number in itertools.count(2):
        yield f"{name[: LONGEST - len(str(number)) - 1]}-{number}"


def _dated(scenario: str) -> Iterator[str]:
    """The names of today for a scenario, from one above the highest number in use."""
    stem = re.sub(r"[^A-Za-z0-9_.-]+", "-", Path(scenario).name.removesuffix(".toml")) or "run"
    head = f"{time.strftime('%Y-%m-%d')}-{stem}"[: LONGEST - 8]
    used = [one.name.removeprefix(f"{head}-") for one in run_directories() if one.name.startswith(f"{head}-")]
    highest = max((int(number) for number in used if number.isdecimal() and len(number) < 7), default=0)
    return (f"{head}-{number}" for number in itertools.count(highest + 1))


def check_name(name: str) -> None:
    """Raise BadSetting for a name that cannot be a directory and a part of a key."""
    if name == LATEST_LINK:
        raise BadSetting(f"--run {name}: this name is the link to the newest run; take another")
    if not NAME.match(name):
        raise BadSetting(f"--run {name}: should be 1 to {LONGEST} letters, digits, or any of _ . - (and not only dots)")


def link_latest(directory: RunDirectory) -> None:
    """Let `latest` point to a run; where links cannot be made there is none."""
    fresh = runs_folder() / f".latest-{os.getpid()}"
    with contextlib.suppress(OSError):
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(directory.name)
        fresh.replace(runs_folder() / LATEST_LINK)


def find_run(name: str) -> RunDirectory | None:
    """The kept run of that name, which `latest` may stand for; None: there is none."""
    if name == LATEST_LINK:
        with contextlib.suppress(OSError):
            name = os.readlink(runs_folder() / LATEST_LINK)
    if not NAME.match(name):
        return None
    directory = RunDirectory(name)
    return directory if directory.path.is_dir() else None


def kept_runs() -> list[KeptRun]:
    """All runs, the newest first."""
    found = []
    for directory in run_directories():
        with contextlib.suppress(FileNotFoundError):  # it has not begun, or is being removed
            found.append(_look(directory))
    return sorted(found, key=lambda kept: kept.began, reverse=True)


def _look(directory: RunDirectory) -> KeptRun:
    """What there is to say of a run; raises FileNotFoundError where something that was there has gone."""
    scenario = _run_section(directory)
    result = _result(directory)
    ospa = result.get("steady_ospa") if result.get("ticks") != 0 and result.get("has_targets", True) else None
    code = result.get("exit_code", 0) if result else INTERRUPTED[0]
    state = "running" if directory.is_running() else "interrupted" if code in INTERRUPTED else "failed" if code else "ended"
    return KeptRun(
        name=directory.name,
        scenario=str(scenario.get("scenario", "")),
        seed=scenario.get("seed"),
        began=directory.config.stat().st_mtime,
        state=state,
        ospa=ospa if isinstance(ospa, int | float) else None,
        recording_bytes=sum(file.stat().st_size for file in recordings_in(directory.path)),
        simulated=directory.is_simulated(),
    )


def recordings_in(folder: Path) -> list[Path]:
    """The recordings in a folder, the newest last; a file that `covey export` has drawn is none."""
    found = (file for file in folder.glob("*.mcap") if not file.name.endswith(DRAWING))
    return sorted(found, key=lambda file: file.stat().st_mtime)


def _run_section(directory: RunDirectory) -> dict[str, Any]:
    try:
        section = tomllib.loads(directory.config.read_text(encoding="utf-8")).get("run", {})
    except (OSError, ValueError):
        return {}
    return section if isinstance(section, dict) else {}


def _result(directory: RunDirectory) -> dict[str, Any]:
    """The run's own result; empty when there is none."""
    try:
        result = json.loads(directory.result.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return result if isinstance(result, dict) else {}


def removable(name: str) -> RunDirectory:
    """The ended run of that name; raises BadSetting when there is none or it is running."""
    directory = find_run(name)
    if directory is None or not (directory.config.exists() or directory.is_free()):
        raise BadSetting(f"{name}: there is no run of this name in {runs_folder()}; `covey runs` lists them")
    if directory.is_running():
        raise BadSetting(f"{directory.name}: the run is running; {directory.how_to_end()}")
    return directory


def remove(directory: RunDirectory) -> None:
    """Remove a run with all that is in its directory, and let `latest` point to the newest that is left; raises BadSetting."""
    try:
        shutil.rmtree(directory.path)
    except OSError as error:
        raise BadSetting(f"{directory.path}: {error.strerror}; the run is not removed") from None
    link = runs_folder() / LATEST_LINK
    if link.is_symlink() and not link.exists():
        link.unlink()
        for kept in kept_runs()[:1]:
            link_latest(RunDirectory(kept.name))


def age_of(text: str) -> float:
    """`7d`, `12h` or `30m` in s; raises BadSetting."""
    found = re.fullmatch(r"(\d{1,6}(?:\.\d{1,6})?)([mhdw])", text.strip())
    if found is None:
        raise BadSetting(f"--older-than {text}: should be a number and a unit: 30m, 12h, 7d or 2w")
    return float(found[1]) * UNITS[found[2]]
