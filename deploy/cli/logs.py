"""`logs`: the log lines of the processes of a run, merged by time. The run may still run or have ended."""

import contextlib
import json
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from deploy.storage.run_directory import RunDirectory, running_runs, runs_folder
from protocol.keys import order
from protocol.settings import BadSetting

FOLLOW_PERIOD = 0.25  # s between two looks for new lines
KNOWN = ("time", "level", "run", "agent", "message", "exception")  # fields with a place of their own in a printed line


class LogEntry(NamedTuple):
    """One line of a log; `fields` is empty for a line that is no JSON, such as an error before logging starts."""

    time: float  # Unix time, s; a line without one has that of the line before
    name: str
    line: str
    fields: dict[str, Any]


def logs(names: tuple[str, ...], run: str | None, follow: bool, lines: int | None, raw: bool) -> int:
    """Print the logs of a run; with `follow` until it has ended."""
    if lines is not None and lines < 0:
        raise BadSetting(f"--lines {lines}: should be 0 or more")
    directory = run_to_read(run)
    unknown = [name for name in names if not directory.log(name).exists()]
    if unknown:
        known = sorted((file.stem for file in directory.logs.glob("*.jsonl")), key=order)
        raise BadSetting(f"{unknown[0]!r}: run {directory.name} has no such process; it has {', '.join(known)}")
    tails = LogTails(directory, names)
    found = tails.read()
    _show(found if lines is None else found[len(found) - min(lines, len(found)) :], raw)
    while follow and directory.is_running():
        time.sleep(FOLLOW_PERIOD)
        _show(tails.read(), raw)
    if follow:
        _show(tails.read(), raw)
    return 0


def run_to_read(name: str | None) -> RunDirectory:
    """The run of that name, or the newest that runs, or else the newest that has ended; raises BadSetting when there is none.

    It is one that has processes.
    """
    if name is not None:
        directory = RunDirectory(name)
        if not directory.logs.is_dir():
            known = ", ".join(run.name for run in filter(_has_processes, runs_with_logs()))
            raise BadSetting(f"--run {name}: there is no such run in {runs_folder()}{f'; there are {known}' if known else ''}")
        if not _has_processes(directory):
            kind = "simulation" if directory.is_simulated() else "recording that is said again"
            raise BadSetting(f"--run {name}: it is a {kind}, which has no processes and no logs")
        return directory
    found = list(filter(_has_processes, running_runs())) or list(filter(_has_processes, runs_with_logs()))
    if not found:
        raise BadSetting(f"there is no run in {runs_folder()} that has processes; start one with `covey up`")
    return found[-1]


def _has_processes(directory: RunDirectory) -> bool:
    return not (directory.is_simulated() or directory.is_replayed())


def runs_with_logs() -> list[RunDirectory]:
    """All runs of this folder that have logs, running or not, the newest last."""
    found = []
    for path in runs_folder().glob("*/logs"):
        with contextlib.suppress(FileNotFoundError):  # it is being removed
            found += [(path.stat().st_mtime, path.parent.name)] if path.is_dir() and not path.parent.is_symlink() else []
    return [RunDirectory(name) for _, name in sorted(found)]


class LogTails:
    """The logs of a run, read incrementally. An unfinished line is read once it is complete."""

    def __init__(self, directory: RunDirectory, names: tuple[str, ...] = ()) -> None:
        """`names`: only these processes; empty: all, including later ones."""
        self._directory, self._names = directory, names
        self._read: dict[Path, int] = {}  # bytes
        self._time: dict[Path, float] = {}

    def read(self) -> list[LogEntry]:
        """The lines since the last call, by time."""
        files = [self._directory.log(name) for name in self._names] or sorted(self._directory.logs.glob("*.jsonl"))
        return sorted((entry for file in files for entry in self._new(file)), key=lambda entry: entry.time)

    def _new(self, file: Path) -> Iterator[LogEntry]:
        try:
            with file.open("rb") as log:
                log.seek(self._read.get(file, 0))
                text = log.read()
        except FileNotFoundError:
            return
        whole = text[: text.rfind(b"\n") + 1]
        self._read[file] = self._read.get(file, 0) + len(whole)
        for line in whole.decode(errors="replace").splitlines():
            entry = entry_of(line, file.stem, self._time.get(file, 0.0))
            self._time[file] = entry.time
            yield entry


def entry_of(line: str, name: str, before: float) -> LogEntry:
    """A line of the log of `name`; `before` is the time of the line before."""
    try:
        fields = json.loads(line)
        return LogEntry(float(fields["time"]), name, line, fields)
    except (ValueError, TypeError, KeyError):
        return LogEntry(before, name, line, {})


def _show(entries: Iterable[LogEntry], raw: bool) -> None:
    for entry in entries:
        print(entry.line if raw else plain(entry))
    sys.stdout.flush()


def plain(entry: LogEntry) -> str:
    """An entry for people: time, process, message and further fields; an exception in lines of its own."""
    clock = time.strftime("%H:%M:%S", time.localtime(entry.time)) + f".{int(1000 * (entry.time % 1)):03d}" if entry.time else " " * 12
    head = f"{clock}  {entry.name:10}  "
    if not entry.fields:
        return head + entry.line
    level = entry.fields.get("level", "info")
    more = ", ".join(f"{name} {_value(value)}" for name, value in entry.fields.items() if name not in KNOWN and value is not None)
    text = head + f"{level}: " * (level != "info") + str(entry.fields.get("message", "")) + f"  ({more})" * bool(more)
    return "\n    ".join([text, *str(entry.fields.get("exception", "")).splitlines()])


def _value(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
