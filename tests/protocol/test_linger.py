"""SO_LINGER is taken off the sockets of this process, once, and nothing else about them changes."""

import os
import socket
import struct
import sys

import pytest

from protocol.so_linger import Sockets

pytestmark = pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason=f"needs /proc/self/fd, which {sys.platform} has not")


def linger(link: socket.socket) -> tuple[int, int]:
    on, seconds = struct.unpack("ii", link.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))
    return on, seconds


def test_lingering_sockets_are_let_go_once_and_still_work() -> None:
    sockets = Sockets()
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as link:
        other, _ = server.accept()
        with other:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
            assert linger(link) == (1, 10)
            assert sockets.clear_so_linger() >= 1
            assert linger(link)[0] == 0
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
            sockets.clear_so_linger()
            assert linger(link) == (1, 10), "a socket is looked at once"
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 0, 0))
            link.sendall(b"still open")
            assert other.recv(100) == b"still open"


def test_a_socket_that_gets_its_option_only_after_the_first_look_is_let_go_all_the_same() -> None:
    sockets = Sockets()
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as link:
        sockets.clear_so_linger()
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
        sockets.clear_so_linger()
        assert linger(link)[0] == 0
