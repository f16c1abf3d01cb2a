"""`python -m deploy`, which the script `./covey` runs, and the installed command `covey`, which calls `main`.

Signals and environment first, then the command line.
"""

import os
import signal
from types import FrameType

if __name__ == "__main__":
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(130))  # Ctrl-C while this file imports; nothing runs yet
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # the script `./covey` has blocked it while Python started

import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before the first import of numpy

from deploy.cli import errors
from deploy.cli.app import app
from deploy.cli.commands import control, keep, look, run, setup, study  # noqa: F401 -- they add their commands


def main() -> None:
    """Run the command line; exit codes 0 done, 1 failed, 2 bad input, 130 / 143 on signals."""
    signal.signal(signal.SIGINT, interrupt)
    errors.open_standard_files()
    sys.exit(errors.guarded(lambda: app(exit_on_error=False, print_error=False, result_action="return_value") or 0))


def interrupt(number: int, frame: FrameType | None) -> None:
    """Ctrl-C raises KeyboardInterrupt. While a module is being imported it ends the program: compiled modules may swallow the exception."""
    at = frame
    while at is not None:
        if at.f_code.co_filename.startswith("<frozen importlib"):
            os._exit(errors.INTERRUPTED)
        at = at.f_back
    signal.default_int_handler(number, frame)


if __name__ == "__main__":
    main()
