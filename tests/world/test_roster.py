"""The roster knows who is there and who has spoken, whatever the order in which tokens and Hellos arrive."""

from protocol.messages import Hello
from world.roster import MOST_STRANGERS, Roster


def hello(name: str, incarnation: int = 1, heard: tuple[str, ...] = ()) -> Hello:
    return Hello(sender=name, incarnation=incarnation, heard=heard)


def test_of_two_incarnations_the_newer_one_counts() -> None:
    roster = Roster()
    assert roster.appear("s1", 1)
    assert roster.appear("s1", 2)
    assert not roster.appear("s1", 1)
    assert roster.live("s1") == 2
    assert not roster.vanish("s1", 1)
    assert roster.vanish("s1", 2)
    assert roster.live("s1") is None


def test_a_token_that_was_never_seen_may_vanish() -> None:
    assert not Roster().vanish("s1", 1)


def test_only_the_first_hello_of_an_incarnation_is_news() -> None:
    roster = Roster()
    assert roster.hear(hello("s1", 5))
    assert not roster.hear(hello("s1", 5, heard=("world",)))
    assert roster.hellos["s1"].heard == ("world",)
    assert not roster.hear(hello("s1", 4))
    assert roster.hellos["s1"].incarnation == 5
    assert roster.hear(hello("s1", 6))


def test_an_agent_speaks_when_its_own_incarnation_has_been_heard() -> None:
    roster = Roster()
    roster.hear(hello("s1", 1))
    assert not roster.speaks("s1")
    roster.appear("s1", 2)
    assert not roster.speaks("s1")
    roster.note_spoken("s1", 2)
    assert roster.speaks("s1")


def test_the_team_is_complete_when_everybody_hears_everybody() -> None:
    roster, team = Roster(), ("s1", "s2")
    roster.appear("s1", 1)
    roster.appear("s2", 7)
    roster.hear(hello("s1", 1, ("s2", "world")))
    assert not roster.is_complete(team, "world")
    roster.hear(hello("s2", 7, ("s1",)))
    assert not roster.is_complete(team, "world"), "s2 has not heard the world"
    roster.hear(hello("s2", 7, ("s1", "world", "a guest")))
    assert roster.is_complete(team, "world")
    roster.appear("s2", 8)
    assert not roster.is_complete(team, "world"), "the Hello is of an older incarnation"


def test_of_names_without_a_token_a_fixed_number_is_kept_beside_members_and_guests() -> None:
    roster = Roster(("s1",))
    roster.hear(hello("guest"))
    roster.appear("guest", 1)
    for number in range(2 * MOST_STRANGERS):
        roster.hear(hello(f"x{number}"))
    roster.hear(hello("s1"))
    assert roster.hellos.keys() == {"guest", "s1", *(f"x{number}" for number in range(MOST_STRANGERS, 2 * MOST_STRANGERS))}
    assert roster.admits("s1") and roster.admits("guest") and not roster.admits(f"x{MOST_STRANGERS}")
    roster.appear("s1", 1)
    for name in ("guest", "s1"):
        assert roster.vanish(name, 1)
    assert "s1" in roster.hellos and "guest" not in roster.names(), "a guest that has gone is forgotten"
