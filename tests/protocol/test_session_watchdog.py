"""Who is within hearing, and when the others' Hellos say that a session is split: after patience, by a majority, never by a death."""

from itertools import pairwise

import pytest

from protocol.messages import Hello
from protocol.node import Alive, Effect, Gone, Reopen, received
from protocol.session_watchdog import FIRST_REST, HEARD_LATELY, LONGEST_REST, PATIENCE, ListenerWatchdog, SessionWatchdog

LEASE = 5.0  # s
TEAM = ("s1", "s2", "s3", "s4", "world")


def hello(sender: str, *heard: str) -> Hello:
    return Hello(sender=sender, incarnation=1, heard=heard)


def alarms(watchdog: SessionWatchdog, claimants: dict[str, tuple[str, ...]], seconds: float, start: float = 0.0) -> list[tuple[float, str]]:
    """(time, name) of every alarm while these peers say Hello every 2 s, each listing its names."""
    found = []
    for step in range(int(seconds / 2.0)):
        now = start + 2.0 * step
        for sender, heard in claimants.items():
            watchdog.note_hello(sender, now)
            name = watchdog.reason_to_reopen(hello(sender, *heard), now)
            if name:
                found.append((now, name))
    return found


def test_heard_are_those_who_greeted_and_spoke_lately_and_have_not_left() -> None:
    watchdog = SessionWatchdog("s1", TEAM, LEASE)
    assert watchdog.note_hello("s3", 0.0) and watchdog.note_hello("s2", 0.0) and not watchdog.note_hello("s2", 0.5)
    watchdog.note_messages(["s4"], 0.5)
    assert watchdog.heard(1.0) == ("s2", "s3"), "s4 has not greeted"
    watchdog.note_messages(["s3"], 2.0)
    assert watchdog.heard(0.6 + HEARD_LATELY) == ("s3",)
    assert watchdog.heard() == ("s2", "s3"), "before the start nobody is struck off for being slow"
    watchdog.token_vanished("s3", 1)
    assert watchdog.heard(2.0) == ("s2",)
    watchdog.note_messages(["s3"], 2.5)
    assert watchdog.heard(2.5) == ("s2", "s3"), "the next word brings it back"


def test_whom_most_others_hear_for_long_though_i_do_not_raises_an_alarm_that_rests_longer_every_time() -> None:
    found = alarms(SessionWatchdog("s1", TEAM, LEASE), {"s2": ("s1", "s4"), "s3": ("s1",)}, 400.0)
    assert [reason for _, reason in found] == ["the others hear s4, s1 does not"] * len(found)
    assert PATIENCE <= found[0][0] <= PATIENCE + 3.0
    rests = [after - before for (before, _), (after, _) in pairwise(found)]
    assert rests[0] == pytest.approx(FIRST_REST, abs=2.5)
    assert rests[1] == pytest.approx(2.0 * FIRST_REST, abs=2.5)
    assert max(rests) <= LONGEST_REST + 2.5


def test_one_of_many_cannot_raise_an_alarm() -> None:
    assert alarms(SessionWatchdog("s1", (*TEAM, "s5"), LEASE), {"s2": ("s4",), "s3": (), "s5": ()}, 100.0) == []


def test_nobody_but_the_expected_counts() -> None:
    assert alarms(SessionWatchdog("s1", TEAM, LEASE), {"s2": ("x9", "s1"), "s3": ("x9", "s1")}, 100.0) == []


def test_a_death_raises_no_alarm_for_the_others_strike_the_dead_off_in_time() -> None:
    """The worst case: the token stays up everywhere, so that silence alone tells; every 0.1 s another moment of the last word."""
    for tenth in range(40):
        mine, other = SessionWatchdog("s1", TEAM, LEASE), SessionWatchdog("s2", TEAM, LEASE)
        last = 10.0 + tenth / 10.0
        for step in range(200):
            now = step / 5.0
            for watchdog in (mine, other):
                watchdog.note_hello("s3", now)
                if now <= last:
                    watchdog.note_hello("s4", now)
            mine.note_hello("s2", now)
            if step % 10 == 0:
                assert mine.reason_to_reopen(hello("s2", *other.heard(now)), now) == ""


def test_after_a_partition_there_is_time_to_find_each_other_again() -> None:
    watchdog = SessionWatchdog("s1", TEAM, LEASE)
    assert alarms(watchdog, {"s2": ("s1",)}, 20.0) == [], "s3 and s4 are on the other side"
    assert alarms(watchdog, {"s2": ("s1", "s3", "s4")}, 4.0, start=20.0) == [], "s2 has found them first"
    assert alarms(watchdog, {"s2": ("s1", "s3", "s4"), "s3": ("s4",), "s4": ("s3",)}, 100.0, start=24.0) == []


def test_a_clock_that_jumps_raises_no_alarm() -> None:
    everybody = {name: tuple(other for other in TEAM if other != name) for name in ("s2", "s3", "s4")}
    watchdog = SessionWatchdog("s1", TEAM[:-1], LEASE)
    assert alarms(watchdog, everybody, 20.0) == []
    assert alarms(watchdog, everybody, 20.0, start=308.0) == []
    assert alarms(watchdog, everybody, 20.0, start=40.0) == []


def test_who_falls_silent_after_a_calm_time_is_missed_as_anybody_else() -> None:
    watchdog = SessionWatchdog("s1", TEAM, LEASE)
    for now in (0.0, 2.0):
        watchdog.note_messages(TEAM, now)
        assert watchdog.reason_to_reopen(hello("s2", "s3", "s4"), now) == "", "nobody can be silent for a while"
    found = alarms(watchdog, {"s2": ("s1", "s3", "s4"), "s3": ("s1", "s2", "s4")}, 20.0, start=4.0)
    assert [reason for _, reason in found] == ["the others hear s4, s1 does not"] and found[0][0] <= 2.0 + HEARD_LATELY + PATIENCE + 2.0


