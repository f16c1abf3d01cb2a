"""Sockets without SO_LINGER, so that the close of a dead link does not block the process for 10 s.

Zenoh sets SO_LINGER of 10 s on each TCP and TLS socket, which cannot be configured (zenoh issues 1101 and 2350). When the path to a
peer is cut, the lease of the link runs out. Then close() blocks the thread that serves all other links, until the unsent data is
acknowledged, which never happens. So the option is taken off every new socket, well before its lease can run out. Linux only.
"""

import contextlib
import os
import socket
import stat
import struct

DESCRIPTOR_FOLDER = "/proc/self/fd"
LINGER_OFF = struct.pack("ii", 0, 0)


class Sockets:
    """The sockets of this process without the option. A new socket that lacks it may get it later, so it is examined again."""

    def __init__(self) -> None:
        self._done: set[int] = set()  # inodes

    def clear_so_linger(self) -> int:
        """Take SO_LINGER off every new socket; return the number of sockets that had it."""
        there, changed = set[int](), set[int]()
        with contextlib.suppress(OSError):  # the folder exists on Linux alone
            for number in map(int, os.listdir(DESCRIPTOR_FOLDER)):
                with contextlib.suppress(OSError):  # closed meanwhile
                    found = os.fstat(number)
                    if stat.S_ISSOCK(found.st_mode):
                        there.add(found.st_ino)
                        if found.st_ino not in self._done and _clear_so_linger(number):
                            changed.add(found.st_ino)
        self._done = (self._done & there) | changed
        return len(changed)


def _clear_so_linger(descriptor: int) -> bool:
    """Take SO_LINGER off one socket; True if it was on."""
    with socket.socket(fileno=os.dup(descriptor)) as other:
        on, _ = struct.unpack("ii", other.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))
        if on:
            other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER_OFF)
        return bool(on)
