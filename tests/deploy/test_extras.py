"""What only studies need may be missing: everything else works, and what needs it says so in one line before it works for hours."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WITHOUT = "import sys; sys.modules.update(matplotlib=None, pyarrow=None); from deploy.__main__ import main; main()"


def run(folder: Path, *words: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    """The command where the packages are not installed."""
    settings = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT}/deploy/interface", "COVEY_LAUNCHER": "", **environment}
    return subprocess.run(
        [sys.executable, "-c", WITHOUT, *words], cwd=folder, env=settings, capture_output=True, text=True, timeout=100, check=False
    )


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("study", "convergence", "--quick"), "study"),
        pytest.param(("study", "robustness", "--quick"), "study", marks=pytest.mark.slow),
        pytest.param(("figures", "kept"), "figures", marks=pytest.mark.slow),
        pytest.param(("export", "kept"), "export", marks=pytest.mark.slow),
        (("simulate", "quick", "--trace", "x.parquet"), "--trace x.parquet"),
    ],
)
def test_what_needs_the_packages_says_so_at_once(tmp_path: Path, words: tuple[str, ...], what: str) -> None:
    done = run(tmp_path, *words)
    checkout = "in a checkout COVEY_EXTRAS=study ./covey version"
    elsewhere = "elsewhere python -m pip install matplotlib pyarrow, or the wheel file with its extra [study]"
    assert (done.returncode, done.stderr) == (2, f"covey: {what}: needs matplotlib and pyarrow: {checkout}; {elsewhere}\n")


def test_under_the_launcher_the_same_command_is_started_again_with_the_extra_and_only_once(tmp_path: Path) -> None:
    launcher = tmp_path / "launcher"
    launcher.write_text('#!/bin/sh\necho "$COVEY_EXTRAS: $@"\n')
    launcher.chmod(0o755)
    done = run(tmp_path, "figures", "a folder", "--animate", COVEY_LAUNCHER=str(launcher))
    assert (done.returncode, done.stdout) == (0, "study: figures a folder --animate\n")
    again = run(tmp_path, "figures", "kept", COVEY_LAUNCHER=str(launcher), COVEY_EXTRAS="study")
    assert again.returncode == 2 and "needs matplotlib" in again.stderr


@pytest.mark.slow
def test_everything_else_works_without_them(tmp_path: Path) -> None:
    done = run(tmp_path, "simulate", "quick", "--seconds", "2", "--record", "--trace", "x.csv", "--run", "kept", "--json")
    assert done.returncode == 0, done.stderr
    for words in (("score", "kept"), ("check", "quick"), ("version",), ("ps",)):
        assert "needs matplotlib" not in run(tmp_path, *words).stderr
    assert run(tmp_path, "score", "kept").returncode == 0
