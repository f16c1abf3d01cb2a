"""What is written as TOML reads back the same."""

import tomllib
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.scenario import Scenario, resolve, toml_text, toml_value

scalars = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
)
values = st.recursive(
    scalars, lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)), max_leaves=12
)


@given(st.dictionaries(st.text(max_size=8), values, max_size=5))
@settings(max_examples=40)
def test_any_plain_data_reads_back_the_same(data: dict[str, Any]) -> None:
    assert tomllib.loads(toml_text(data)) == data


@given(values)
def test_any_value_on_one_line_reads_back_the_same(value: Any) -> None:
    line = f"value = {toml_value(value)}"
    assert tomllib.loads(line) == {"value": value} and "\n" not in line


def test_a_key_that_ends_in_a_line_break_is_quoted() -> None:
    data = {"a\n": 1, "b\n": {"c\n": []}}
    assert tomllib.loads(toml_text(data)) == data


def test_none_is_left_out_and_tuples_come_back_as_lists() -> None:
    assert tomllib.loads(toml_text({"a": None, "b": (1, 2.5), "c": {"d": None}})) == {"b": [1, 2.5], "c": {}}


@pytest.mark.parametrize("name", ["convergence", "efficacy", "heterogeneity", "quick"])
def test_a_resolved_scenario_survives_its_run_toml(name: str) -> None:
    overrides = {"faults": [{"at": 1.0, "verb": "kill", "who": "30%"}]}
    scenario = resolve(name, {"run.seed": 7})
    data = {**msgspec.to_builtins(scenario), **overrides}
    assert msgspec.convert(tomllib.loads(toml_text(data)), Scenario) == msgspec.convert(data, Scenario)
