"""`python -m deploy` and the installed command `covey`: signals and environment first, then the command line."""

import os
import signal

if __name__ == "__main__":
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(130))  # Ctrl-C while this file imports; nothing runs yet
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # the launcher has blocked it while Python started

import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before the first import of numpy

from deploy.cli import errors
from deploy.cli.app import app
from deploy.cli.commands import control, keep, look, run, setup, study  # noqa: F401 -- they add their commands


def main() -> None:
    """Run the command line; exit codes 0 done, 1 failed, 2 bad input, 130 / 143 on signals."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    errors.open_standard_files()
    sys.exit(errors.guarded(lambda: app(exit_on_error=False, print_error=False, result_action="return_value") or 0))


if __name__ == "__main__":
    main()
