"""Studies: many trials with paired seeds, kept in a folder so that one that was stopped goes on where it was."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from covey.arguments import checked
from covey.columns import Columns, columns_of, to_arrow, to_pandas
from deploy.studies.paired import Comparison, Summary, compare, groups_of, summarise
from deploy.studies.results import StudyFolder, read_results
from deploy.studies.trials import methods_of
from protocol.settings import BadSetting

if TYPE_CHECKING:
    import pandas
    import pyarrow


@dataclass(frozen=True, repr=False)
class Study:
    """The rows of a study, one for each trial."""

    folder: Path
    rows: tuple[Mapping[str, Any], ...] = field(repr=False)

    def columns(self) -> Columns:
        """All fields of the rows by name: what was run, what came out, the command that repeats it, every setting."""
        return columns_of(self.rows)

    def summary(self) -> list[Summary]:
        """Median, least and greatest steady OSPA, m, of each method for each team and number of targets."""
        rows = [dict(row) for row in self.rows]
        found = [summarise(rows, group, method) for group in groups_of(rows) for method in methods_of(rows)]
        return [one for one in found if one is not None]

    def paired(self, method: str | type, other: str | type) -> list[Comparison]:
        """What a method gains over another one on the same seeds, for each team and number of targets; steady OSPA, m.

        Each has `group`, `seeds`, `differences` (other - method, m, one for each seed), `gain` (share of the other's mean) with the ends
        `low` and `high` of its interval of 95 % (bootstrap over seeds), `wins` (seeds with the smaller error), and the two-sided p of
        Wilcoxon's signed-rank test (`wilcoxon`) and of the sign test (`sign`). Raises BadSetting for a method that the study has not.
        """
        rows = [dict(row) for row in self.rows]
        names = {argument: _joined(value) for argument, value in (("method", method), ("other", other))}
        for argument, name in names.items():
            if name not in (known := methods_of(rows)):
                raise BadSetting(f"{argument} = {name!r}: should be one of {', '.join(known)}")
        found = [compare(rows, group, *names.values()) for group in groups_of(rows)]
        return [pair for pair in found if pair is not None]

    def to_pandas(self) -> "pandas.DataFrame":
        """The columns as a pandas.DataFrame; raises ImportError where pandas is not installed."""
        return to_pandas(self.columns())

    def to_arrow(self) -> "pyarrow.Table":
        """The columns as a pyarrow.Table; raises ImportError where pyarrow is not installed."""
        return to_arrow(self.columns())

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        methods = ", ".join(methods_of([dict(row) for row in self.rows]))
        return f"<Study in {self.folder}: {len(self.rows)} trials of {methods}>"


@checked
def study(
    name: Literal["convergence", "efficacy", "heterogeneity", "ablation"],
    *,
    quick: bool = False,
    trials: int | None = None,
    seed: int | None = None,
    teams: str | Sequence[str] | None = None,
    targets: int | Sequence[int] | None = None,
    methods: str | type | Sequence[str | type] | None = None,
    triple: str | None = None,
    capacity: str | None = None,
    dt: float | None = None,
    seconds: float | None = None,
    settings: Mapping[str, Any] | None = None,
    into: str | Path | None = None,
    workers: int | None = None,
) -> Study:
    """Run a study of the paper on the cores of this machine; trials that its folder holds already are not run again.

    In a script the call belongs below `if __name__ == "__main__":`, because the trials run in processes of their own.

    Parameters
    ----------
    name
        convergence (section IV-A), efficacy (IV-B, figure 4), heterogeneity (IV-C, figure 5), or ablation (search-and-track without
        each of its ingredients). Studies of robustness and of bodies are commands alone: `covey study robustness`.
    quick
        Few short trials.
    trials, seed
        Seeds for each combination of team, number of targets and method, and the first of them.
    teams, targets
        One or several: compositions such as "20E+4H", and numbers of targets.
    methods
        What is compared, one or several: power, voronoi, voronoi-cod and others, and control laws of your own, each a class in a module
        that other processes can import, or "module:Class".
    triple, capacity, dt, seconds, settings
        Of all trials, as in `scenario`.
    into
        The folder of the study; default: runs/study-NAME.
    workers
        Processes; default: one for each core.
    """
    from deploy.cli.study import checked_plan, console_of, default_folder
    from deploy.installation import need_study_packages
    from deploy.studies.design import check_workers, design_fields, design_with, dotted_options
    from deploy.studies.open_trials import run_open_trials
    from deploy.studies.trials import run_trial

    need_study_packages("covey.study")
    check_workers(workers)
    joined = [None if values is None else _joined(values) for values in (teams, targets, methods)]
    given = design_fields(trials, seed, *joined)
    options = {**dotted_options(triple, capacity, dt, seconds), **(settings or {})}
    found = design_with(name, quick, given, options)
    planned, folder = checked_plan(found), StudyFolder(Path(into) if into is not None else default_folder(name, quick))
    with folder.claimed():
        console = console_of(as_json=True)
        rows = run_open_trials(found.scenario, folder, planned, workers, None, console, run_trial)
        folder.publish(rows)
    return Study(folder.path, tuple(rows))


def _joined(values: str | int | type | Sequence[str | int | type]) -> str:
    """One value, or several with commas, as the command takes them; classes by name."""
    several = [values] if isinstance(values, str | int | type) else values
    return ",".join(f"{value.__module__}:{value.__qualname__}" if isinstance(value, type) else str(value) for value in several)


@checked
def load_study(folder: str | Path) -> Study:
    """A study that has been run: its folder, its results.parquet or its results.csv."""
    path = Path(folder)
    return Study(path, tuple(read_results(path)))
