"""A notebook is run cell by cell in this process, and its outputs are compared with those that it keeps.

python -m tests.notebook docs/tutorial/notebook.ipynb    runs it and keeps the outputs
"""

import ast
import base64
import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any

Output = dict[str, Any]


def run_cells(cells: list[dict[str, Any]]) -> list[list[Output]]:
    """The outputs of the code cells, in order: printed text, figures, and the value of the last line."""
    import matplotlib

    matplotlib.use("Agg")
    names: dict[str, Any] = {"__name__": "__notebook__"}
    return [run_cell("".join(cell["source"]), names, number) for number, cell in enumerate(cells, start=1)]


def run_cell(source: str, names: dict[str, Any], number: int) -> list[Output]:
    """The outputs of one cell."""
    import matplotlib.pyplot as plt

    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, f"cell {number}", "exec"), names)
        value = eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), names) if last else None  # type: ignore[attr-defined]
    outputs: list[Output] = []
    if printed.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(keepends=True)})
    for figure in map(plt.figure, plt.get_fignums()):
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=70)
        plt.close(figure)
        data = {"image/png": base64.b64encode(picture.getvalue()).decode() + "\n", "text/plain": ["a figure"]}
        outputs.append({"output_type": "display_data", "metadata": {}, "data": data})
    if value is not None:
        data = {"text/plain": repr(value).splitlines(keepends=True)}
        outputs.append({"output_type": "execute_result", "execution_count": number, "metadata": {}, "data": data})
    return outputs


def code_cells(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    """Those that are run."""
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def without_pictures(outputs: list[Output]) -> list[Output]:
    """The outputs with every picture named and not shown: its bytes depend on the version of matplotlib."""
    shown = []
    for output in outputs:
        data = output.get("data", {})
        shown.append({**output, "data": {**data, "image/png": ""}} if "image/png" in data else output)
    return shown


def keep(path: Path) -> None:
    """Run a notebook and write its outputs into it."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    cells = code_cells(notebook)
    for number, (cell, outputs) in enumerate(zip(cells, run_cells(cells)), start=1):
        cell.update(outputs=outputs, execution_count=number)
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    keep(Path(sys.argv[1]))
