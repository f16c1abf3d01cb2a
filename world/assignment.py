"""The assignment with the smallest sum of costs, by SciPy.

SciPy computes it in a compiled module of its own, which is loaded here without the package `scipy.optimize` around it. That package takes
half a second of CPU time to import, 25 times as long as this module, in every process that scores. Where SciPy keeps the module elsewhere,
the package is imported.
"""

import importlib.util
from collections.abc import Callable
from importlib.machinery import PathFinder
from pathlib import Path

import numpy as np
import scipy

Solver = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def solver_in(folder: Path) -> Solver:
    """`scipy.optimize.linear_sum_assignment`, from its compiled module in a folder if it is there."""
    spec = PathFinder.find_spec("_lsap", [str(folder)])
    if spec is None or spec.loader is None:
        from scipy.optimize import linear_sum_assignment

        return linear_sum_assignment  # type: ignore[no-any-return]
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.linear_sum_assignment  # type: ignore[no-any-return]


linear_sum_assignment = solver_in(Path(scipy.__file__).with_name("optimize"))  # rows and columns of a matrix of costs, as many as the fewer
