"""Errors of commands: one line on standard error and an exit code. A traceback is shown only when COVEY_DEBUG is set."""

import contextlib
import io
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from cyclopts import CycloptsError, UnusedCliTokensError

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
MOST_REMARKS = 3  # about the files of a recorded world, before a run


def open_standard_files() -> None:
    """Open closed standard files on the null device, so that a file opened later does not take their descriptors.

    Standard output writes \\xfc for a letter that the locale does not have.
    """
    for number, mode in ((0, "r"), (1, "w"), (2, "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
            setattr(sys, ("stdin", "stdout", "stderr")[number], open(number, mode, closefd=False))  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def guarded(command: Callable[[], int]) -> int:
    """The exit code of a command. An exception becomes one line on standard error."""
    try:
        sys.path.append(os.getcwd())  # where a user's own sensor models and controllers are
    except OSError as error:
        return complain(f"the current folder: {error.strerror}", FAILED)
    try:
        code = command()
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        lead_nowhere()
        return OK  # the reader of the pipe has closed it
    except SystemExit as end:
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        lead_nowhere()
        return OK  # Rich has seen the same
    except Exception as error:
        if os.environ.get("COVEY_DEBUG"):
            raise
        return _tell(error)


def _tell(error: Exception) -> int:
    from protocol.settings import BadSetting  # loads numpy

    if isinstance(error, UnusedCliTokensError):
        command = " ".join(error.command_chain or ())
        return complain(f"{command}: {' '.join(error.unused_tokens or ())}: should be left out; see `covey help {command}`", BAD_INPUT)
    if isinstance(error, CycloptsError | BadSetting):
        return complain(str(error), BAD_INPUT)
    if isinstance(error, OSError) and error.strerror:
        if error.filename or _output_fails():
            return complain(f"{error.filename or 'standard output'}: {error.strerror}", FAILED)
        return complain(f"this machine refuses: {error.strerror}; {_details(error)}", FAILED)
    if isinstance(error, MemoryError):
        return complain("there is not enough memory for this", FAILED)
    return complain(f"an error of Covey's own: {type(error).__name__}: {error}; {_details(error)}", FAILED)


@contextlib.contextmanager
def writing(option: str, path: Path) -> Iterator[None]:
    """Raise BadSetting naming the option whose place cannot be written to."""
    from protocol.settings import BadSetting  # loads numpy

    try:
        yield
    except OSError as error:
        raise BadSetting(f"{option} {path}: {error.strerror or error}; should be a place that can be written to") from None


def complain(text: str, code: int) -> int:
    """One line on standard error, where that can be written."""
    with contextlib.suppress(OSError):
        print(f"covey: {' '.join(text.split())}", file=sys.stderr, flush=True)
    return code


def tell_remarks(lines: Sequence[str]) -> None:
    """Some of the lines of data that were left out, on standard error."""
    for line in lines[:MOST_REMARKS]:
        complain(line, OK)
    if len(lines) > MOST_REMARKS:
        complain(f"and {len(lines) - MOST_REMARKS} more; `covey check` names all", OK)


def _details(error: Exception) -> str:
    """Keep the traceback in a file, and say where."""
    try:
        descriptor, name = tempfile.mkstemp(prefix=f"covey-error-{time.strftime('%H%M%S')}-", suffix=".txt")
        with os.fdopen(descriptor, "w", encoding="utf-8", errors="backslashreplace") as out:
            out.write(f"{' '.join(sys.argv)}\n\n")
            traceback.print_exception(error, file=out)
        return f"details are in {Path(name)}"
    except OSError:
        return "COVEY_DEBUG=1 shows where"


def _output_fails() -> bool:
    """Whether standard output takes nothing more; then it leads nowhere from here on."""
    try:
        sys.stdout.flush()
        os.write(1, b"\n")  # a flush may succeed after one that has failed
    except OSError:
        lead_nowhere()
        return True
    return False


def lead_nowhere(number: int = 1) -> None:
    """Point standard output, or error (2), at the null device, so that the flush at the end of the process succeeds."""
    with contextlib.suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, number)
        os.close(nowhere)
