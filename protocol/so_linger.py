"""Sockets that close at once: Zenoh's would freeze the whole process for 10 s for every link that has gone dead.

Zenoh gives each TCP and TLS socket SO_LINGER of 10 s, which cannot be configured (zenoh issues 1101 and 2350). When the way to a peer is
cut, the link's lease runs out, and close() holds up the thread that serves all other links until the unsent data is acknowledged,
which it never is. So the option is taken off again, as soon as a socket is there and well before its lease can run out. Linux only.
"""

import contextlib
import os
import socket
import struct

FOLDER = "/proc/self/fd"
OFF = struct.pack("ii", 0, 0)


class Sockets:
    """The sockets of this process whose option has been taken off. One that has been seen without it may be so new that it gets it yet."""

    def __init__(self) -> None:
        self._done: set[str] = set()  # "socket:[inode]"

    def let_go(self) -> int:
        """Take SO_LINGER off every socket of which that has not been done yet; of how many."""
        there, changed = set(), set()
        with contextlib.suppress(OSError):  # there is no such folder elsewhere
            for number in os.listdir(FOLDER):
                with contextlib.suppress(OSError):  # closed meanwhile
                    name = os.readlink(f"{FOLDER}/{number}")
                    if name.startswith("socket:"):
                        there.add(name)
                        if name not in self._done and _let_go(int(number)):
                            changed.add(name)
        self._done = (self._done & there) | changed
        return len(changed)


def _let_go(descriptor: int) -> bool:
    """Take SO_LINGER off one socket; whether it was on."""
    with socket.socket(fileno=os.dup(descriptor)) as other:
        on, _ = struct.unpack("ii", other.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))
        if on:
            other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, OFF)
        return bool(on)
