"""Key expressions: built and parsed back, and matched as Zenoh matches them."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.keys import (
    Key,
    Token,
    all_of,
    all_tokens,
    beacons_in,
    is_of_tokens,
    matches,
    message_key,
    one_of,
    order,
    parse_message_key,
    parse_token,
    token_key,
    tokens_of,
)
from protocol.messages import KINDS, Beacon, Command, Halt, Hello, Observation
from protocol.observer_messages import Truth

names = st.from_regex(r"\A[A-Za-z0-9_.-]{1,64}\Z")
incarnations = st.integers(0, 2**63 - 1)


def test_every_kind_has_the_key_of_the_table() -> None:
    command = Command(sender="s3", incarnation=1, tick=0, velocity=(0.0, 0.0), turn_rate=0.0)
    observation = Observation(sender="world", incarnation=1, recipient="s3", tick=0, time=0.0, pose=(0.0, 0.0, 0.0))
    assert message_key("demo", Hello(sender="s3", incarnation=1)) == "covey/demo/hello/s3"
    assert message_key("demo", command) == "covey/demo/command/s3"
    assert message_key("demo", observation) == "covey/demo/observation/s3"
    assert message_key("demo", Truth(sender="world", incarnation=1, tick=0, time=0.0)) == "covey/demo/truth"
    assert message_key("demo", Halt(sender="operator-7", incarnation=1, held=True)) == all_of("demo", "halt") == "covey/demo/halt"
    assert parse_message_key("covey/demo/halt") == Key("demo", "halt", "")
    assert token_key("demo", "agent", "s3", 17) == "covey/demo/alive/agent/s3/17"


@given(names, st.sampled_from(sorted(set(KINDS) - {"truth", "halt", "beacon"})), names)
def test_a_message_key_parses_back_and_lies_in_its_expressions(run: str, kind: str, name: str) -> None:
    text = one_of(run, kind, name)
    assert parse_message_key(text) == Key(run, kind, name)
    assert matches(text, text)
    assert matches(all_of(run, kind), text)
    assert not matches(all_tokens(run), text)
    assert parse_token(text) is None


@given(names, st.integers(0, 9_999_999), st.integers(0, 9_999_999), names)
def test_the_key_of_a_beacon_tells_its_tile(run: str, column: int, row: int, name: str) -> None:
    where = {"position": (0.0, 0.0), "cod": (0.0, 0.0), "power_radius": 0.0, "reach": 1.0, "column": column, "row": row}
    beacon = msgspec.convert({"sender": name, "incarnation": 1, "tick": 0, **where}, Beacon)
    text = message_key(run, beacon)
    assert parse_message_key(text) == Key(run, "beacon", name, (column, row))
    for expression in (beacons_in(run, (column, row)), one_of(run, "beacon", name), all_of(run, "beacon")):
        assert matches(expression, text)
    assert not matches(beacons_in(run, (column + 1, row)), text) and not matches(all_tokens(run), text)
    assert parse_message_key(f"covey/{run}/beacon/01/0/{name}") is None and parse_message_key(f"covey/{run}/beacon/{name}") is None


@given(names, names, names, incarnations)
def test_a_token_parses_back_and_lies_in_the_expression_of_its_run_only(run: str, role: str, name: str, incarnation: int) -> None:
    text = token_key(run, role, name, incarnation)
    assert parse_token(text) == Token(run, role, name, incarnation)
    assert parse_message_key(text) is None
    assert matches(all_tokens(run), text) and matches(tokens_of(run, role, name), text)
    assert is_of_tokens(all_tokens(run)) and is_of_tokens(tokens_of(run, role, name)) and not is_of_tokens(all_of(run, "gossip"))
    assert not matches(all_tokens(run + "x"), text)


def test_truth_has_one_key_without_a_name() -> None:
    assert all_of("demo", "truth") == "covey/demo/truth"
    assert parse_message_key("covey/demo/truth") == Key("demo", "truth", "")


@pytest.mark.parametrize(
    "text", ["", "/", "covey", "covey/demo", "covey/demo/gossip", "covey/demo/gossip/s1/x", "other/demo/gossip/s1", "covey/demo/alive/s1"]
)
def test_what_is_no_message_key_parses_to_none(text: str) -> None:
    assert parse_message_key(text) is None


@pytest.mark.parametrize(
    "text",
    [
        "covey/demo/alive/agent/s1",
        "covey/demo/alive/agent/s1/",
        "covey/demo/alive/agent/s1/x",
        "covey/demo/alive/agent/s1/-1",
        "covey/demo/alive/agent/s1/007",
        "covey/demo/alive/agent/s1/٣",
        "covey/demo/alive/agent/s1/9223372036854775808",
        "covey/demo/alive/agent/s1/1/2",
        "covey/demo/alive/agent//1",
        "covey/demo/alive/agent/s1\n/1",
        "covey/demo/alive/agent/" + "s" * 65 + "/1",
        "covey/demo/dead/agent/s1/1",
        "other/demo/alive/agent/s1/1",
        "covey/demo/alive/agent/world/1",
        "covey/demo/alive/body/world/1",
    ],
)
def test_what_is_no_token_parses_to_none(text: str) -> None:
    assert parse_token(text) is None


@given(st.text(max_size=40))
def test_any_text_parses_to_something_or_none(text: str) -> None:
    key = parse_message_key(text)
    assert key is None or "/".join(("covey", *key)).rstrip("/") == text.rstrip("/")
    token = parse_token(text)
    assert token is None or token_key(*token) == text


@pytest.mark.parametrize(
    ("expression", "key", "answer"),
    [
        ("a/b", "a/b", True),
        ("a/b", "a/c", False),
        ("a/*", "a/b", True),
        ("a/*", "a", False),
        ("a/*", "a/b/c", False),
        ("*/b", "a/b", True),
        ("a/**", "a", True),
        ("a/**", "a/b/c", True),
        ("**", "a/b", True),
        ("**/c", "a/b/c", True),
        ("**/c", "c", True),
        ("a/**/c", "a/c", True),
        ("a/**/c", "a/b/b/c", True),
        ("a/**/c", "a/b", False),
        ("a/**/b/*", "a/b/b/c", True),
        ("a/**/b/*", "a/b", False),
        ("**/**", "a", True),
    ],
)
def test_one_star_is_one_part_and_two_are_any_number(expression: str, key: str, answer: bool) -> None:
    assert matches(expression, key) is answer


@given(st.lists(st.sampled_from("ab"), min_size=1, max_size=5), st.lists(st.sampled_from(["a", "b", "*", "**"]), min_size=1, max_size=5))
def test_matching_agrees_with_growing_every_double_star_by_hand(parts: list[str], pattern: list[str]) -> None:
    expanded = [[]]
    for piece in pattern:
        grown = [["*"] * number for number in range(len(parts) + 1)] if piece == "**" else [[piece]]
        expanded = [head + tail for head in expanded for tail in grown]
    expected = any(len(flat) == len(parts) and all(piece in ("*", part) for piece, part in zip(flat, parts)) for flat in expanded)
    assert matches("/".join(pattern), "/".join(parts)) is expected


def test_agents_are_ordered_as_people_count() -> None:
    assert sorted(["s10", "s2", "s1", "s21", "s3"], key=order) == ["s1", "s2", "s3", "s10", "s21"]
