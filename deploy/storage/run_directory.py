"""The directory of a run, and which runs are running.

    runs/<name>/run.toml       the resolved scenario, which the world and the watchers read
                agents.toml    what an agent may know of it
                versions.json  software, Python, machine
                logs/          one file per process, JSON lines; <name>.halt: the newest halt that a mover of bodies has taken
                result.json    the result, once there is one
                scores.csv     the scores of every tick, with the result
                recording.mcap the recording, if one was asked for
                lock           held by the supervisor or the simulation as long as the run runs
                control.json   where the supervisor's control socket is
                page           the address of the page, if there is one
                truth.msgpack  the last Truth, after a restart of the world or of a body
                up.log         the terminal output of a detached run

`runs` lies in the current directory unless COVEY_RUNS names another place. How runs are named and kept: `deploy.storage.kept_runs`.
"""

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from deploy.installation import versions
from deploy.scenario import Scenario, agent_config, toml_text
from protocol.settings import BadSetting
from protocol.whole_file import write_whole

LATEST_LINK = "latest"  # the link to the run that began last
LEAST_BYTES = 16384  # on disk that a run needs, for its run.toml
LONGEST_SOCKET = 107  # bytes of the path of a Unix socket
LOCK_TRIES, LOCK_PAUSE = 10, 0.01  # and s between them, before a run counts as held by another process


def runs_folder() -> Path:
    """The folder that holds all run directories, absolute."""
    return Path(os.environ.get("COVEY_RUNS") or "runs").absolute()


