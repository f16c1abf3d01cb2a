"""The directory of a run, and which runs are running.

    runs/<name>/run.toml       the resolved scenario that every process reads
                versions.json  software, Python, machine
                logs/          one file per process, JSON lines
                result.json    the result, once there is one
                lock           held by the supervisor as long as the run runs
                control.json   where the supervisor's control socket is

`runs` lies in the current directory unless COVEY_RUNS names another place.
"""

import contextlib
import errno
import fcntl
import json
import os
import platform
import shutil
import socket
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec

from deploy.scenario import Scenario
from deploy.toml_text import toml_text
from protocol.messages import WIRE_VERSION
from protocol.settings import BadSetting

PACKAGES = ("covey", "eclipse-zenoh", "numpy", "scipy", "shapely", "msgspec", "numba")


def runs_folder() -> Path:
    """The folder that holds all run directories, absolute."""
    return Path(os.environ.get("COVEY_RUNS") or "runs").absolute()


class RunDirectory:
    """Paths of one run."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.path = runs_folder() / name
        self.config = self.path / "run.toml"
        self.versions = self.path / "versions.json"
        self.logs = self.path / "logs"
        self.result = self.path / "result.json"
        self.lock = self.path / "lock"
        self.control = self.path / "control.json"
        self.truth = self.path / "truth.msgpack"

    def log(self, name: str) -> Path:
        """The log file of one process."""
        return self.logs / f"{name}.jsonl"

    def claim(self) -> int:
        """Take the run for this process: a descriptor that holds the lock while it is open. Raises BadSetting when the run is running.

        What an earlier run of this name left behind is removed.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self.lock, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            raise BadSetting(f"run directory {self.path}: {error.strerror}; COVEY_RUNS names another place") from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
            raise BadSetting(
                f"--run {self.name}: a run of this name is running; end it with `covey down --run {self.name}` or take another name"
            ) from None
        for file in (self.config, self.versions, self.result, self.control, self.truth):
            file.unlink(missing_ok=True)
        shutil.rmtree(self.logs, ignore_errors=True)
        self.logs.mkdir()
        return descriptor

    def is_running(self) -> bool:
        """Whether a supervisor holds the run."""
        try:
            descriptor = os.open(self.lock, os.O_RDWR)
        except OSError:
            return False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
        finally:
            os.close(descriptor)
        return False

    def write_config(self, scenario: Scenario) -> None:
        """Write run.toml and versions.json."""
        self.config.write_text(toml_text(msgspec.to_builtins(scenario)), encoding="utf-8")
        self.versions.write_text(json.dumps(versions(), indent=2) + "\n", encoding="utf-8")

    def socket_path(self) -> Path:
        """Where to put the control socket: a short path of this user's own, for socket paths are limited to about 100 bytes."""
        folder = Path(tempfile.gettempdir()) / f"covey-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.stat().st_uid != os.getuid() or folder.is_symlink():
            raise BadSetting(f"{folder}: belongs to somebody else; set TMPDIR to a folder of your own")
        _sweep(folder)
        return folder / f"{self.name[:40]}-{os.getpid()}.sock"


def _sweep(folder: Path) -> None:
    """Remove the sockets of supervisors that were killed: their process is gone, and nobody answers."""
    for path in folder.glob("*.sock"):
        pid = path.stem.rpartition("-")[2]
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as probe:
            if pid.isdecimal() and not _exists(int(pid)) and probe.connect_ex(str(path)) == errno.ECONNREFUSED:
                path.unlink()


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def find_running(name: str | None) -> RunDirectory:
    """The running run of that name, or the newest running one; raises BadSetting when there is none."""
    if name is not None:
        directory = RunDirectory(name)
        if not directory.is_running():
            raise BadSetting(f"--run {name}: no run of this name is running in {runs_folder()}{_others()}")
        return directory
    running = running_runs()
    if not running:
        raise BadSetting(f"no run is running in {runs_folder()}; start one with `covey up`")
    return running[-1]


def running_runs() -> list[RunDirectory]:
    """All runs that are running, the newest last."""
    folder = runs_folder()
    names = [path.name for path in folder.iterdir() if path.is_dir()] if folder.is_dir() else []
    running = [directory for directory in map(RunDirectory, names) if directory.is_running()]
    return sorted(running, key=lambda directory: directory.config.stat().st_mtime if directory.config.exists() else 0.0)


def _others() -> str:
    names = ", ".join(directory.name for directory in running_runs())
    return f"; running are {names}" if names else ""


def versions() -> dict[str, Any]:
    """What ran: versions of the packages, of Python and of the wire, and the kind of machine."""
    installed = {}
    for package in PACKAGES:
        try:
            installed[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            installed[package] = ""
    return {
        "wire": WIRE_VERSION,
        "python": sys.version.split()[0],
        "machine": platform.platform(),
        "cores": os.cpu_count(),
        "packages": installed,
    }
