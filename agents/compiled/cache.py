"""The cache of compiled loops on disk, valid while their source files, Python and numba are unchanged.

Rules. numba checks only the file of the function that it loads. A loop that calls a function of another file would stay outdated after a
change of that file. The folder of the cache is therefore named after a hash of the contents of all `SOURCES`. The versions of Python and
numba are part of it: what one of them has compiled another does not load. So is the level of PYTHONOPTIMIZE, which changes the bytecode.
"""

import contextlib
import fcntl
import hashlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from protocol.settings import BadSetting

HERE = Path(__file__).resolve().parent
# Compiled loops depend on each other, on the columns of tables, and on constants and functions of their plain twins.
SOURCES = (
    "agents/compiled/*kernels.py",
    "agents/compiled/run_columns.py",
    "agents/coverage/cells.py",
    "agents/coverage/search_plan.py",
    "agents/gossip/table.py",
    "agents/interest/position_table.py",
    "agents/interest/selection.py",
    "agents/tracking/labels.py",
    "agents/tracking/measurement_likelihood.py",
    "protocol/arithmetic.py",
    "protocol/gaussian_components.py",
    "protocol/random_streams.py",
)
COMPLETE = "complete"  # the file in that folder which says that all loops have been compiled
MOST_FOLDERS = 4  # one for each state of sources and versions, this one included; a recent state needs no compilation


@cache
def folder() -> Path:
    """The folder of the compiled loops of these sources, this Python and this numba.

    It lies under NUMBA_CACHE_DIR if that is set, else beside the sources if they are writable, else under the cache of the user.
    """
    versions = f"{sys.implementation.cache_tag} {metadata.version('numba')}{'-O' * sys.flags.optimize}"
    digest = hashlib.blake2b(f"{versions}\0".encode(), digest_size=8)
    for source in sorted(path for pattern in SOURCES for path in HERE.parents[1].glob(pattern)):
        digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    return _base() / f"kernels-{digest.hexdigest()}"


def _base() -> Path:
    """The parent of the folders of compiled loops."""
    chosen, beside = os.environ.get("NUMBA_CACHE_DIR"), HERE / "__pycache__"
    if chosen:
        return Path(chosen).absolute() / "covey"
    if os.access(beside if beside.is_dir() else HERE, os.W_OK):
        return beside
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "covey"


def cached(loop: Callable[..., Any]) -> Any:
    """The loop compiled by numba, or loaded from the cache; used as a decorator."""
    if is_switched_off():
        return np.errstate(over="ignore")(loop)  # hashes of 64 bits overflow, as they do in a compiled loop
    import numba

    config: Any = numba.config
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder())  # numba reads it only while it decorates a function
    try:
        compiled: Any = numba.njit(cache=True)(loop)
    except RuntimeError:  # numba has found no place to write to
        check_place()
        raise
    finally:
        config.CACHE_DIR = before
    load, save = compiled._cache.load_overload, compiled._cache.save_overload

    def load_or_forget(*what: Any) -> Any:
        try:
            return load(*what)
        except Exception:  # a file is damaged, as after a loss of power: the loop is compiled and kept anew
            with _locked(folder()):
                compiled._cache.flush()
            return None

    def save_alone(*what: Any) -> None:
        with _locked(folder()):
            save(*what)

    compiled._cache.load_overload, compiled._cache.save_overload = load_or_forget, save_alone
    return compiled


@contextlib.contextmanager
def _locked(place: Path) -> Iterator[None]:
    """Hold the lock of a folder among all processes.

    Two processes that extend the same index at once may store two signatures of a loop in the same file.
    """
    place.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(place, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


@cache
def number_of_loops() -> int:
    """The number of loops on disk after all have been compiled."""
    return sum(len(re.findall("^@cached$", source.read_text(encoding="utf-8"), re.MULTILINE)) for source in HERE.glob("*kernels.py"))


def loops_on_disk() -> int:
    """The number of loops of these sources that any process has compiled so far."""
    return len({path.name for path in folder().glob("*/*.nbi")})


def compiled_before() -> bool:
    """True if some process has compiled all loops of these sources and has lived to say so, or if none is to be compiled.

    The number on disk does not tell: where a process was ended while it compiled, a loop can be missing that nobody will ever ask for,
    because its callers hold a copy of it.
    """
    return is_switched_off() or (folder() / COMPLETE).exists()


def is_switched_off() -> bool:
    """True if the loops run as plain Python (NUMBA_DISABLE_JIT)."""
    return os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")


def check_place() -> None:
    """Raise BadSetting when loops that are compiled now could not be kept."""
    try:
        folder().mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder()).close()
    except OSError as error:
        line = f"{folder().parent}: compiled loops cannot be kept there: {error.strerror}"
        raise BadSetting(f"{line}; NUMBA_CACHE_DIR names another folder, and NUMBA_DISABLE_JIT=1 does without") from None


def note_complete() -> None:
    """Say on disk that all loops of these sources have been compiled."""
    if not compiled_before():
        (folder() / COMPLETE).touch()


def tidy() -> None:
    """Remove the folders of older sources, except the newest `MOST_FOLDERS` - 1."""
    others = [path for path in folder().parent.glob("kernels-*") if path != folder()]
    others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    for old in others[MOST_FOLDERS - 1 :]:
        shutil.rmtree(old, ignore_errors=True)
