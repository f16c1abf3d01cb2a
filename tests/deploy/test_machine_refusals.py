"""What a machine refuses: full disks and outputs, closed files, a network that is not there; each is one line, before anything starts."""

import os
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from deploy.storage.run_directory import RunDirectory
from tests.deploy.wrong_inputs import folder, typed

__all__ = ["folder"]  # a fixture
ROOT = Path(__file__).parents[2]


def program(*words: str) -> list[str]:
    return [sys.executable, "-P", "-m", "deploy", *words]


def started(command: list[str] | str, folder: Path, **more: Any) -> tuple[int, list[str]]:
    """Exit code and complaints of a program, or of a line of shell."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COVEY_RUNS": str(folder / "runs")}
    shell = isinstance(command, str)
    done = subprocess.run(
        command, cwd=folder, env=environment, shell=shell, stderr=subprocess.PIPE, timeout=100, **{"stdout": subprocess.PIPE, **more}
    )
    return done.returncode, done.stderr.decode().splitlines()


@pytest.mark.parametrize("line", ["help", "config quick", "ps -a", "completion bash", "--version"])
def test_a_standard_output_that_is_full_is_one_line_and_exit_code_1(line: str, folder: Path) -> None:
    with open("/dev/full", "wb") as full:
        code, complaints = started(program(*shlex.split(line)), folder, stdout=full)
    assert (code, complaints) == (1, ["covey: standard output: No space left on device"])


@pytest.mark.parametrize("locale", [{"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}, {"PYTHONIOENCODING": "ascii"}])
def test_a_letter_that_the_locale_does_not_have_is_written_otherwise(
    locale: dict[str, str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    RunDirectory("one").path.mkdir(parents=True)
    RunDirectory("one").config.write_text("[run]\nscenario = 'h\u00fcgel.toml'\n", encoding="utf-8")
    for name, value in locale.items():
        monkeypatch.setenv(name, value)
    with (folder / "said").open("wb") as said:
        assert started(program("runs"), folder, stdout=said) == (0, [])
    assert "h\\xfcgel.toml" in (folder / "said").read_text(encoding="ascii")


def test_a_reader_who_leaves_is_no_error(folder: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    assert started(program("completion", "bash"), folder, stdout=writer) == (0, [])
    os.close(writer)


def test_closed_standard_files_and_a_folder_that_has_gone_are_no_traceback(folder: Path) -> None:
    shell = " ".join(map(shlex.quote, program("config", "quick")))
    assert started(f"{shell} <&- >&-", folder) == (0, [])
    (folder / "gone").mkdir()
    code, complaints = started(f"cd gone && rmdir ../gone && {shell}", folder)
    assert (code, complaints) == (1, ["covey: the current folder: No such file or directory"])


def test_a_runs_folder_that_cannot_be_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(folder / "file" / "runs"))
    for words in (["up", "quick"], ["demo"], ["up", "quick", "--detach"]):
        code, complaints = typed(words, capsys)
        assert code == 2 and len(complaints) == 1 and "Not a directory; COVEY_RUNS names another place" in complaints[0]
    code, complaints = typed(["check", "quick"], capsys)
    assert code == 2 and len(complaints) == 1 and "cannot be written; COVEY_RUNS names another place" in complaints[0]


def namespaced(kind: str, script: str, folder: Path) -> tuple[int, list[str]]:
    """Exit code and complaints of a line of shell in a namespace of its own, which takes what it mounts with it."""
    if shutil.which("unshare") is None or subprocess.run(["unshare", kind, "true"], capture_output=True).returncode:
        pytest.skip("needs the right to make namespaces: root, and unshare")
    return started(["unshare", kind, "sh", "-c", script], folder)


@pytest.mark.parametrize("line", ["up quick --lockstep --seconds 2", "up quick --detach", "demo --no-page", "check quick"])
@pytest.mark.parametrize(
    ("options", "reason"), [("size=8k", "No space left on device"), pytest.param("ro", "Read-only file system", marks=pytest.mark.slow)]
)
def test_a_disk_that_is_full_or_may_not_be_written_is_told_before_anything_starts(
    line: str, options: str, reason: str, folder: Path
) -> None:
    (folder / "runs").mkdir()
    fill = "head -c 8192 /dev/zero > runs/fill; " if options.startswith("size") else ""
    script = f"mount -t tmpfs -o {options} none runs && {fill}exec {' '.join(map(shlex.quote, program(*shlex.split(line))))}"
    code, complaints = namespaced("-m", script, folder)
    told = (
        {"No space left on device": "the disk is full", "Read-only file system": "cannot be written"}[reason] if "check" in line else reason
    )
    assert code == 2 and len(complaints) == 1 and told in complaints[0] and "COVEY_RUNS names another place" in complaints[0], complaints


@pytest.mark.parametrize("line", ["up quick --seconds 2", "demo", "check quick"])
def test_a_machine_that_cannot_reach_itself_is_told_before_anything_starts(line: str, folder: Path) -> None:
    code, complaints = namespaced("-n", f"exec {' '.join(map(shlex.quote, program(*shlex.split(line))))}", folder)
    assert code == 2 and len(complaints) == 1, complaints
    assert "127.0.0.1 cannot be reached: Network is unreachable; `ip link set lo up`" in complaints[0]


@pytest.mark.live
@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("up quick --seconds 2 --page PORT", "--page 127.0.0.1:PORT: Address already in use"),
        ("up quick --seconds 2 --page 99999", "--page 99999: should be a port such as 8080, or host:port"),
        ("up quick --seconds 2 --page nowhere:80", "--page nowhere:80: "),
        ("up quick --seconds 2 --set network.listen=[\"tcp/127.0.0.1:PORT\"]", "network.listen = tcp/127.0.0.1:PORT: the port is in use"),
        ("up quick --seconds 2 --keys nowhere", "nowhere/ca.pem': No such file or directory; `covey keys` makes"),
        ("up quick --seconds 2 --record file/x.mcap", "--record file/x.mcap: "),
        ("up quick --seconds 2 --detach --page PORT", "--page 127.0.0.1:PORT: Address already in use"),
    ],
)  # fmt: skip
def test_what_the_machine_refuses_a_swarm_is_one_line(line: str, part: str, folder: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        code, complaints = started(program(*shlex.split(line.replace("PORT", port), posix=False)), folder)
    complaints = [complaint for complaint in complaints if not complaint.startswith("covey: compiling")]
    assert code == 2 and len(complaints) == 1 and part.replace("PORT", port) in complaints[0], complaints


@pytest.mark.live
@pytest.mark.parametrize("line", ["up quick --seconds 2 --lockstep", pytest.param("simulate quick --seconds 2", marks=pytest.mark.slow)])
def test_a_run_whose_output_has_no_room_ends_with_one_line(line: str, folder: Path) -> None:
    with open("/dev/full", "wb") as full:
        code, complaints = started(program(*shlex.split(line)), folder, stdout=full)
    complaints = [complaint for complaint in complaints if complaint.startswith("covey: ") and "compiling" not in complaint]
    assert (code, complaints) == (1, ["covey: standard output: No space left on device"])
