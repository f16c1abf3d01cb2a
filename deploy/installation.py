"""The installed program: its version, where its modules are, and which packages it stands on.

In a checkout the modules are at the top of the path, in a wheel below `covey.`. Imports need nothing of this: `deploy.wheel` rewrites
them when a wheel is built. Processes that are started by the name of a module need `command` and `environment`.

Studies, figures and tables need packages that take a third of the room; they are an extra and may be missing.
"""

import importlib.util
import os
import platform
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from protocol.message import WIRE_VERSION
from protocol.settings import BadSetting

VERSION = "0.1.0"
PREFIX = __name__.rpartition("deploy")[0]  # "" or "covey."
ROOT = Path(__file__).resolve().parents[1 + PREFIX.count(".")]  # the folder that the modules are imported from
STUDY_EXTRA = "study"  # of pyproject.toml
STUDY_PACKAGES = ("matplotlib", "pyarrow")
PACKAGES = ("covey", "eclipse-zenoh", "numpy", "scipy", "shapely", "msgspec", "numba")  # named in the versions of a run


def command(module: str) -> list[str]:
    """The beginning of a command line that runs a module, given by its name in a checkout."""
    return [sys.executable, "-P", "-m", PREFIX + module]  # -P: a folder `deploy` of the user's must not win


def environment() -> dict[str, str]:
    """The environment of such a process: in a checkout this one is first on the path, an installed program is found as it is."""
    if PREFIX:
        return dict(os.environ)
    ours = [str(ROOT), str(ROOT / "deploy" / "interface")]
    others = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path and path not in ours]
    return {**os.environ, "PYTHONPATH": os.pathsep.join([*ours, *others])}


def versions() -> dict[str, Any]:
    """What ran: versions of the packages, of Python and of the wire, and the kind of machine."""
    installed = {}
    for package in PACKAGES:
        try:
            installed[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            installed[package] = ""
    return {
        "wire": WIRE_VERSION,
        "python": sys.version.split()[0],
        "machine": platform.platform(),
        "cores": os.cpu_count(),
        "packages": installed,
    }


def need_study_packages(what: str) -> None:
    """Return when the packages of studies are there; else as `need_packages`."""
    need_packages(what, STUDY_PACKAGES, STUDY_EXTRA)


def need_packages(what: str, packages: tuple[str, ...], extra: str) -> None:
    """Return when the packages are there. Under the launcher of a checkout: install them and start this command again.

    Raises BadSetting naming what to install where that is not possible.
    """
    missing = [package for package in packages if not _is_there(package)]
    if not missing:
        return
    launcher = os.environ.get("COVEY_LAUNCHER")
    if launcher and extra not in os.environ.get("COVEY_EXTRAS", "").split():
        sys.stdout.flush()
        os.execve(launcher, [launcher, *sys.argv[1:]], {**os.environ, "COVEY_EXTRAS": extra})
    raise BadSetting(f"{what}: needs {' and '.join(missing)}: {how_to_install(missing, extra)}")


def how_to_install(packages: Sequence[str], extra: str) -> str:
    """What to type for packages of an extra. No index has the package covey."""
    elsewhere = f"elsewhere python -m pip install {' '.join(packages)}, or the wheel file with its extra [{extra}]"
    return f"in a checkout COVEY_EXTRAS={extra} ./covey version; {elsewhere}"


def _is_there(package: str) -> bool:
    return importlib.util.find_spec(package) is not None
