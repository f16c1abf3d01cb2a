"""Where a page listens.

A command without a page needs no more of the page than this: importing the server costs a fifth of a second of CPU time.
"""

from typing import NamedTuple

from protocol.settings import BadSetting

PORT = 8737  # unless it is taken
LOOPBACK = ("127.0.0.1", "localhost", "::1")


class Address(NamedTuple):
    """Where to listen; `fixed` when a port that is taken is an error."""

    host: str
    port: int
    fixed: bool

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return self.host in LOOPBACK


def address_of(page: bool | str) -> Address | None:
    """--page, --page 8080, --page 0.0.0.0:8080 or --page [::1]:8080; None when no page is wanted. Raises BadSetting."""
    if isinstance(page, bool):
        return Address("127.0.0.1", PORT, False) if page else None
    host, _, port = page.rpartition(":")
    if not port.isdecimal() or not 0 <= int(port) <= 65535:
        raise BadSetting(f"--page {page}: should be a port such as 8080, or host:port")
    return Address(host.removeprefix("[").removesuffix("]") or "127.0.0.1", int(port), True)
