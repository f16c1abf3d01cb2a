"""Completion of words with TAB. This file imports nothing slow, because the user waits for the answer."""

import os
import tomllib
from pathlib import Path

from cyclopts.completion import CompletionContext

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def scenarios(context: CompletionContext) -> list[str]:
    """The shipped scenarios, and the TOML files whose names begin with the typed text."""
    return sorted(file.stem for file in SCENARIOS.glob("*.toml")) + _files(context.incomplete, ".toml")


def studies(context: CompletionContext) -> list[str]:
    """The names of the studies."""
    from deploy.studies.design import STUDIES

    return [*STUDIES, "robustness", "bodies"]


def benches(context: CompletionContext) -> list[str]:
    """What can be measured, as the help of `covey bench` says; nothing but the benchmarks imports them."""
    return [
        *("round", "simulate", "live", "realtime", "tls", "scale", "start", "codec", "memory", "peers", "page", "replay", "overload"),
        "bodies",
        "all",
    ]


def runs(context: CompletionContext) -> list[str]:
    """The names of the runs that are kept here."""
    folder = _runs_folder()
    return sorted(path.parent.name for path in folder.glob("*/run.toml")) if folder.is_dir() else []


def recordings(context: CompletionContext) -> list[str]:
    """The runs that have a recording, and the MCAP files whose names begin with the typed text."""
    return sorted(path.parent.name for path in _runs_folder().glob("*/recording.mcap")) + _files(context.incomplete, ".mcap")


def agents(context: CompletionContext) -> list[str]:
    """The agents of the newest run."""
    newest = max(_runs_folder().glob("*/run.toml"), key=lambda path: path.stat().st_mtime, default=None)
    return [] if newest is None else list(tomllib.loads(newest.read_text(encoding="utf-8")).get("members", {}))


def processes(context: CompletionContext) -> list[str]:
    """The processes of the newest run that have a log."""
    newest = max(_runs_folder().glob("*/logs"), key=lambda path: path.stat().st_mtime, default=None)
    return [] if newest is None else sorted(file.stem for file in newest.glob("*.jsonl"))


def settings(context: CompletionContext) -> list[str]:
    """All settings of a scenario, as `section.key=`."""
    from deploy.cli.template import dotted_names

    return [f"{name}=" for name in dotted_names()]


def _runs_folder() -> Path:
    return Path(os.environ.get("COVEY_RUNS") or "runs")


def _files(begin: str, suffix: str) -> list[str]:
    """Folders and files of this suffix whose names begin with the typed text."""
    folder = Path(os.path.dirname(begin) or ".")
    names = sorted(folder.iterdir()) if folder.is_dir() else []
    lead = os.path.dirname(begin) + "/" * bool(os.path.dirname(begin).strip("/"))
    return [f"{lead}{path.name}{'/' if path.is_dir() else ''}" for path in names if path.suffix == suffix or (lead and path.is_dir())]
