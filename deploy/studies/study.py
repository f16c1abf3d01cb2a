"""Studies: many trials with paired seeds, kept in a folder so that a study that was stopped goes on where it was.

    <folder>/trials.jsonl      one line for every finished trial, written at once
             results.csv       the rows of the study in the order of its plan, and
             results.parquet   the same; both rewritten when the study ends
             lock              held while the study runs

A row counts when its key is that of a planned trial: the key is a hash of every setting and of the program. So a second start goes
on, more trials extend a study, and a changed program runs everything anew.
"""

import csv
import fcntl
import itertools
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from deploy.scenario import TeamSettings, team_counts
from deploy.studies.trials import METHODS, Row, Trial, check_method
from protocol.settings import BadSetting


class Design(msgspec.Struct, frozen=True, kw_only=True):
    """What a study compares: all combinations of teams, numbers of targets and methods, each with the same seeds."""

    scenario: str
    teams: tuple[str, ...]
    targets: tuple[int, ...]
    methods: tuple[str, ...]
    trials: int = 10
    first_seed: int = 100  # of the seeds 100, 101, ...; the defaults of the scenarios were found with smaller ones
    options: dict[str, Any] = {}  # dotted settings of all trials


STUDIES: dict[str, Design] = {
    "convergence": Design(scenario="convergence", teams=("1",), targets=(8,), methods=("power", "voronoi-cod", "voronoi", "static")),
    "efficacy": Design(scenario="efficacy", teams=("2", "3", "4", "5"), targets=(30, 40, 50), methods=("power", "voronoi", "voronoi-cod")),
    "heterogeneity": Design(
        scenario="heterogeneity", teams=("20E+20F", "20E+10G", "20E+4H"), targets=(30,), methods=("power", "voronoi", "voronoi-cod")
    ),
}
QUICK: dict[str, dict[str, Any]] = {  # what --quick lays over a study: under 3 minutes on 2 cores
    "convergence": {"trials": 4, "options": {"run.dt": 0.5}},
    "efficacy": {"trials": 3, "options": {"run.dt": 0.5, "run.seconds": 40.0}},
    "heterogeneity": {"trials": 4, "options": {"run.dt": 0.5, "run.seconds": 80.0}},
}


def design(name: str, quick: bool = False) -> Design:
    """The study of that name; raises BadSetting listing what there is."""
    if name not in STUDIES:
        raise BadSetting(f"study {name!r} does not exist; known are {', '.join(STUDIES)}, robustness")
    return msgspec.structs.replace(STUDIES[name], **QUICK[name]) if quick else STUDIES[name]


def plan(found: Design) -> list[Trial]:
    """All trials, seed by seed, so that a study that is cut short has compared everything equally often; checked by resolving them."""
    for name in found.methods:
        check_method(name)
    for team in found.teams:
        team_counts(TeamSettings(composition=team, triple=found.options.get("team.triple", "ACD")))
    seeds = range(found.first_seed, found.first_seed + found.trials)
    trials = [
        Trial(scenario=found.scenario, seed=seed, team=team, targets=targets, method=method, options=found.options)
        for seed, targets, team, method in itertools.product(seeds, found.targets, found.teams, found.methods)
    ]
    for trial in trials[: len(found.targets) * len(found.teams) * len(found.methods)]:
        trial.resolve()
    return trials


class Folder:
    """Where a study keeps its rows."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.trials = path / "trials.jsonl"
        self.csv = path / "results.csv"
        self.parquet = path / "results.parquet"

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Hold the folder; raises BadSetting when another study holds it or it cannot be written."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self.path / "lock", os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            raise BadSetting(f"--into {self.path}: {error.strerror}") from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
            raise BadSetting(f"--into {self.path}: a study is running there; wait for it or name another folder") from None
        try:
            self._mend()
            yield
        finally:
            os.close(descriptor)

    def _mend(self) -> None:
        """Cut off what a killed study left of a line."""
        if self.trials.exists():
            data = self.trials.read_bytes()
            whole = data.rfind(b"\n") + 1
            if whole < len(data):
                os.truncate(self.trials, whole)

    def finished(self) -> dict[str, Row]:
        """All rows by key."""
        if not self.trials.exists():
            return {}
        rows = [json.loads(line) for line in self.trials.read_text(encoding="utf-8").splitlines() if line.endswith("}")]
        return {row["key"]: row for row in rows}

    def add(self, row: Row) -> None:
        """Keep a row; it is on the disk when this returns."""
        with self.trials.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def publish(self, rows: Sequence[Row]) -> None:
        """Write results.csv and results.parquet whole; how long a trial took is left out, so that the same study gives the same table."""
        table = [{name: value for name, value in row.items() if name not in ("wall_s", "key")} for row in rows]
        _replace(self.csv, lambda path: _write_csv(path, table))
        _replace(self.parquet, lambda path: _write_parquet(path, table))


def _replace(path: Path, write: Any) -> None:
    """Write a file beside and move it into place."""
    beside = path.with_name(path.name + ".new")
    write(beside)
    beside.replace(path)


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
        path = next((file for file in (path / "results.parquet", path / "results.csv") if file.exists()), path / "results.parquet")
    try:
        rows = _read_parquet(path) if path.suffix == ".parquet" else _read_csv(path)
    except (OSError, ValueError) as error:
        raise BadSetting(f"{path}: no results of a study: {error}") from None
    missing = [name for name in ("method", "team", "seed", "start_targets", "steady_ospa") if not rows or name not in rows[0]]
    if missing:
        raise BadSetting(f"{path}: no results of a study: the column {missing[0]} is missing")
    return rows


def _read_parquet(path: Path) -> list[Row]:
    import pyarrow.parquet

    rows: list[Row] = pyarrow.parquet.read_table(path).to_pylist()
    return rows


def _read_csv(path: Path) -> list[Row]:
    with path.open(newline="", encoding="utf-8") as file:
        return [{name: _plain(name, value) for name, value in row.items()} for row in csv.DictReader(file)]


def _plain(name: str, value: str) -> Any:
    """A cell of a CSV file as what it was."""
    if name in ("team", "method", "scenario", "triple", "code", "transcript", "version"):
        return value
    for kind in (int, float):
        try:
            return kind(value)
        except ValueError:
            continue
    return {"True": True, "False": False}.get(value, value)


def methods_of(rows: Sequence[Row]) -> list[str]:
    """The methods that occur, in the order of METHODS."""
    return [name for name in METHODS if any(row["method"] == name for row in rows)]
