"""The end of a run in a terminal: the page stays until Enter or Ctrl-C; and a browser that is opened for it."""

import asyncio
import contextlib
import os
import signal
import sys
import threading
import webbrowser


def is_at_terminal() -> bool:
    """Whether somebody sits at a terminal, sees the output there and can press a key."""
    try:
        return sys.stdin.isatty() and sys.stdout.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False


async def until_key() -> None:
    """Wait for Enter, the end of the input, or a signal that asks to end."""
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, over.set)
    loop.add_reader(sys.stdin.fileno(), over.set)
    await over.wait()
    loop.remove_reader(sys.stdin.fileno())
    with contextlib.suppress(OSError):
        os.set_blocking(sys.stdin.fileno(), False)
        os.read(sys.stdin.fileno(), 4096)  # what was typed is not the shell's
        os.set_blocking(sys.stdin.fileno(), True)


def open_browser(address: str) -> str:
    """Open a page in the user's browser, which may take its time; a line for the user where there is none."""
    if sys.platform == "linux" and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")):
        return f"--open: no display here to open a browser on; open {address} by hand"
    threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    return ""
