"""The terminal of a command: whether a person uses it, single keys from it, and a browser beside it.

A terminal is restored however the program ends.
"""

import asyncio
import contextlib
import os
import re
import select
import signal
import sys
import termios
import threading
import tty
import webbrowser
from collections.abc import Callable, Iterator
from types import FrameType

from rich.console import Console

NAMES = {"\x1b[A": "up", "\x1bOA": "up", "\x1b[B": "down", "\x1bOB": "down"}
KEY = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]|.", re.DOTALL)
PLAIN_WIDTH = 160  # columns where there is no terminal
Pressed = Callable[[float], list[str]]  # the keys that are pressed within so many s: letters, `up` and `down`; at once when there are some


def reads_keys() -> bool:
    """Whether keys can be read: standard input is a terminal, and this program is in front."""
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False


def stop_event() -> asyncio.Event:
    """An event that Ctrl-C, SIGTERM and a closed terminal set, in the loop that runs."""
    from protocol.live import ending_signals  # loads zenoh

    over = asyncio.Event()
    for number in ending_signals():
        asyncio.get_running_loop().add_signal_handler(number, over.set)
    return over


@contextlib.contextmanager
def keyboard(show_cursor: Callable[[bool], object]) -> Iterator[Pressed]:
    """Keys without Enter and without an echo. Ctrl-Z gives the terminal back until the program is in front again.

    Signals wait until the first look for keys, if the program has one thread: an exception while the `with` statement enters would leave
    the terminal as it is.
    """
    number = sys.stdin.fileno()
    before = termios.tcgetattr(number)

    def leave(signal_number: int, frame: FrameType | None) -> None:
        sys.exit(128 + signal_number)

    def step_back(signal_number: int, frame: FrameType | None) -> None:
        termios.tcsetattr(number, termios.TCSADRAIN, before)
        show_cursor(True)
        os.kill(os.getpid(), signal.SIGSTOP)
        if reads_keys():
            tty.setcbreak(number)
            show_cursor(False)

    def pressed(seconds: float) -> list[str]:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, asking)
        return _pressed(number, seconds)

    chosen = {signal.SIGTERM: leave, signal.SIGHUP: leave, signal.SIGTSTP: step_back}
    handlers = {one: signal.signal(one, handler) for one, handler in chosen.items()}
    asking = {signal.SIGINT, *chosen}
    signal.pthread_sigmask(signal.SIG_BLOCK, asking)
    try:
        tty.setcbreak(number)
        yield pressed
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)
        for one, handler in handlers.items():
            signal.signal(one, handler)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, asking)


def _pressed(number: int, seconds: float) -> list[str]:
    if not select.select([number], [], [], seconds)[0]:
        return []
    typed = os.read(number, 1024).decode(errors="replace")
    return [NAMES.get(key, key) for key in KEY.findall(typed)] if typed else ["q"]  # the terminal has gone


def is_at_terminal() -> bool:
    """Whether keys can be read, and what is printed is seen there."""
    return reads_keys() and sys.stdout.isatty()


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
        os.read(sys.stdin.fileno(), 4096)  # typed characters must not reach the shell
        os.set_blocking(sys.stdin.fileno(), True)


def table_console() -> Console:
    """Where tables are printed: as wide as the terminal, or `PLAIN_WIDTH` columns where there is none.

    Brackets are no markup: they may stand in paths, and anybody may publish under keys that hold some.
    """
    return Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else PLAIN_WIDTH)


def open_browser(address: str) -> str:
    """Open a page in the user's browser without waiting for it; a line for the user when there is no display."""
    if sys.platform == "linux" and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")):
        return f"--open: no display here to open a browser on; open {address} by hand"
    threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    return ""
