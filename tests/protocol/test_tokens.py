"""A node is told of a token once when it appears and once when it vanishes, also across two sessions."""

import pytest

from protocol.keys import Token, token_key
from protocol.node import Alive, Gone
from protocol.tokens import MOST_TOKENS, Tokens

OWN = Token("t", "agent", "s1", 1)
ALL = ["covey/t/alive/**"]
S2 = "covey/t/alive/agent/s2/*"


def key(name: str, incarnation: int = 1) -> str:
    return token_key("t", "agent", name, incarnation)


def test_each_change_is_told_once_and_the_own_token_never() -> None:
    tokens = Tokens(OWN, ALL)
    assert tokens.see(key("s2"), False) is None
    assert tokens.see(key("s2"), True) == Alive("agent", "s2", 1)
    assert tokens.see(key("s2"), True) is None
    assert tokens.see(key("s2", 2), True) == Alive("agent", "s2", 2)
    assert tokens.see(key("s2"), False) == Gone("agent", "s2", 1)
    assert tokens.see(key("s2"), False) is None
    assert tokens.see(key("s1"), True) is None
    assert tokens.see("covey/t/alive/agent/s2/x", True) is None


def test_what_a_new_session_does_not_see_again_is_lost_and_what_it_sees_again_is_not_told_twice() -> None:
    tokens = Tokens(OWN, ALL)
    for name in ("s2", "s3", "s4"):
        tokens.see(key(name), True)
    assert tokens.take_lost() == []
    tokens.doubt()
    assert tokens.see(key("s3"), True) is None
    assert tokens.see(key("s4"), False) == Gone("agent", "s4", 1)
    assert tokens.take_lost() == [Gone("agent", "s2", 1)]
    assert tokens.see(key("s2"), True) == Alive("agent", "s2", 1)
    assert tokens.take_lost() == []


def test_forgotten_tokens_are_told_again_once_they_are_followed_again() -> None:
    tokens = Tokens(OWN, ["covey/t/alive/agent/s3/*"])
    tokens.follow(S2)
    tokens.see(key("s2"), True)
    tokens.see(key("s3"), True)
    tokens.forget(S2)
    assert tokens.see(key("s2"), True) is None, "what comes after the end of a subscription"
    tokens.follow(S2)
    assert tokens.see(key("s2"), True) == Alive("agent", "s2", 1)
    assert tokens.see(key("s3"), True) is None


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
    told = [tokens.see(key(f"x{number}"), True) for number in range(MOST_TOKENS + 10)]
    assert None not in told[:MOST_TOKENS] and told[MOST_TOKENS:] == [None] * 10
    assert tokens.see(key(f"x{MOST_TOKENS}"), False) is None
    assert tokens.see(key("x0"), False) == Gone("agent", "x0", 1)
    assert tokens.see(key("s2"), True) == Alive("agent", "s2", 1)
