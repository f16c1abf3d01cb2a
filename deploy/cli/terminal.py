"""Single keys from a terminal, which is as it was before however the program ends."""

import contextlib
import os
import re
import select
import signal
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from types import FrameType

NAMES = {"\x1b[A": "up", "\x1bOA": "up", "\x1b[B": "down", "\x1bOB": "down"}
KEY = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]|.", re.DOTALL)
Pressed = Callable[[float], list[str]]  # the keys that are pressed within so many s: letters, `up` and `down`; at once when there are some


def is_ours() -> bool:
    """Whether keys can be read: standard input is a terminal, and this program is in front."""
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False


@contextlib.contextmanager
def keyboard(show_cursor: Callable[[bool], object]) -> Iterator[Pressed]:
    """Keys without Enter and without an echo. Ctrl-Z gives the terminal back until the program is in front again."""
    number = sys.stdin.fileno()
    before = termios.tcgetattr(number)

    def leave(signal_number: int, frame: FrameType | None) -> None:
        sys.exit(128 + signal_number)

    def step_back(signal_number: int, frame: FrameType | None) -> None:
        termios.tcsetattr(number, termios.TCSADRAIN, before)
        show_cursor(True)
        os.kill(os.getpid(), signal.SIGSTOP)
        if is_ours():
            tty.setcbreak(number)
            show_cursor(False)

    chosen = {signal.SIGTERM: leave, signal.SIGHUP: leave, signal.SIGTSTP: step_back}
    handlers = {one: signal.signal(one, handler) for one, handler in chosen.items()}
    try:
        tty.setcbreak(number)
        yield lambda seconds: _pressed(number, seconds)
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)
        for one, handler in handlers.items():
            signal.signal(one, handler)


def _pressed(number: int, seconds: float) -> list[str]:
    if not select.select([number], [], [], seconds)[0]:
        return []
    typed = os.read(number, 1024).decode(errors="replace")
    return [NAMES.get(key, key) for key in KEY.findall(typed)] if typed else ["q"]  # the terminal has gone
