"""How a wheel is built: the rooms go below one package, `covey`, and their imports are rewritten to say so.

At the top of site-packages a folder `agents` belongs to another well-known package. In the checkout the rooms are top-level packages,
and their imports say so: `from agents.tracking.phd import ...` is `from covey.agents.tracking.phd import ...` in a wheel. Only import
statements change, and no line moves. setuptools loads this file when it builds (pyproject.toml, tool.setuptools.cmdclass).
"""

import ast
from typing import TYPE_CHECKING, Any

try:
    from setuptools.command.build_py import build_py
    from setuptools.errors import SetupError
except ImportError:  # an environment that builds nothing has no setuptools
    if not TYPE_CHECKING:
        build_py, SetupError = object, ValueError

ROOMS = ("protocol", "agents", "world", "deploy")


def rewritten(text: str) -> str:
    """The source of a module with all imports of rooms below `covey`; raises ValueError for one that would bind another name then."""
    lines = text.encode().splitlines(keepends=True)  # columns of the syntax tree count bytes
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and not node.level and _is_room(node.module or ""):
            line, start = lines[node.lineno - 1], node.col_offset + len("from ")
            lines[node.lineno - 1] = line[:start] + b"covey." + line[start:]
        elif isinstance(node, ast.Import) and any(_is_room(alias.name) for alias in node.names):
            raise ValueError(f"line {node.lineno}: should read `from {node.names[0].name.rpartition('.')[0] or 'ROOM'} import ...`")
    return b"".join(lines).decode()


def _is_room(module: str) -> bool:
    return module.partition(".")[0] in ROOMS


class BuildPy(build_py):
    """setuptools' step that copies modules, with the imports of each rewritten."""

    def run(self) -> None:
        """Copy all modules and data; an installation in place would run sources whose imports are not rewritten."""
        if self.editable_mode:
            raise SetupError("Covey is not installed in place: run ./covey of the checkout, or install without -e")
        super().run()

    def build_module(self, module: Any, module_file: str, package: str) -> Any:
        """Copy one module, rewritten."""
        target, copied = super().build_module(module, module_file, package)
        with open(target, encoding="utf-8", newline="") as file:
            text = file.read()
        try:
            text = rewritten(text)
        except ValueError as error:
            raise SetupError(f"{module_file}: {error}") from error
        with open(target, "w", encoding="utf-8", newline="") as file:
            file.write(text)
        return target, copied
