"""Files that are written whole or not at all: a reader sees the former content, or all of the new one."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A file beside `path` to write to; it takes the place of `path` once all is written. Else `path` stays as it was.

    What is there and no file, such as a pipe or a link to a file, is written to itself.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        yield path
        return
    new = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        yield new
        if path.exists():
            shutil.copymode(path, new)
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    """Write these bytes to a file; raises OSError, and leaves what was there."""
    with whole_file(path) as new:
        new.write_bytes(data)
