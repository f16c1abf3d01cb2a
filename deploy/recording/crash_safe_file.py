"""A file that stays readable when its writer is killed: a settled part, and a tail with small chunks of the next part."""

import contextlib
import os
from pathlib import Path


class GrowingFile:
    """The stream of an MCAP writer. What it writes waits until `settle`, which puts it in the place of the tail.

    A disk that is full (OSError) costs neither the settled part nor the tail: what lies beyond the tail is written first.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        self._parts: list[bytes] = []
        self._staged = 0
        self.settled = 0  # bytes
        self.size = 0  # bytes in the file, the tail among them

    def write(self, data: bytes) -> int:
        """Keep bytes until they are settled."""
        self._parts.append(bytes(data))
        self._staged += len(data)
        return len(data)

    def tell(self) -> int:
        """Where the next byte will stand."""
        return self.settled + self._staged

    def flush(self) -> None:
        """Nothing: `settle` writes."""

    def extend(self, data: bytes) -> None:
        """Let the tail grow; raises OSError when there is no room, the file being as before."""
        self._put_behind(data)
        self.size += len(data)

    def settle(self) -> None:
        """Write what the writer has written, in place of the tail; raises OSError when there is no room, the file being as before."""
        data, tail = b"".join(self._parts), self.size - self.settled
        self._put_behind(data[tail:])
        self._put(data[:tail], self.settled)
        self._parts, self._staged = [], 0
        self.settled += len(data)
        self.size = self.settled
        os.ftruncate(self._file.fileno(), self.size)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _put_behind(self, data: bytes) -> None:
        try:
            self._put(data, self.size)
        except OSError:
            with contextlib.suppress(OSError):  # the first error is the one to report
                os.ftruncate(self._file.fileno(), self.size)
            raise

    def _put(self, data: bytes, offset: int) -> None:
        left = memoryview(data)
        while left:
            written = os.pwrite(self._file.fileno(), left, offset)
            left, offset = left[written:], offset + written
