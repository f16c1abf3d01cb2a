"""Where the program's own modules are: at the top of the path in a checkout, below `covey.` where a wheel put them.

Imports need nothing of this: `deploy.wheel` rewrites them when a wheel is built. It is for processes that are started by the name
of a module.
"""

import os
import sys
from pathlib import Path

PREFIX = __name__.rpartition("deploy")[0]  # "" or "covey."
ROOT = Path(__file__).resolve().parents[1 + PREFIX.count(".")]  # the folder that the modules are imported from


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
