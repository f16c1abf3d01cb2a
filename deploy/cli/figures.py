"""`figures`: draw a recorded run or a study."""

from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from deploy.cli.errors import writing
from deploy.cli.recordings import open_recording
from deploy.cli.simulate import ProgressLine
from protocol.settings import BadSetting


def draw(what: str, into: Path | None, animate: bool, explain: bool) -> int:
    """Draw what a name or path stands for: a study, or else a recorded run."""
    if not is_study(Path(what)):
        return draw_run(what, into, animate, explain)
    if animate or explain:
        raise BadSetting(f"{what}: is a study; --animate and --explain are for a recorded run")
    return draw_study(Path(what), into)


def is_study(path: Path) -> bool:
    """Whether a path is a study's: its folder, or one of its tables."""
    return path.suffix in (".parquet", ".csv") or any((path / name).exists() for name in ("trials.jsonl", "results.parquet", "results.csv"))


def draw_study(path: Path, into: Path | None) -> int:
    """Figures 4 or 5 and the paired differences of a study, as PDF and PNG, in its folder unless another is named."""
    from deploy.plots import study_figures  # loads matplotlib
    from deploy.studies.results import read_results

    for file in study_figures.draw(read_results(path), into or (path if path.is_dir() else path.parent)):
        print(file)
    return 0


def draw_run(name: str, out: Path | None, animate: bool, explain: bool) -> int:
    """Draw the figures of one run."""
    from deploy.plots import method_figures  # loads matplotlib
    from deploy.plots.run_figures import write_animation, write_figure  # loads matplotlib

    recording = open_recording(name)
    folder = out or recording.path.parent / "figures"
    with writing("--into", folder):
        for file in write_figure(recording, folder):
            print(file)
        for file in method_figures.write_figures(recording, folder) if explain else []:
            print(file)
        if animate:
            print(write_animation(recording, folder, _progress()))
    return 0


def _progress() -> Callable[[int, int], None]:
    """Say on standard error how far a film is, every second or, outside a terminal, every five."""
    console = Console(stderr=True, highlight=False)
    return ProgressLine(lambda text: console.print(f"film: {text}", soft_wrap=True), 1.0 if console.is_terminal else 5.0).tell
