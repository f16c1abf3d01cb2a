"""Which endpoints a process may listen on or dial: anything on this machine, beyond it only with TLS."""

import os
import re
import socket

from protocol.settings import BadSetting, NetworkSettings

FORM = re.compile(r"^[a-z-]+/\S+$")
GUARDED = re.compile(r"^(tls/|quic/|unixsock-stream/|[a-z]+/(127\.\d+\.\d+\.\d+|localhost|\[::1\]):\d+)")


def check_endpoints(settings: NetworkSettings) -> None:
    """Raise BadSetting for an endpoint that cannot be read, or that leaves this machine without TLS unless the settings say insecure."""
    for field in ("listen", "seeds"):
        for endpoint in getattr(settings, field):
            said = f"network.{field} = {endpoint!r}"
            if not FORM.match(endpoint):
                raise BadSetting(f"{said}: should read protocol/address:port, such as tcp/127.0.0.1:0")
            if not settings.insecure and not GUARDED.match(endpoint):
                raise BadSetting(f"{said}: leaves this machine without TLS; use tls/..., a loopback address, or network.insecure = true")


def free_port(lowest: int = 20000, highest: int = 32000) -> int:
    """A TCP port on 127.0.0.1 that nobody listens on now, below the range that the kernel gives to outgoing connections."""
    span = highest - lowest
    start = int.from_bytes(os.urandom(4), "little")
    for step in range(span):
        port = lowest + (start + 7 * step) % span
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
                return port
            except OSError:
                continue
    raise BadSetting(f"no free port between {lowest} and {highest} on 127.0.0.1")
