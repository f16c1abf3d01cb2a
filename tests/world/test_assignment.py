"""The assignment by SciPy's compiled module alone is that of its package, and costs no import of the package."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize

from world.assignment import linear_sum_assignment, solver_in

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_assignment_of_the_package_also_where_costs_are_equal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(100):
        costs = rng.integers(0, 4, rng.integers(0, 8, 2)).astype(float)
        found, expected = linear_sum_assignment(costs), scipy.optimize.linear_sum_assignment(costs)
        assert [one.tolist() for one in found] == [one.tolist() for one in expected]


def test_where_the_compiled_module_is_not_found_the_package_takes_its_place(tmp_path: Path) -> None:
    assert solver_in(tmp_path) is scipy.optimize.linear_sum_assignment


def test_what_scores_without_a_page_imports_neither_the_package_nor_the_web_server() -> None:
    code = "import sys, deploy.cli.simulate, deploy.cli.foreground, deploy.cli.listen, deploy.cli.recordings; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=100, check=True)
    assert "world.assignment" in done.stdout.split()
    assert not {"scipy.optimize", "aiohttp", "deploy.page.server"} & set(done.stdout.split())
