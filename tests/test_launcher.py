"""The launcher says in one line what is missing, and starts fast once all is there."""

import ast
import hashlib
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def launch(folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The launcher of a copy of this checkout's first files, with nothing on the path."""
    for name in ("covey", "pyproject.toml"):
        (folder / name).write_bytes((ROOT / name).read_bytes())
    command = [sys.executable, str(folder / "covey"), *words]
    return subprocess.run(command, env={"PATH": "", **environment}, capture_output=True, text=True, timeout=60, check=False)


def test_a_python_without_venv_is_told_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "ensurepip.py").write_text("raise ImportError\n")
    done = launch(tmp_path, "demo", PYTHONPATH=str(tmp_path / "modules"))
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "covey: this Python has no venv module: apt install python3-venv, or install uv"
    assert not (tmp_path / ".venv").exists()


def test_an_old_python_is_told_what_to_install(tmp_path: Path) -> None:
    source = (ROOT / "covey").read_text()
    assert "NEEDED = (3, 11)" in source
    (tmp_path / "pyproject.toml").write_bytes((ROOT / "pyproject.toml").read_bytes())
    (tmp_path / "covey").write_text(source.replace("NEEDED = (3, 11)", "NEEDED = (3, 99)"))
    done = subprocess.run(
        [sys.executable, str(tmp_path / "covey")], env={"PATH": ""}, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2
    have = f"{sys.version_info[0]}.{sys.version_info[1]}"
    assert (
        done.stderr == f"covey: this is Python {have}, Covey needs 3.99 or newer: apt install python3.99 python3.99-venv, or install uv\n"
    )


def test_the_launcher_is_written_in_words_that_python_3_6_reads() -> None:
    ast.parse((ROOT / "covey").read_text(), feature_version=(3, 6))


def test_an_environment_that_is_up_to_date_is_used_as_it_is(tmp_path: Path) -> None:
    stamp = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    python = tmp_path / ".venv" / "bin" / "python"
    python.write_text('#!/bin/sh\necho "$@ in $PYTHONPATH"\n')
    python.chmod(0o755)
    (tmp_path / ".venv" / "covey-installed").write_text(stamp + "\n")
    done = launch(tmp_path, "up", "quick")
    assert (done.returncode, done.stdout) == (0, f"-P -m deploy up quick in {tmp_path}\n")


def test_a_changed_list_of_packages_is_installed_anew(tmp_path: Path) -> None:
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    python = tmp_path / ".venv" / "bin" / "python"
    python.write_text(f'#!/bin/sh\n[ "$1" = -c ] && exec {sys.executable} "$@"\necho "$@" >> {tmp_path}/calls\n')
    python.chmod(0o755)
    (tmp_path / ".venv" / "covey-installed").write_text("old\n")
    for _ in range(2):
        assert launch(tmp_path, "ps").returncode == 0
    calls = (tmp_path / "calls").read_text().splitlines()
    assert [call.split()[:3] for call in calls] == [["-m", "pip", "install"], ["-P", "-m", "deploy"], ["-P", "-m", "deploy"]]
    assert "eclipse-zenoh==1.10.2" in calls[0]