class RunDirectory:
    """Paths of one run."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.path = runs_folder() / name
        self.config = self.path / "run.toml"
        self.agents = self.path / "agents.toml"
        self.versions = self.path / "versions.json"
        self.logs = self.path / "logs"
        self.result = self.path / "result.json"
        self.scores = self.path / "scores.csv"
        self.lock = self.path / "lock"
        self.control = self.path / "control.json"
        self.truth = self.path / "truth.msgpack"
        self.page = self.path / "page"  # its address
        self.output = self.path / "up.log"  # the terminal output of a detached run

    def log(self, name: str) -> Path:
        """The log file of one process."""
        return self.logs / f"{name}.jsonl"

    def hold(self) -> int | None:
        """Lock the run for this process: a descriptor that holds the lock while it is open; None while another process holds it."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self.lock, os.O_RDWR | os.O_CREAT, 0o644)  # others may look
        except OSError as error:
            raise BadSetting(f"run directory {self.path}: {error.strerror}; COVEY_RUNS names another place") from None
        try:
            if not _lock_alone(descriptor):
                os.close(descriptor)
                return None
        except OSError as error:
            os.close(descriptor)
            raise BadSetting(
                f"run directory {self.path}: files cannot be locked: {error.strerror}; COVEY_RUNS names another place"
            ) from None
        return descriptor

    def clear(self) -> None:
        """Remove what a start that failed has left, and check that a run finds room; raises BadSetting when it does not."""
        with self._writing():
            self.page.unlink(missing_ok=True)
            shutil.rmtree(self.logs, ignore_errors=True)
            self.logs.mkdir()
            self.config.write_bytes(bytes(LEAST_BYTES))  # a full disk is known before anything starts
            self.config.unlink()

    def leave_unless_begun(self) -> None:
        """Remove the folder where no run has begun in it: its start was refused or interrupted."""
        if not self.config.exists():
            shutil.rmtree(self.path, ignore_errors=True)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Raise BadSetting naming the folder when it cannot be written."""
        try:
            yield
        except OSError as error:
            raise BadSetting(f"run directory {self.path}: {error.strerror}; COVEY_RUNS names another place") from None

    def is_running(self) -> bool:
        """Whether a supervisor or a simulation holds the run."""
        try:
            descriptor = os.open(self.lock, os.O_RDONLY)  # it may be that of another user
        except OSError:
            return False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)  # a shared one is in the way of no other look
        except BlockingIOError:
            return True
        except OSError:  # no locks here: nothing can be running
            return False
        finally:
            os.close(descriptor)
        return False

    def is_free(self) -> bool:
        """Whether nothing is here but what a start that failed may leave, so that a run can take the place."""
        if not self.path.is_dir():
            return not os.path.lexists(self.path)
        return {file.name for file in self.path.iterdir()} <= {file.name for file in (self.lock, self.logs, self.output, self.page)}

    def write_config(self, scenario: Scenario, *, simulated: bool = False, replayed: bool = False) -> None:
        """Write run.toml, agents.toml and versions.json. `replayed`: it is a recording that is said again."""
        about = {**versions(), "simulated": simulated, "replayed": replayed}
        with self._writing():
            write_whole(self.versions, json.dumps(about, indent=2).encode() + b"\n")
            write_whole(self.agents, toml_text(agent_config(scenario)).encode())
            write_whole(self.config, toml_text(scenario).encode())  # the last one: with it the run has begun

    def is_simulated(self) -> bool:
        """Whether the run is a simulation, which has no processes and no supervisor that could be asked."""
        return self._is("simulated")

    def is_replayed(self) -> bool:
        """Whether the run is a recording that is said again: it can be heard, but nobody is there to be asked."""
        return self._is("replayed")

    def how_to_end(self) -> str:
        """What the run is, where it has no supervisor, and how it is ended while it runs."""
        if self.is_simulated():
            return "it is a simulation, which has no processes and no network; Ctrl-C in its terminal ends it"
        if self.is_replayed():
            return "it is a recording that is said again, which can be heard but has no processes; Ctrl-C in its terminal ends it"
        return f"end it with `covey down --run {self.name}`"

    def _is(self, kind: str) -> bool:
        try:
            return bool(json.loads(self.versions.read_text(encoding="utf-8")).get(kind))
        except (OSError, ValueError, AttributeError):
            return False

    def socket_path(self) -> Path:
        """The path of the control socket, in a folder of this user: short whatever the run is called. Raises BadSetting."""
        folder = Path(tempfile.gettempdir()) / f"covey-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.stat().st_uid != os.getuid() or folder.is_symlink():
            raise BadSetting(f"{folder}: belongs to somebody else; set TMPDIR to a folder of your own")
        _sweep(folder)
        path = folder / f"{hashlib.blake2b(os.fsencode(self.path), digest_size=6).hexdigest()}-{os.getpid()}.sock"
        if (excess := len(os.fsencode(path)) - LONGEST_SOCKET) > 0:
            room = LONGEST_SOCKET - len(os.fsencode(path.relative_to(folder.parent))) - 1
            raise BadSetting(f"TMPDIR = {folder.parent}: is {excess} bytes too long for a socket in it; should have at most {room}")
        return path


def _lock_alone(descriptor: int) -> bool:
    """Lock a file for this process; False while another has locked it. Somebody who only looks holds it for an instant."""
    for _ in range(LOCK_TRIES):
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        time.sleep(LOCK_PAUSE)
    return False


def is_running_already(name: str) -> BadSetting:
    """The complaint about a name whose run is running."""
    return BadSetting(f"--run {name}: a run of this name is running; {RunDirectory(name).how_to_end()}; or take another name")


def _sweep(folder: Path) -> None:
    """Remove the sockets of killed supervisors: no process and no answer."""
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


def find_running(name: str | None, *, supervised: bool = False) -> RunDirectory:
    """The running swarm of that name, or the newest; with `supervised` one that has processes. Raises BadSetting when there is none."""
    if name is not None:
        with contextlib.suppress(OSError):
            name = os.readlink(runs_folder() / LATEST_LINK) if name == LATEST_LINK else name
        directory = RunDirectory(name)
        if not directory.is_running():
            raise BadSetting(f"--run {name}: no run of this name is running in {runs_folder()}{_others()}")
        if directory.is_simulated() or (supervised and directory.is_replayed()):
            raise BadSetting(f"--run {name}: {directory.how_to_end()}")
        return directory
    running = [directory for directory in running_runs() if not (supervised and directory.is_replayed())]
    if not running:
        raise BadSetting(f"no run is running in {runs_folder()}; start one with `covey up`")
    return running[-1]


def run_directories() -> list[RunDirectory]:
    """The directories of all runs, in no order; `latest` is a link and none of them."""
    folder = runs_folder()
    names = [path.name for path in folder.iterdir() if path.is_dir() and not path.is_symlink()] if folder.is_dir() else []
    return list(map(RunDirectory, names))


def running_runs() -> list[RunDirectory]:
    """All runs that are running and can be heard, the newest last; no simulations."""
    running = [directory for directory in run_directories() if directory.is_running() and not directory.is_simulated()]
    return sorted(running, key=_began)


def _began(directory: RunDirectory) -> float:
    """When the run began, Unix time in s; 0 before it has, or once it is removed."""
    try:
        return directory.config.stat().st_mtime
    except OSError:
        return 0.0


def _others() -> str:
    names = ", ".join(directory.name for directory in running_runs())
    return f"; running are {names}" if names else ""
