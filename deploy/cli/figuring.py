"""`figures`: draw what a study came to."""

from pathlib import Path

from deploy.plots.study_figures import draw
from deploy.studies.study import read_results
from protocol.settings import BadSetting


def is_study(path: Path) -> bool:
    """Whether a path is a study's: its folder, or one of its tables."""
    return path.suffix in (".parquet", ".csv") or any((path / name).exists() for name in ("trials.jsonl", "results.parquet", "results.csv"))


def figures_of_study(path: Path, into: Path | None) -> int:
    """Figures 4 or 5 and the paired differences of a study, as PDF and PNG, in its folder unless another is named."""
    for file in draw(read_results(path), into or (path if path.is_dir() else path.parent)):
        print(file)
    return 0


def figures(path: Path, into: Path | None) -> int:
    """Draw a study; raises BadSetting for a path that is none."""
    if not path.exists():
        raise BadSetting(f"{path}: there is no such file or folder")
    if not is_study(path):
        raise BadSetting(f"{path}: not a study: should be its folder, or its results.parquet or results.csv")
    return figures_of_study(path, into)
