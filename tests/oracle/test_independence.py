"""The oracle shares nothing with what it judges but the messages: it imports no room of the swarm."""

import ast
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent
MODULES = sorted(path.name for path in FOLDER.glob("*.py") if not path.name.startswith("test_") and path.name != "recorded.py")
ALLOWED = {
    "numpy",
    "scipy",
    "shapely",
    "protocol.messages",
    "protocol.observer_messages",
    "protocol.codec",
    *(f"tests.oracle.{name[:-3]}" for name in MODULES),
}


def foreign(text: str) -> list[str]:
    """Modules that a text imports and the oracle must not."""
    names: list[str] = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            whole = node.module in ("tests.oracle", "protocol")
            names += [f"{node.module}.{alias.name}" for alias in node.names] if whole else ["." * node.level + (node.module or "")]
    packages = {name: name.partition(".")[0] for name in names}
    return [name for name in names if name not in ALLOWED and packages[name] not in (ALLOWED | sys.stdlib_module_names) - {"importlib"}]


@pytest.mark.parametrize("name", MODULES)
def test_the_oracle_imports_numpy_scipy_shapely_the_standard_library_and_the_messages(name: str) -> None:
    assert foreign((FOLDER / name).read_text(encoding="utf-8")) == []


def test_the_rule_finds_offenders() -> None:
    offenders = [
        "agents.coverage.capacity",
        "world.score",
        "deploy.simulation",
        "protocol.sensing",
        "protocol.geometry",
        "tests.oracle.recorded",
        "importlib",
    ]
    assert [name for name in offenders if not foreign(f"import {name}")] == []
    for line in ("from protocol import geometry", "from tests.oracle import recorded", "from agents import phd", "from . import recorded"):
        assert foreign(line), line


def test_the_rule_looks_at_the_modules_of_the_oracle() -> None:
    assert MODULES == [
        "cells.py",
        "law.py",
        "mixture_filter.py",
        "one_tick.py",
        "paper_filter.py",
        "said.py",
        "scores.py",
        "search_goal.py",
        "wedges.py",
    ]
