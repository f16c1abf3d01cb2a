"""Packages that only studies, figures and tables need. They are not installed with the rest: they take a third of the room."""

import importlib.util
import os
import sys

from protocol.settings import BadSetting

EXTRA = "study"  # of pyproject.toml
PACKAGES = ("matplotlib", "pyarrow")


def need(what: str) -> None:
    """Return when the packages are there. Under the launcher of a checkout: install them and start this command again.

    Raises BadSetting naming what to install where that is not possible.
    """
    missing = [package for package in PACKAGES if not _is_there(package)]
    if not missing:
        return
    launcher = os.environ.get("COVEY_LAUNCHER")
    if launcher and EXTRA not in os.environ.get("COVEY_EXTRAS", "").split():
        sys.stdout.flush()
        os.execve(launcher, [launcher, *sys.argv[1:]], {**os.environ, "COVEY_EXTRAS": EXTRA})
    raise BadSetting(f"{what}: needs {' and '.join(missing)}: python -m pip install {' '.join(missing)}, or install covey[{EXTRA}]")


def _is_there(package: str) -> bool:
    return importlib.util.find_spec(package) is not None
