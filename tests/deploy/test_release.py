"""The look for known vulnerabilities of a release: it passes only when somebody has looked and found nothing."""

import os
import subprocess
from pathlib import Path

import pytest

AUDIT = Path(__file__).resolve().parents[2] / ".ci" / "audit"
UNREACHED = "ERROR:pip_audit._cli:Could not connect to PyPI's vulnerability feed"
UNKNOWN = "ERROR:pip_audit._cli:msgspec: Dependency not found on PyPI and could not be audited: msgspec (0.19.0)"
FOUND = "Found 1 known vulnerability in 1 package\nName Version ID\nzenoh 0.1 PYSEC-1"


def audit(folder: Path, says: str, code: int, **environment: str) -> "subprocess.CompletedProcess[str]":
    """The look with a pip-audit that says this and ends with this code."""
    tool = folder / "pip-audit"
    tool.write_text(f'#!/bin/sh\ntouch "{folder}/asked"\ncat >&2 <<END\n{says}\nEND\nexit {code}\n')
    tool.chmod(0o755)
    (folder / "frozen.txt").write_text("msgspec==0.19.0\nnumpy==2.0.0\n")
    words = [str(AUDIT), str(tool), str(folder / "frozen.txt")]
    return subprocess.run(words, env={**os.environ, **environment}, capture_output=True, text=True, timeout=60, check=False)


def test_nothing_known_passes_and_says_how_many_packages_were_looked_at(tmp_path: Path) -> None:
    done = audit(tmp_path, "No known vulnerabilities found", 0)
    assert (done.returncode, done.stdout, done.stderr) == (0, "vulnerabilities: none known in 2 packages\n", "")


def test_a_known_vulnerability_fails_with_the_table_of_pip_audit(tmp_path: Path) -> None:
    done = audit(tmp_path, FOUND, 1)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", FOUND + "\n")


@pytest.mark.parametrize("says", [UNREACHED, UNKNOWN, f"Traceback (most recent call last):\n  File\nOSError: no route\n{UNREACHED}"])
def test_a_database_that_does_not_answer_fails_with_one_line(tmp_path: Path, says: str) -> None:
    done = audit(tmp_path, says, 1)
    assert done.returncode == 1 and done.stdout == ""
    [line] = done.stderr.splitlines()
    assert line.startswith("vulnerabilities: could not be looked for, so this is no release; AUDIT=off goes on without: ")
    assert line.endswith(says.splitlines()[-1])


def test_a_tool_that_cannot_be_started_or_says_nothing_fails_too(tmp_path: Path) -> None:
    assert "pip-audit said nothing" in audit(tmp_path, "", 1).stderr
    (tmp_path / "pip-audit").unlink()
    words = [str(AUDIT), str(tmp_path / "pip-audit"), str(tmp_path / "frozen.txt")]
    assert subprocess.run(words, capture_output=True, timeout=60, check=False).returncode == 1


def test_who_does_not_want_it_says_so_and_is_told_that_nobody_looked(tmp_path: Path) -> None:
    done = audit(tmp_path, FOUND, 1, AUDIT="off")
    assert (done.returncode, done.stdout) == (0, "vulnerabilities: not looked for (AUDIT=off)\n")
    typo = audit(tmp_path, "No known vulnerabilities found", 0, AUDIT="of")
    assert (typo.returncode, typo.stderr) == (2, "AUDIT=of: should be on or off\n")
    assert not (tmp_path / "asked").exists()
