"""A node is told of a token once when it appears and once when it vanishes, also across two sessions."""

from collections import Counter

import pytest

from protocol import codec
from protocol.inbox import Arrival
from protocol.keys import Token, token_key
from protocol.liveliness_tokens import MOST_TOKENS, Tokens
from protocol.messages import Hello
from protocol.node import Alive, Gone
from protocol.reception import Reception

OWN = Token("t", "agent", "s1", 1)
ALL = ["covey/t/alive/**"]
S2 = "covey/t/alive/agent/s2/*"


def key(name: str, incarnation: int = 1) -> str:
    return token_key("t", "agent", name, incarnation)


def test_each_change_is_told_once_and_the_own_token_never() -> None:
    tokens = Tokens(OWN, ALL)
    assert tokens.see(key("s2"), False) == []
    assert tokens.see(key("s2"), True) == [Alive("agent", "s2", 1)]
    assert tokens.see(key("s2"), True) == []
    assert tokens.see(key("s2", 2), True) == [Alive("agent", "s2", 2)]
    assert tokens.see(key("s2"), False) == [Gone("agent", "s2", 1)]
    assert tokens.see(key("s2"), False) == []
    assert tokens.see(key("s1"), True) == []
    assert tokens.see("covey/t/alive/agent/s2/x", True) == []


def test_what_a_new_session_does_not_see_again_is_lost_and_what_it_sees_again_is_not_told_twice() -> None:
    tokens = Tokens(OWN, ALL)
    for name in ("s2", "s3", "s4"):
        tokens.see(key(name), True)
    assert tokens.take_lost() == []
    tokens.doubt()
    assert tokens.see(key("s3"), True) == []
    assert tokens.see(key("s4"), False) == [Gone("agent", "s4", 1)]
    assert tokens.take_lost() == [Gone("agent", "s2", 1)]
    assert tokens.see(key("s2"), True) == [Alive("agent", "s2", 1)]
    assert tokens.take_lost() == []


def test_forgotten_tokens_are_told_again_once_they_are_followed_again() -> None:
    tokens = Tokens(OWN, ["covey/t/alive/agent/s3/*"])
    tokens.follow(S2)
    tokens.see(key("s2"), True)
    tokens.see(key("s3"), True)
    tokens.forget(S2)
    assert tokens.see(key("s2"), True) == [], "what comes after the end of a subscription"
    tokens.follow(S2)
    assert tokens.see(key("s2"), True) == [Alive("agent", "s2", 1)]
    assert tokens.see(key("s3"), True) == []


def test_who_meets_nobody_is_told_where_to_look(caplog: pytest.LogCaptureFixture) -> None:
    tokens = Tokens(OWN, ALL)
    tokens.warn_if_alone(())
    assert caplog.text == "", "who dials nobody expects nobody"
    tokens.warn_if_alone(("tls/10.0.0.1:7447",))
    assert "does anybody listen at tls/10.0.0.1:7447, in run t?" in caplog.text and "of the same authority" in caplog.text
    caplog.clear()
    tokens.see(key("s2"), True)
    tokens.warn_if_alone(("tls/10.0.0.1:7447",))
    assert caplog.text == ""


def test_of_any_number_of_tokens_a_fixed_number_is_kept_and_the_place_of_one_that_goes_is_free() -> None:
    tokens = Tokens(OWN, ALL)
    for number in range(MOST_TOKENS):
        assert tokens.see(key(f"x{number}"), True) == [Alive("agent", f"x{number}", 1)]
        tokens.hear(f"x{number}")
    assert tokens.see(key("s2"), True) == [], "all others have spoken"
    assert tokens.see(key("s2"), False) == []
    assert tokens.see(key("x0"), False) == [Gone("agent", "x0", 1)]
    assert tokens.see(key("s2"), True) == [Alive("agent", "s2", 1)]


def test_of_too_many_tokens_those_of_the_earliest_silent_name_give_way() -> None:
    tokens = Tokens(OWN, ALL)
    tokens.see(key("s2"), True)
    tokens.see(token_key("t", "body", "x0", 7), True)
    for number in range(MOST_TOKENS - 2):
        tokens.see(key(f"x{number}"), True)
    tokens.hear("s2")
    assert tokens.see(key("s3"), True) == [Gone("body", "x0", 7), Gone("agent", "x0", 1), Alive("agent", "s3", 1)]
    assert tokens.see(key("s4"), True) == [Alive("agent", "s4", 1)], "two have gone"
    assert tokens.see(key("s5"), True) == [Gone("agent", "x1", 1), Alive("agent", "s5", 1)]
    assert tokens.see(key("x1"), False) == [], "told already"
    tokens.doubt()
    assert tokens.see(key("s6"), True) == [Gone("agent", "x2", 1), Alive("agent", "s6", 1)]
    lost = tokens.take_lost()
    assert Gone("agent", "s2", 1) in lost and Gone("agent", "x3", 1) in lost and Gone("agent", "x2", 1) not in lost


def test_a_name_that_speaks_keeps_its_token_among_any_number_of_made_up_ones() -> None:
    """From arrivals on: thousands of tokens after that of s2, which has said one Hello, and then that of s3."""
    said = Hello(sender="s2", incarnation=1)
    reception = Reception(Tokens(OWN, ALL), Counter())
    honest = [Arrival(key("s2"), token=True), Arrival("covey/t/hello/s2", codec.encode(said))]
    made_up = [Arrival(key(f"x{number}"), token=True) for number in range(2 * MOST_TOKENS)]
    events = [*reception.events([*honest, *made_up, Arrival(key("s3"), token=True)], 0.0)]
    assert events[0] == Alive("agent", "s2", 1) and events[-1] == Alive("agent", "s3", 1)
    assert Gone("agent", "s2", 1) not in events
    up = sum(isinstance(event, Alive) for event in events) - sum(isinstance(event, Gone) for event in events)
    assert up == MOST_TOKENS
