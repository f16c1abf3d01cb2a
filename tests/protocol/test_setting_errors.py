"""All mistakes of a settings file at once; what is left when they are taken out is right."""

from typing import Annotated, Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.setting_errors import MOST_MISTAKES, mistakes
from protocol.settings import CommonSettings, NetworkSettings, RunSettings, Section


class Fault(Section, frozen=True, kw_only=True):
    """An item of a list with a field that must be there."""

    at: float
    verb: str = "kill"


class Run(RunSettings, frozen=True, kw_only=True):
    """[run] with a whole number in it."""

    seed: Annotated[int, msgspec.Meta(ge=0)] = 1


class Whole(CommonSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All sections of these tests."""

    run: Run = Run()
    faults: tuple[Fault, ...] = ()


NAMES = "should be 1 to 64 letters, digits, or any of _ . -"
TEXT = "should be a text, got a whole number"


@pytest.mark.parametrize(
    ("data", "lines"),
    [
        ({}, []),
        ({"run": {"seed": 3}}, []),
        (
            {"run": {"seed": -1, "dt": "x"}},
            ["run.seed = -1: should be a whole number >= 0", "run.dt = 'x': should be a number, got a text"],
        ),
        (
            {"run": {"sead": 1}, "rum": 3},
            ["run.sead: there is no such field; did you mean seed?", "rum: there is no such field; did you mean run?"],
        ),
        ({"run": 5}, ["run = 5: should be a table, got a whole number"]),
        (
            {"faults": [{}, {"at": "soon"}, {"at": 1, "who": 2}]},
            [
                "faults[0] = {}: the field at is missing",
                "faults[1].at = 'soon': should be a number, got a text",
                "faults[2].who: there is no such field; known are at, verb",
            ],
        ),
        ({"faults": [3, {"at": 1}]}, ["faults[0] = 3: should be a table, got a whole number"]),
        (
            {"members": {"a b": "A", "c d": "A", "ok": 3}},
            [f"members = 'a b': {NAMES}", f"members = 'c d': {NAMES}", f"members.ok = 3: {TEXT}"],
        ),
        ({"members": {"0": 3}}, [f"members.0 = 3: {TEXT}"]),  # a name; numbers in lists stand in brackets
        ({"network": {"listen": [1, "tcp/x", 2]}}, [f"network.listen[0] = 1: {TEXT}", f"network.listen[2] = 2: {TEXT}"]),
    ],
)
def test_every_mistake_is_told_once(data: dict[str, Any], lines: list[str]) -> None:
    found, paths, rest = mistakes(data, Whole)
    assert sorted(found) == sorted(lines) and len(paths) == len(lines)
    msgspec.convert(rest, Whole)


def test_of_very_many_mistakes_the_first_are_told() -> None:
    found, _, _ = mistakes({"run": {f"x{number}": 1 for number in range(3 * MOST_MISTAKES)}}, Whole)
    assert len(found) == MOST_MISTAKES + 1 and found[-1] == "and more"


scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
words = st.text(max_size=5)
plain = st.recursive(scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3), max_leaves=6)
sections = ["run", "network", "faults", "members", "sensors", "arena"]
names = st.sampled_from([*sections, *RunSettings.__struct_fields__, *NetworkSettings.__struct_fields__])


@given(st.dictionaries(names, st.dictionaries(names, plain, max_size=4) | plain, max_size=4))
def test_whatever_a_file_says_it_comes_to_an_end_and_what_is_left_is_right(data: dict[str, Any]) -> None:
    found, _, rest = mistakes(data, Whole)
    assert "and more" not in found
    msgspec.convert(rest, Whole)
    assert bool(found) or repr(rest) == repr(data), "nothing is changed where nothing is wrong"
