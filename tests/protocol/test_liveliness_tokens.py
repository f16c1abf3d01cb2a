"""A node is told of a token once when it appears and once when it vanishes, also across two sessions."""

from collections import Counter

import pytest

from protocol import codec
from protocol.arrival_queue import Arrival
from protocol.keys import Token, token_key
from protocol.liveliness_tokens import MOST_INCARNATIONS, MOST_NAMES, Tokens
from protocol.messages import Hello
from protocol.node import Alive, Gone, Received
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
    tokens.suspect_all()
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


def full(*, spoken: bool) -> Tokens:
    """Tokens with as many names as a node is shown, x0 first."""
    tokens = Tokens(OWN, ALL)
    for number in range(MOST_NAMES):
        assert tokens.see(key(f"x{number}"), True) == [Alive("agent", f"x{number}", 1)]
        if spoken:
            assert not tokens.hear(f"x{number}")
    return tokens


def test_of_any_number_of_names_a_fixed_number_is_shown_and_the_place_of_one_that_goes_is_free() -> None:
    tokens = full(spoken=True)
    assert tokens.see(key("s2"), True) == [] and not tokens.hear("s2"), "all others have spoken"
    assert tokens.see(key("x0"), False) == [Gone("agent", "x0", 1)]
    assert tokens.hear("s2") == [Alive("agent", "s2", 1)]
    assert tokens.see(key("x0"), True) == [] and not tokens.hear("x0")
    assert tokens.see(key("s2"), False) == [Gone("agent", "s2", 1)]
    assert tokens.see(key("s3"), True) == [Alive("agent", "s3", 1)]


def test_a_waiting_name_that_speaks_is_shown_in_place_of_the_earliest_silent_one() -> None:
    tokens = full(spoken=False)
    tokens.hear("x0")
    assert tokens.see(key("x1", 5), True) == [Alive("agent", "x1", 5)], "one more of a name that is shown"
    assert tokens.see(key("s2", 2), True) == tokens.see(key("s2"), True) == tokens.see(token_key("t", "body", "s2", 1), True) == []
    ours = [("agent", "s2", 2), ("agent", "s2", 1), ("body", "s2", 1)]
    hidden = [Gone("agent", "x1", 1), Gone("agent", "x1", 5)]
    assert tokens.hear("s2") == [*hidden, *(Alive(*each) for each in ours)]
    assert not tokens.hear("s2"), "told already"
    assert tokens.see(key("x1"), False) == [], "told already"
    assert tokens.hear("x1") == [Gone("agent", "x2", 1), Alive("agent", "x1", 5)]


def test_a_name_that_has_gone_gives_its_place_away_once() -> None:
    tokens = full(spoken=False)
    tokens.see(key("x0"), False)
    assert tokens.see(key("s2"), True) == [Alive("agent", "s2", 1)] and tokens.see(key("s3"), True) == []
    assert tokens.hear("s3") == [Gone("agent", "x1", 1), Alive("agent", "s3", 1)]


def test_a_waiting_token_that_vanishes_is_forgotten_untold() -> None:
    tokens = full(spoken=False)
    tokens.see(key("s2"), True)
    assert tokens.see(key("s2"), False) == [] and not tokens.hear("s2")
    tokens.see(key("s3"), True)
    tokens.see(key("s4"), True)
    tokens.suspect_all()
    assert tokens.see(key("s4"), True) == tokens.see(key("x0"), True) == []
    assert tokens.take_lost() == [Gone("agent", name, 1) for name in sorted(f"x{number}" for number in range(1, MOST_NAMES))]
    assert not tokens.hear("s3") and tokens.hear("s4") == [Alive("agent", "s4", 1)]


def test_a_waiting_token_that_nobody_follows_any_more_is_forgotten() -> None:
    tokens = full(spoken=False)
    tokens.follow(S2)
    tokens.see(key("s2"), True)
    tokens.forget(S2)
    assert not tokens.hear("s2")


def test_as_many_names_wait_as_are_shown_and_the_earliest_is_forgotten() -> None:
    tokens = full(spoken=False)
    for number in range(MOST_NAMES + 1):
        assert tokens.see(key(f"y{number}"), True) == []
    assert not tokens.hear("y0")
    assert tokens.hear("y1") == [Gone("agent", "x0", 1), Alive("agent", "y1", 1)]


