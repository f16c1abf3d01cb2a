"""Classes of the user's own: a right answer is handed through as it is, a wrong one is told with the name of the class."""

import copy
import math
from typing import Any

import numpy as np
import pytest

from protocol.sensing import SENSOR_CLASSES, SensorModel
from protocol.settings import BadSetting, CommonSettings, SensorSettings, sensor_of
from protocol.user_classes import CheckedSensor, as_bad_setting, probe, real_array

WEDGE = SENSOR_CLASSES["A"]
POINTS = np.array([[1.0, 0.0], [-7.0, 3.0]])


def test_right_answers_are_the_very_arrays_of_the_class_and_everything_else_is_handed_through() -> None:
    checked = CheckedSensor(WEDGE, "mine:Wedge")
    assert isinstance(checked, SensorModel)
    assert (checked.reach, checked.area, checked.prob_detection) == (8.0, WEDGE.area, 0.99)
    np.testing.assert_array_equal(checked.probability(POINTS, (0.0, 0.0, 0.0)), WEDGE.probability(POINTS, (0.0, 0.0, 0.0)))
    probe(checked, "mine:Wedge")
    with pytest.raises(AttributeError):
        _ = checked.no_such_part
    assert copy.copy(checked).reach == 8.0


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (None, "returned None: should be an array of shape (2,)"),
        ([0.1, 0.2], "returned [0.1, 0.2]: should be an array"),
        (np.zeros(3), "shape (3,) and type float64"),
        (np.zeros((2, 1)), "shape (2, 1) and type float64"),
        (np.zeros(2, dtype=complex), "type complex128"),
        (np.array(["a", "b"]), "type <U1"),
        (np.array([0.0, np.inf]), "with inf in it"),
        ("x" * 200, "... (str): should be an array"),
    ],
)  # fmt: skip
def test_what_is_no_array_of_that_shape_is_told_in_one_short_line(value: Any, told: str) -> None:
    with pytest.raises(BadSetting) as caught:
        real_array("mine:Camera.probability", value, (2,))
    text = str(caught.value)
    assert text.startswith("mine:Camera.probability returned ") and told in text
    assert len(text) < 200 and "\n" not in text


def test_an_exception_inside_is_the_cause_and_a_bad_setting_passes() -> None:
    with (
        pytest.raises(BadSetting, match=r"mine:Law\.command raised ZeroDivisionError: division by zero") as caught,
        as_bad_setting("mine:Law.command"),
    ):
        _ = 1 / 0
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    with pytest.raises(BadSetting, match=r"^as it is$"), as_bad_setting("mine:Law.command"):
        raise BadSetting("as it is")


def test_an_error_without_a_line_of_the_users_names_no_line() -> None:
    """Python raises it in the line of Covey that calls the class."""

    class Blind:
        def probability(self) -> None: ...

    with pytest.raises(BadSetting, match=r"raised TypeError: .* takes 1 positional argument but 3 were given$"):
        CheckedSensor(Blind(), "mine:Blind").probability(POINTS, (0.0, 0.0, 0.0))  # type: ignore[arg-type]


def test_an_error_inside_numpy_names_the_line_of_the_users_that_called_it() -> None:
    """Its compiled parts have names without a folder."""
    with (
        pytest.raises(BadSetting, match=r"raised ValueError: unrecognized seed string \(test_user_classes\.py, line \d+\)$"),
        as_bad_setting("x"),
    ):
        np.random.default_rng([1, "s1"])  # type: ignore[list-item]


@pytest.mark.parametrize("area", [0.0, 2e13, math.inf, math.nan])
def test_an_area_that_cannot_be_is_told_with_the_largest(area: float) -> None:
    class Wide:
        pass

    Wide.area = area  # type: ignore[attr-defined]
    with pytest.raises(BadSetting, match=r"^mine:Wide\.area = .*: should be a number > 0 and at most 1e\+13$"):
        _ = CheckedSensor(Wide(), "mine:Wide").area  # type: ignore[arg-type]


class Broken:
    """A sensor that cannot be built."""

    tries = 0

    def __init__(self) -> None:
        Broken.tries += 1
        raise OSError("no camera")


def test_why_a_class_cannot_be_built_is_found_once_and_told_each_time() -> None:
    """Each Hello with its name asks for it."""
    settings = CommonSettings(sensors={"X": SensorSettings(model=f"{__name__}:Broken")})
    for _ in range(3):
        with pytest.raises(BadSetting, match=r"^sensors\.X: .*:Broken raised OSError: no camera") as caught:
            sensor_of(settings, "X")
        assert isinstance(caught.value.__cause__, OSError)
    assert Broken.tries == 1
