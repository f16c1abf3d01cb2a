"""The notebook of docs/ gives the outputs that it keeps."""

import json
from pathlib import Path

import pytest

from tests.notebook import code_cells, run_cells, without_pictures

PATH = Path(__file__).resolve().parents[1] / "docs" / "tutorial" / "notebook.ipynb"


@pytest.mark.slow
def test_every_cell_of_the_notebook_gives_the_output_that_it_keeps() -> None:
    cells = code_cells(json.loads(PATH.read_text(encoding="utf-8")))
    outputs = run_cells(cells)
    for number, (cell, found) in enumerate(zip(cells, outputs), start=1):
        assert without_pictures(found) == without_pictures(cell["outputs"]), (
            f"cell {number}: python -m tests.notebook docs/tutorial/notebook.ipynb"
        )
    assert any("image/png" in output.get("data", {}) for found in outputs for output in found)
    assert len(outputs) == len(cells) >= 5
