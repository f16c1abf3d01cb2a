"""What moves a body, a target or a particle has the same bits on every processor: decision 1 in docs/explanation/decisions.

A machine of another make is seldom at hand, so what would differ there is read off the source. These functions of numpy are other code
where the processor has wider instructions: transcendental ones, products that BLAS computes, and a sort that is not stable.
"""

import ast
import math
import re
from collections.abc import Iterator

import numpy as np
import pytest

from protocol.arithmetic import elementwise
from tests.test_architecture import Source, nodes, sources

TRANSCENDENTAL = re.compile("(arc|a)?(sin|cos|tan)(h|2|c)?|exp(2|m1)?|log(2|10|1p|addexp2?)?|pow(er)?|float_power|cbrt|hypot")
PRODUCTS = re.compile("dot|inner|vdot|vecdot|matmul|matvec|vecmat|tensordot|einsum|linalg|convolve|correlate|corrcoef|cov|polyfit")
SORTS = ("argsort", "argpartition", "partition")
ALLOWED = {  # a first look at limits; what it does not let through is looked at number by number
    ("protocol/fields.py", "vdot"),
    ("protocol/messages.py", "vdot"),
}
SENSORS = "deploy/interface/covey/examples/sensors.py"


def differs_by_processor(source: Source) -> Iterator[str]:
    """The operations of a file whose last bits, or order of equals, depend on the processor: line and name."""
    for node in nodes(source):
        name = ""
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            name = "@"
        elif isinstance(node, ast.keyword) and node.arg == "fastmath":
            name = "fastmath"
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "np":
            name = node.attr if TRANSCENDENTAL.fullmatch(node.attr) or PRODUCTS.fullmatch(node.attr) else ""
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            kinds = [word.value.value for word in node.keywords if word.arg == "kind" and isinstance(word.value, ast.Constant)]
            of_array = bool(PRODUCTS.fullmatch(node.func.attr)) or (node.func.attr in SORTS and not set(kinds) & {"stable", "mergesort"})
            name = node.func.attr if of_array and not _of_text(node) else ""
        if name and (source.path, name) not in ALLOWED:
            yield f"{source.path}:{getattr(node, 'lineno', 0)}: {name}"


def _of_text(call: ast.Call) -> bool:
    """Whether this is `str.partition`, whose one argument is a text."""
    return len(call.args) == 1 and isinstance(call.args[0], ast.Constant) and isinstance(call.args[0].value, str)


def test_nothing_that_moves_a_swarm_depends_on_the_processor() -> None:
    files = [source for source in sources() if source.room != "deploy" or source.path == SENSORS]
    assert len(files) > 100
    found = [line for source in files for line in differs_by_processor(source)]
    assert not found, "use + - * / sqrt in a fixed order, `total`, `elementwise`, or a stable sort:\n" + "\n".join(found)


@pytest.mark.parametrize(
    "line",
    [
        "a = b @ c",
        "a @= b",
        "a = np.exp(b)",
        "a = np.linalg.inv(b)",
        "a = b.dot(c)",
        "a = np.argsort(b)",
        "a = b.argsort()",
        "a = np.argpartition(b, 3)",
        "a = b.argsort(kind='quicksort')",
        "f = njit(fastmath=True)(g)",
    ],
)
def test_each_of_these_is_found(line: str) -> None:
    assert len(list(differs_by_processor(Source("agents/example.py", line)))) == 1


@pytest.mark.parametrize("line", ["a = math.exp(b)", "a = np.argsort(b, kind='stable')", "a = text.partition('-')", "a = np.sqrt(b)"])
def test_these_are_the_same_everywhere(line: str) -> None:
    assert not list(differs_by_processor(Source("agents/example.py", line)))


def test_a_function_is_applied_to_each_element_and_keeps_the_shape() -> None:
    angles = np.linspace(-4.0, 4.0, 12).reshape(3, 4)
    found = elementwise(math.cos, angles)
    assert found.shape == (3, 4) and found[1, 2] == math.cos(angles[1, 2])
    assert elementwise(math.atan2, np.array([1.0, -1.0]), np.array([0.0, -1.0])).tolist() == [math.pi / 2.0, -3.0 * math.pi / 4.0]
    assert elementwise(math.sin, np.empty((0, 2))).shape == (0, 2)
    assert elementwise(math.sin, angles.T)[2, 1] == math.sin(angles[1, 2])  # also where rows are not adjacent in memory
