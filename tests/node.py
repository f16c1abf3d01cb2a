"""Modules of the page in Node: a statement's value, for tests without a browser."""

import json
import re
import shutil
import subprocess
from typing import Any

import pytest

from deploy.page.server import STATIC

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="there is no Node on this machine: apt-get install nodejs")
IMPORT = re.compile(r"^import .*? from \"\./(\w+)\.js\";$", re.MULTILINE)


def node(statement: str, data: object, *modules: str) -> Any:
    """What a statement gives with the modules at hand (`colouring` for colouring.js), and with `data`."""
    assert NODE is not None
    program = f"{_joined(modules)}\nconst data = {json.dumps(data)};\nconsole.log(JSON.stringify({statement}));"
    done = subprocess.run([NODE, "--input-type=module", "-"], input=program, capture_output=True, text=True, timeout=60, check=True)
    return json.loads(done.stdout)


def _joined(modules: tuple[str, ...]) -> str:
    """The text of some modules and of all that they import, each once, as one module."""
    texts: dict[str, str] = {}

    def add(name: str) -> None:
        if name in texts:
            return
        text = (STATIC / f"{name}.js").read_text(encoding="utf-8")
        texts[name] = ""  # against circles
        for other in IMPORT.findall(text):
            add(other)
        del texts[name]
        texts[name] = IMPORT.sub("", text)

    for module in modules:
        add(module)
    return "\n".join(texts.values())
