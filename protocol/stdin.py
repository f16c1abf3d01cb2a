"""Standard input of a supervised process: lines from its parent, and an end when the parent is gone."""

import asyncio
import os
from collections.abc import Callable


def follow_stdin(stop: Callable[[int, str], None], on_line: Callable[[str], None] | None) -> None:
    """Read stdin in the running event loop: hand lines to `on_line`; at its end call `stop` with an exit code and a reason."""
    loop, pending = asyncio.get_running_loop(), b""

    def read() -> None:
        nonlocal pending
        data = os.read(0, 65536)
        if not data:
            loop.remove_reader(0)
            stop(143, "stdin ended: the parent is gone")
        *lines, pending = (pending + data).split(b"\n")
        for line in lines:
            if on_line is not None:
                on_line(line.decode(errors="replace"))

    loop.add_reader(0, read)