def test_of_many_incarnations_of_a_name_the_largest_are_kept() -> None:
    """Restarts whose old tokens are still up are told of one after the other, and each older one as gone before its eighth successor."""
    tokens = Tokens(OWN, ALL)
    for incarnation in range(11, 11 + MOST_INCARNATIONS):
        assert tokens.see(key("s2", incarnation), True) == [Alive("agent", "s2", incarnation)]
    assert tokens.see(key("s2", 10), True) == tokens.see(key("s2", 10), False) == []
    assert tokens.see(key("s2", 30), True) == [Gone("agent", "s2", 11), Alive("agent", "s2", 30)]
    assert tokens.see(token_key("t", "body", "s2", 1), True) == [Alive("body", "s2", 1)], "another role"
    assert tokens.see(key("s2", 11), False) == [], "told already"
    tokens.suspect_all()
    assert tokens.see(key("s2", 31), True) == [Gone("agent", "s2", 12), Alive("agent", "s2", 31)]
    assert tokens.take_lost() == [*(Gone("agent", "s2", each) for each in (13, 14, 15, 16, 17, 18, 30)), Gone("body", "s2", 1)]


def test_a_name_that_speaks_keeps_its_token_among_any_number_of_made_up_ones() -> None:
    """From arrivals on: thousands of tokens after that of s2, which has said one Hello, and then that of s3, which says one."""
    honest = [Arrival(key("s2"), token=True), said("s2")]
    flood = made_up(2 * MOST_NAMES)
    arrivals = [*honest, *flood, Arrival(key("s3"), token=True), said("s3")]
    events = [*Reception(Tokens(OWN, ALL), Counter()).events(arrivals, 0.0)]
    assert events[0] == Alive("agent", "s2", 1) and events[-2] == Alive("agent", "s3", 1) and isinstance(events[-1], Received)
    assert Gone("agent", "s2", 1) not in events
    up = sum(isinstance(event, Alive) for event in events) - sum(isinstance(event, Gone) for event in events)
    assert up == MOST_NAMES


def said(name: str) -> Arrival:
    return Arrival(f"covey/t/hello/{name}", codec.encode(Hello(sender=name, incarnation=1)))


def up_after(reception: Reception, arrivals: list[Arrival]) -> set[tuple[str, str, int]]:
    """The tokens that a node knows to be up after these arrivals; each is told once when it appears and once when it vanishes."""
    up = set[tuple[str, str, int]]()
    for event in reception.events(arrivals, 0.0):
        if isinstance(event, Alive):
            assert (event.role, event.name, event.incarnation) not in up
            up.add((event.role, event.name, event.incarnation))
        elif isinstance(event, Gone):
            up.remove((event.role, event.name, event.incarnation))
    return up


def made_up(number: int) -> list[Arrival]:
    return [Arrival(key(f"x{each}"), token=True) for each in range(number)]


@pytest.mark.parametrize(("before", "after"), [(0, 4096), (4096, 0), (4096, 4095), (2000, 6191)])
def test_a_name_that_speaks_after_thousands_of_made_up_tokens_is_seen(before: int, after: int) -> None:
    arrivals = [*made_up(before + after)]
    arrivals.insert(before, Arrival(key("s2"), token=True))
    assert ("agent", "s2", 1) in up_after(Reception(Tokens(OWN, ALL), Counter()), [*arrivals, said("s2")])


@pytest.mark.parametrize("form", ["covey/t/alive/agent/x/{}", "covey/t/alive/role{}/x/1"])
def test_made_up_tokens_of_one_name_that_speaks_hide_no_other(form: str) -> None:
    reception = Reception(Tokens(OWN, ALL), Counter())
    flood = [Arrival(form.format(number), token=True) for number in range(2, 4097)]
    up = up_after(reception, [Arrival(key("x"), token=True), said("x"), *flood, said("x"), Arrival(key("s2"), token=True), said("s2")])
    assert ("agent", "s2", 1) in up and len(up) <= MOST_INCARNATIONS + 1


@pytest.mark.parametrize("form", ["covey/t/alive/agent/s2/{}", "covey/t/alive/role{}/s2/1"])
def test_older_incarnations_and_other_roles_of_a_name_take_it_not_away(form: str) -> None:
    honest = [Arrival(key("s2", 5000), token=True), Arrival(token_key("t", "body", "s2", 5000), token=True)]
    flood = [Arrival(form.format(number), token=True) for number in range(1, 100)]
    up = up_after(Reception(Tokens(OWN, ALL), Counter()), [*honest, said("s2"), *flood])
    assert {("agent", "s2", 5000), ("body", "s2", 5000)} <= up
