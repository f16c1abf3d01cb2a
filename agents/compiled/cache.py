"""Compiled loops kept on disk, for as long as none of the files that they are made of has changed.

numba looks only at the file of the function that it loads. A loop that calls one of another file would stay as it was when that one
changes, by an update or by hand, and compute something else than its source says: so what is kept lies in a folder that is named after the
contents of all these files.
"""

import contextlib
import fcntl
import hashlib
import os
import re
import shutil
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
# Compiled loops are made of each other, of the numbers of the columns of a row, and of the limits of messages.
SOURCES = ("agents/compiled/*kernels.py", "agents/gossip/table.py", "protocol/codec.py", "protocol/fields.py")
MOST_FOLDERS = 4  # of states of the sources, this one included: who goes back and forth between two need not compile again


@cache
def folder() -> Path:
    """Where compiled loops of just these sources lie: under NUMBA_CACHE_DIR if that is set, else beside the sources if that can be
    written, else under the user's caches."""
    digest = hashlib.blake2b(digest_size=8)
    for source in sorted(path for pattern in SOURCES for path in HERE.parents[1].glob(pattern)):
        digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    return _base() / f"kernels-{digest.hexdigest()}"


def _base() -> Path:
    chosen, beside = os.environ.get("NUMBA_CACHE_DIR"), HERE / "__pycache__"
    if chosen:
        return Path(chosen).absolute() / "covey"
    if os.access(beside if beside.is_dir() else HERE, os.W_OK):
        return beside
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "covey"


def cached(loop: Callable[..., Any]) -> Any:
    """A decorator: compile for numba, or load what was compiled before."""
    import numba

    config: Any = numba.config
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder())  # asked for while a function is decorated, and never again
    try:
        compiled: Any = numba.njit(cache=True)(loop)
    finally:
        config.CACHE_DIR = before
    save = compiled._cache.save_overload

    def save_alone(*what: Any) -> None:
        with _locked(folder()):
            save(*what)

    compiled._cache.save_overload = save_alone
    return compiled


@contextlib.contextmanager
def _locked(place: Path) -> Iterator[None]:
    """Alone among all processes: two that add to the same index at once may give two signatures of a loop the same file."""
    place.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(place, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


@cache
def number_of_loops() -> int:
    """How many loops are kept on disk once all have been compiled."""
    return sum(len(re.findall("^@cached$", source.read_text(encoding="utf-8"), re.MULTILINE)) for source in HERE.glob("*kernels.py"))


def loops_on_disk() -> int:
    """How many of the loops of these sources have been compiled, by this process or another."""
    return len({path.name for path in folder().glob("*/*.nbi")})


def compiled_before() -> bool:
    """Whether all loops of these sources lie on disk."""
    return loops_on_disk() >= number_of_loops()


def tidy() -> None:
    """Remove compiled loops of older sources, but the newest few."""
    others = [path for path in folder().parent.glob("kernels-*") if path != folder()]
    others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    for old in others[MOST_FOLDERS - 1 :]:
        shutil.rmtree(old, ignore_errors=True)
