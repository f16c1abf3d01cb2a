"""What moves a body, a target or a particle has the same bits on every processor: decision 1 in docs/explanation/decisions.

A machine of another make is seldom at hand, so what would differ there is read off the source. These functions of numpy are other code
where the processor has wider instructions: transcendental ones, powers other than squares, products that BLAS computes, and a sort that is
not stable. The source does not tell an array from a single number, so a power of single numbers is written as `math.pow`.
"""

import ast
import math
import re
from collections.abc import Iterator

import numpy as np
import pytest

from protocol.arithmetic import elementwise, exp_minus
from tests.test_architecture import Source, nodes, sources

TRANSCENDENTAL = re.compile("(arc|a)?(sin|cos|tan)(h|2|c)?|exp(2|m1)?|log(2|10|1p|addexp2?)?|pow(er)?|float_power|cbrt|hypot")
PRODUCTS = re.compile("dot|inner|vdot|vecdot|matmul|matvec|vecmat|tensordot|einsum|linalg|convolve|correlate|corrcoef|cov|polyfit")
SORTS = ("argsort", "argpartition", "partition")
ALLOWED = {  # a first look at limits; what it does not let through is looked at number by number
    ("protocol/fields.py", "vdot"),
    ("protocol/messages.py", "vdot"),
}
WITHOUT_NAMES = ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop
SENSORS = "deploy/interface/covey/examples/sensors.py"


def differs_by_processor(source: Source) -> Iterator[str]:
    """The operations of a file whose last bits, or order of equals, depend on the processor: line and name."""
    numpy_names = {alias for node in nodes(source) if isinstance(node, ast.Import) for alias in _names_of_numpy(node)}
    for node in nodes(source):
        name = ""
        if isinstance(node, ast.BinOp | ast.AugAssign):
            name = "@" if isinstance(node.op, ast.MatMult) else "**" if isinstance(node.op, ast.Pow) and not _is_exact_power(node) else ""
        elif isinstance(node, ast.keyword) and node.arg == "fastmath":
            name = "fastmath"
        elif isinstance(node, ast.Import | ast.ImportFrom):
            name = " ".join(_imported_differing(node))
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in {"np", *numpy_names}:
            name = node.attr if _is_differing(node.attr) else ""
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "pow":
            name = "pow" if len(node.args) == 2 else ""  # with three it is of integers
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            kinds = [word.value.value for word in node.keywords if word.arg == "kind" and isinstance(word.value, ast.Constant)]
            of_array = bool(PRODUCTS.fullmatch(node.func.attr)) or (node.func.attr in SORTS and not set(kinds) & {"stable", "mergesort"})
            name = node.func.attr if of_array and not _of_text(node) else ""
        if name and (source.path, name) not in ALLOWED:
            yield f"{source.path}:{getattr(node, 'lineno', 0)}: {name}"


def _is_differing(name: str) -> bool:
    """Whether what numpy calls so depends on the processor."""
    return bool(TRANSCENDENTAL.fullmatch(name) or PRODUCTS.fullmatch(name))


def _names_of_numpy(node: ast.Import) -> list[str]:
    """The names under which a file imports numpy."""
    return [each.asname or "numpy" for each in node.names if each.name == "numpy" or (each.name.startswith("numpy.") and not each.asname)]


def _imported_differing(node: ast.Import | ast.ImportFrom) -> list[str]:
    """What depends on the processor among the names that a file imports from numpy."""
    origin = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
    found = [f"{origin}{each.name}".split(".") for each in node.names]
    return [".".join(parts) for parts in found if parts[0] == "numpy" and (parts[-1] == "*" or any(map(_is_differing, parts[1:])))]


def _is_exact_power(node: ast.BinOp | ast.AugAssign) -> bool:
    """Whether a power is a square, which is a product, or has no name in it, so that it is one number."""
    exponent = node.right if isinstance(node, ast.BinOp) else node.value
    is_square = isinstance(exponent, ast.Constant) and exponent.value == 2
    return is_square or all(isinstance(part, WITHOUT_NAMES) for part in ast.walk(node))


def _of_text(call: ast.Call) -> bool:
    """Whether this is `str.partition`, whose one argument is a text."""
    return len(call.args) == 1 and isinstance(call.args[0], ast.Constant) and isinstance(call.args[0].value, str)


def test_nothing_that_moves_a_swarm_depends_on_the_processor() -> None:
    files = [source for source in sources() if source.room != "deploy" or source.path == SENSORS]
    assert len(files) > 100
    found = [line for source in files for line in differs_by_processor(source)]
    assert not found, "use + - * / sqrt in a fixed order, `total`, `elementwise`, `math.pow`, or a stable sort:\n" + "\n".join(found)


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
        "a = b ** 0.3",
        "a **= 0.5",
        "a = b ** 3",  # of an array it is the power of numpy, which is a square for 2 alone
        "a = b ** (-1.0 / 6.0)",
        "a = 2.0 ** b",
        "a = pow(b, 0.3)",
        "from numpy import exp",
        "from numpy import exp as e, sqrt",
        "from numpy import *",
        "from numpy import linalg",
        "from numpy.linalg import inv",
        "import numpy.linalg",
        "import numpy; a = numpy.exp(b)",
        "import numpy as other; a = other.exp(b)",
        "def f():\n    import numpy as other\n    return other.linalg.inv(b)",
    ],
)
def test_each_of_these_is_found(line: str) -> None:
    assert len(list(differs_by_processor(Source("agents/example.py", line)))) == 1


@pytest.mark.parametrize(
    "line",
    [
        "a = math.exp(b)",
        "a = np.argsort(b, kind='stable')",
        "a = text.partition('-')",
        "a = np.sqrt(b)",
        "a = b ** 2 + c ** 2.0",
        "a **= 2",
        "a = 2.0 ** -53 + 3.0 ** 0.5",
        "a = math.pow(b, 0.3)",
        "a = pow(b, c, 7)",  # of integers
        "from math import exp",
        "from numpy import sqrt",
        "import numpy; a = numpy.sqrt(b)",
        "import other; a = other.exp(b)",
        "f(**options)",
    ],
)
def test_these_are_the_same_everywhere(line: str) -> None:
    assert not list(differs_by_processor(Source("agents/example.py", line)))


def test_a_function_is_applied_to_each_element_and_keeps_the_shape() -> None:
    angles = np.linspace(-4.0, 4.0, 12).reshape(3, 4)
    found = elementwise(math.cos, angles)
    assert found.shape == (3, 4) and found[1, 2] == math.cos(angles[1, 2])
    assert elementwise(math.atan2, np.array([1.0, -1.0]), np.array([0.0, -1.0])).tolist() == [math.pi / 2.0, -3.0 * math.pi / 4.0]
    assert elementwise(math.sin, np.empty((0, 2))).shape == (0, 2)
    assert elementwise(math.sin, angles.T)[2, 1] == math.sin(angles[1, 2])  # also where rows are not adjacent in memory


@pytest.mark.parametrize("shapes", [((3,), (2,)), ((2,), (3,)), ((2, 3), (3, 2)), ((2,), ()), ((1, 2), (2,))])
def test_arrays_of_different_shapes_are_refused(shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    text = re.escape(f"shapes {shapes[0]} and {shapes[1]}")
    with pytest.raises(ValueError, match=text):
        elementwise(math.atan2, *map(np.ones, shapes))


def test_the_exponential_is_right_to_the_twelfth_digit() -> None:
    values = np.linspace(0.0, 18.0, 20001)  # the gate of 6 sigma is at 18
    assert np.abs(exp_minus(values) / np.exp(-values) - 1.0).max() < 2e-12
