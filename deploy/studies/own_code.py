"""The user's own code: the files of the classes that a scenario names, of all that these import, and of data that sensors are given.

Files of Covey, of the standard library and of installed packages do not count: the versions of a study name those.
"""

import ast
import hashlib
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec, resolve_name
from os.path import isfile
from pathlib import Path

from deploy.scenario import Scenario, user_classes
from protocol.settings import load_named
from protocol.user_classes import NOT_THE_USERS


def own_code(scenario: Scenario) -> str:
    """A hash of `own_files`; empty where there are none."""
    digest, files = hashlib.blake2b(digest_size=6), own_files(scenario)
    for file in files:
        digest.update(hashlib.blake2b(file.read_bytes()).digest())
    return digest.hexdigest() if files else ""


def own_files(scenario: Scenario) -> list[Path]:
    """The files of the user's modules that define the classes of a scenario, of all that these import, and in `parameters` of sensors.

    A file in `parameters` is looked for from the current folder.
    """
    given = [value for sensor in scenario.sensors.values() for value in sensor.parameters.values()]
    found = {Path(value) for value in given if isinstance(value, str) and isfile(value)}
    waiting: list[tuple[Path, str]] = []  # a file, and the package that it belongs to
    for name in user_classes(scenario):
        with suppress(ValueError, ImportError):  # a class that cannot be loaded is refused where the run builds it
            named = {name.partition(":")[0], getattr(load_named(name), "__module__", "")}
            modules = [sys.modules[module] for module in named if module in sys.modules]
            waiting += [(Path(file), module.__package__ or "") for module in modules if (file := getattr(module, "__file__", None))]
    while waiting:
        file, package = waiting.pop()
        if file not in found:
            found.add(file)
            waiting += [entry for name in _imported(file.read_bytes(), package) for entry in _module_files(name)]
    return sorted(found)


@lru_cache(maxsize=256)
def _imported(source: bytes, package: str) -> list[str]:
    """Dotted names of what a file of a package imports, anywhere in it; of `from a import b` a and a.b, which may be a module."""
    names: list[str] = []
    with suppress(SyntaxError, ValueError, ImportError):  # no Python, such as a compiled module
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                names += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                module = resolve_name("." * node.level + (node.module or ""), package)
                names += [module, *(f"{module}.{alias.name}" for alias in node.names)]
    return names


def _module_files(module: str) -> Iterator[tuple[Path, str]]:
    """The files of a user's module and of the packages around it, each with its package. Nothing is imported."""
    folders: list[str] | None = None
    for number in range(1, module.count(".") + 2):
        name = ".".join(module.split(".")[:number])
        spec: ModuleSpec | None = None
        with suppress(ValueError, ImportError):  # as for __main__
            spec = find_spec(name) if number == 1 else PathFinder.find_spec(name, folders)
        if spec is None or spec.origin in ("built-in", "frozen") or (spec.origin or "").startswith(NOT_THE_USERS):
            return
        if spec.origin:  # a folder without __init__.py has none
            yield Path(spec.origin), spec.parent or ""
        if spec.submodule_search_locations is None:
            return
        folders = list(spec.submodule_search_locations)
