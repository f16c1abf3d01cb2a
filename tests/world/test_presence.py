"""It is known who is there and who has spoken, whatever the order in which tokens and Hellos arrive."""

from protocol.messages import Hello
from world.presence import MOST_STRANGERS, Presence


def hello(name: str, incarnation: int = 1, heard: tuple[str, ...] = ()) -> Hello:
    return Hello(sender=name, incarnation=incarnation, heard=heard)


def test_of_two_incarnations_the_newer_one_counts() -> None:
    presence = Presence()
    assert presence.appear("s1", 1)
    assert presence.appear("s1", 2)
    assert not presence.appear("s1", 1)
    assert presence.live("s1") == 2
    assert not presence.vanish("s1", 1)
    assert presence.vanish("s1", 2)
    assert presence.live("s1") is None


def test_a_token_that_was_never_seen_may_vanish() -> None:
    assert not Presence().vanish("s1", 1)


def test_only_the_first_hello_of_an_incarnation_is_news() -> None:
    presence = Presence()
    assert presence.hear(hello("s1", 5))
    assert not presence.hear(hello("s1", 5, heard=("world",)))
    assert presence.hellos["s1"].heard == ("world",)
    assert not presence.hear(hello("s1", 4))
    assert presence.hellos["s1"].incarnation == 5
    assert presence.hear(hello("s1", 6))


def test_an_agent_speaks_when_its_own_incarnation_has_been_heard() -> None:
    presence = Presence()
    presence.hear(hello("s1", 1))
    assert not presence.speaks("s1")
    presence.appear("s1", 2)
    assert not presence.speaks("s1")
    presence.note_spoken("s1", 2)
    assert presence.speaks("s1")


def test_the_team_is_complete_when_everybody_hears_everybody() -> None:
    presence, team = Presence(), ("s1", "s2")
    presence.appear("s1", 1)
    presence.appear("s2", 7)
    presence.hear(hello("s1", 1, ("s2", "world")))
    assert not presence.is_complete(team, "world")
    presence.hear(hello("s2", 7, ("s1",)))
    assert not presence.is_complete(team, "world"), "s2 has not heard the world"
    presence.hear(hello("s2", 7, ("s1", "world", "a guest")))
    assert presence.is_complete(team, "world")
    presence.appear("s2", 8)
    assert not presence.is_complete(team, "world"), "the Hello is of an older incarnation"


def test_of_names_without_a_token_a_fixed_number_is_kept_beside_members_and_guests() -> None:
    presence = Presence(("s1",))
    presence.hear(hello("guest"))
    presence.appear("guest", 1)
    for number in range(2 * MOST_STRANGERS):
        presence.hear(hello(f"x{number}"))
    presence.hear(hello("s1"))
    assert presence.hellos.keys() == {"guest", "s1", *(f"x{number}" for number in range(MOST_STRANGERS, 2 * MOST_STRANGERS))}
    assert presence.admits("s1") and presence.admits("guest") and not presence.admits(f"x{MOST_STRANGERS}")
    presence.appear("s1", 1)
    for name in ("guest", "s1"):
        assert presence.vanish(name, 1)
    assert "s1" in presence.hellos and "guest" not in presence.names(), "a guest that has gone is forgotten"