@pytest.mark.parametrize(("lease", "first"), [(1.0, PATIENCE), (LEASE, PATIENCE), (30.0, 30.0)])
def test_where_links_may_be_silent_for_long_the_signs_must_last_as_long(lease: float, first: float) -> None:
    missed = alarms(SessionWatchdog("s1", TEAM, lease), {"s2": ("s1", "s4"), "s3": ("s1",)}, 60.0)
    assert first <= missed[0][0] <= first + 3.0
    observer = ListenerWatchdog(("s1", "s2"), lease)
    observer.take(Alive("agent", "s2", 1), 0.0)
    observer.take(Gone("agent", "s2", 1), 0.0)
    assert not orders(observer, [hello("s2")], first) and orders(observer, [hello("s2")], first + 3.0)


def test_a_stall_of_all_links_is_no_alarm_because_hellos_from_before_it_do_not_count() -> None:
    watchdog, everybody = SessionWatchdog("s1", TEAM[:-1], 30.0), dict.fromkeys(("s2", "s3", "s4"), TEAM[:-1])
    assert alarms(watchdog, everybody, 20.0) == []
    late = [alarms(watchdog, {name: TEAM[:-1]}, 2.0, start) for start in (40.0, 60.0, 80.0) for name in ("s2", "s3")]
    assert late == [[]] * 6, "single Hellos come through, each after a long time"


def orders(watchdog: ListenerWatchdog, hellos: list[Hello], seconds: float) -> list[Effect]:
    """What an observer orders while these Hellos come every 2 s."""
    return [effect for step in range(int(seconds / 2.0)) for one in hellos for effect in watchdog.take(received(one), 2.0 * step)]


def test_an_observer_that_hears_an_agent_without_a_token_asks_for_a_new_session() -> None:
    watchdog = ListenerWatchdog(("s1", "s2"), LEASE)
    for name in ("s1", "s2"):
        watchdog.take(Alive("agent", name, 1), 0.0)
    both = [hello("s1", "s2"), hello("s2", "s1")]
    assert orders(watchdog, both, 30.0) == []
    watchdog.take(Gone("agent", "s2", 1), 0.0)
    assert orders(watchdog, both, 10.0) == [Reopen("s2 speaks, but its token has gone")]
    watchdog.take(Alive("agent", "s2", 1), 0.0)
    assert orders(watchdog, both, 30.0) == []


def test_an_observer_that_does_not_hear_whom_the_agents_hear_asks_for_a_new_session() -> None:
    others = [hello("s1", "s2", "s3"), hello("s3", "s1", "s2")]
    found = orders(ListenerWatchdog(("s1", "s2", "s3"), LEASE), others, 10.0)
    assert found == [Reopen("the others hear s2, this session does not")]
    assert orders(ListenerWatchdog(("s1", "s2", "s3"), LEASE), [hello("s1", "s3"), hello("s3", "s1")], 30.0) == [], "s2 is dead"


def test_one_agent_of_three_cannot_make_an_observer_open_a_new_session() -> None:
    others = [hello("s1", "s4"), hello("s2", "s1"), hello("s3", "s1")]
    assert orders(ListenerWatchdog(("s1", "s2", "s3", "s4"), LEASE), others, 30.0) == []


def test_an_observer_takes_no_word_of_made_up_names() -> None:
    strangers = [hello(f"x{number}", "s2") for number in range(3)]
    watchdog = ListenerWatchdog(("s1", "s2"), LEASE)
    assert orders(watchdog, [hello("s1"), *strangers], 30.0) == []
    watchdog.take(Alive("agent", "x0", 1), 0.0)
    watchdog.take(Gone("agent", "x0", 1), 0.0)
    assert orders(watchdog, strangers, 10.0) == [Reopen("x0 speaks, but its token has gone")]


def test_an_observer_forgets_the_earliest_of_too_many_guests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("protocol.session_watchdog.MOST_GUESTS", 64)
    watchdog = ListenerWatchdog(("s1", "s2"), LEASE)
    for number in range(200):
        name = f"x{number}"
        for event in (Alive("agent", name, 1), received(hello(name, "s1")), Gone("agent", name, 1)):
            watchdog.take(event, 0.0)
        tables = [len(table) for part in (watchdog, watchdog._watchdog) for table in vars(part).values() if isinstance(table, dict | set)]
        assert max(tables) <= 64 + 2
    assert not orders(watchdog, [hello("x0")], 10.0), "forgotten"
    assert orders(watchdog, [hello(name)], 10.0) == [Reopen(f"{name} speaks, but its token has gone")]


@pytest.mark.parametrize("standstill", [3.0, 5.5, 8.0, 10.0, 60.0])
def test_an_observer_that_stood_still_or_is_late_keeps_its_session(standstill: float) -> None:
    """All that has waited comes at once: words, then the tokens that the links of the old lease took along, then these again."""
    team, found = ("s1", "s2", "s3"), list[Effect]()
    watchdog = ListenerWatchdog(team, LEASE)
    for name in team:
        watchdog.take(Alive("agent", name, 1), 0.0)
    for stop in range(10):
        now = (stop + 1) * standstill
        words = [received(hello(name, *team)) for name in team for _ in range(int(standstill / 2.0))]
        tokens = [told("agent", name, 1) for told in (Gone, Alive) for name in team]
        for event in (*words, *tokens[:3], *words[:1], *tokens[3:], *words):
            found += watchdog.take(event, now)
    assert found == []
