"""The folder of a study: it keeps every finished trial, so that a study that was stopped goes on where it was.

    <folder>/trials.jsonl      one line for every finished trial, written at once
             results.csv       the rows of the study in the order of its plan, and
             results.parquet   the same; both rewritten when the study ends
             lock              held while the study runs

A row counts when its key is that of a planned trial: the key is a hash of every setting, of the program, and of the user's own classes
and the recorded data that the scenario names. So a second start goes on, more trials extend a study, and what was changed runs anew.
"""

import csv
import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from deploy.studies.trials import Row
from protocol.settings import BadOption, BadSetting
from protocol.whole_file import whole_file

ROBUSTNESS = "robustness.csv"  # in the folder of a study of robustness, which has no rows of methods
NUMBERS = ("seed", "start_targets", "agents", "steady_ospa", "steady_gospa", "end_in_view")  # columns that figures are drawn from


class StudyFolder:
    """Where a study keeps its rows."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.trials = path / "trials.jsonl"
        self.csv = path / "results.csv"
        self.parquet = path / "results.parquet"

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Hold the folder; raises BadOption when another study holds it or it cannot be written."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self.path / "lock", os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            raise BadOption("into", str(self.path), error.strerror or str(error)) from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            is_held = isinstance(error, BlockingIOError)
            why = "a study is running there; wait for it" if is_held else f"files cannot be locked: {error.strerror}"
            raise BadOption("into", str(self.path), f"{why}, or name another folder") from None
        try:
            self._mend()
            yield
        finally:
            os.close(descriptor)

    def _mend(self) -> None:
        """Remove the partial last line of a killed study."""
        if self.trials.exists():
            data = self.trials.read_bytes()
            whole = data.rfind(b"\n") + 1
            if whole < len(data):
                os.truncate(self.trials, whole)

    def finished(self) -> dict[str, Row]:
        """All rows by key; raises BadSetting naming a line that is no row."""
        if not self.trials.exists():
            return {}
        found: dict[str, Row] = {}
        for number, line in enumerate(self.trials.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
            try:
                row = json.loads(line)
                found[row["key"]] = row
            except (ValueError, KeyError, TypeError):
                raise BadSetting(
                    f"{self.trials}, line {number}: is no row of a study; without it the study plays that trial anew"
                ) from None
        return found

    def add(self, row: Row) -> None:
        """Keep a row; it is on the disk when this returns."""
        with self.trials.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def publish(self, rows: Sequence[Row]) -> None:
        """Write results.csv and results.parquet; wall times are left out, so that the same study gives the same table."""
        table = [{name: value for name, value in row.items() if name not in ("wall_s", "key")} for row in rows]
        with whole_file(self.csv) as new:
            _write_csv(new, table)
        with whole_file(self.parquet) as new:
            _write_parquet(new, table)


def _write_csv(path: Path, rows: Sequence[Row]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows(rows)


def _write_parquet(path: Path, rows: Sequence[Row]) -> None:
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(list(rows)), path)


def read_results(path: Path) -> list[Row]:
    """The rows of a study: its folder, its results.parquet or its results.csv. Raises BadSetting naming what is wrong."""
    if path.is_dir():
        folder = StudyFolder(path)
        path = folder.csv if folder.csv.exists() and not folder.parquet.exists() else folder.parquet
        if (folder.path / ROBUSTNESS).exists() and not path.exists():
            raise BadSetting(f"{folder.path}: a study of robustness has drawn its own figure, robustness.pdf; {ROBUSTNESS} is its table")
        if folder.trials.exists() and not path.exists():
            raise BadSetting(f"{folder.path}: the study has not finished; the command that began it goes on")
        if not path.exists():
            raise BadSetting(f"{folder.path}: no results of a study: holds neither results.parquet nor results.csv")
    if not path.exists():
        raise BadSetting(f"{path}: there is no such file or folder")
    try:
        rows = _read_parquet(path) if path.suffix == ".parquet" else _read_csv(path)
    except (OSError, ValueError, csv.Error) as error:
        raise BadSetting(f"{path}: no results of a study: {error}") from None
    if not rows:
        raise BadSetting(f"{path}: no results of a study: it holds no row")
    missing = [name for name in ("method", "scenario", "team", "seed", "start_targets", "steady_ospa") if name not in rows[0]]
    if missing:  # as in a study of bodies, which is a table alone
        raise BadSetting(f"{path}: no results of a study of the paper or of the ablation: the column {missing[0]} is missing")
    return rows


def _read_parquet(path: Path) -> list[Row]:
    import pyarrow.parquet

    rows: list[Row] = pyarrow.parquet.read_table(path).to_pylist()
    return rows


def _read_csv(path: Path) -> list[Row]:
    """Raises ValueError naming line and column."""
    rows: list[Row] = []
    with path.open(newline="", encoding="utf-8") as file:
        table = csv.reader(file)
        head = next(table, [])
        for cells in filter(None, table):
            if len(cells) != len(head):
                raise ValueError(f"line {table.line_num} has {len(cells)} cells; should have {len(head)}, as the first")
            rows.append({name: _plain(name, cell, table.line_num) for name, cell in zip(head, cells)})
    return rows


def _plain(name: str, value: str, line: int) -> Any:
    """A cell of a CSV file as what it was."""
    if name in ("team", "method", "scenario", "triple", "code", "own_code", "transcript", "version"):
        return value
    for kind in (int, float):
        try:
            return kind(value)
        except ValueError:
            continue
    if name in NUMBERS:
        raise ValueError(f"line {line}: {name} = {value!r}: should be a number")
    return {"True": True, "False": False}.get(value, value)
