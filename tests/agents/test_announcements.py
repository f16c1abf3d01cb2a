"""The rhythm of greetings: once for many who come together, rarer in a crowd, and never so rare that what they say of others runs out."""

from itertools import pairwise

import pytest

from agents.membership.announcements import REPLY_CROWD, REPLY_DELAY, AnnouncementSchedule
from protocol.session_watchdog import LISTED_LATELY


def moments(peers: int, early: bool, until: float) -> list[float]:
    """When greetings are said until then, s, by one that has said its first at 0."""
    greetings, said, now = AnnouncementSchedule(peers, lambda: True), [], 0.0
    greetings.start(0.0)
    while greetings.due is not None and greetings.due <= until:
        now = greetings.due
        assert greetings.take_due(peers, early, now) and not greetings.take_due(peers, early, now)
        said.append(now)
    return said


@pytest.mark.parametrize(("peers", "apart"), [(1, 2.0), (47, 2.0), (72, 3.0), (96, 4.0), (5000, 4.0)])
def test_greetings_become_rarer_in_a_crowd_but_not_too_rare_for_the_watchdog(peers: int, apart: float) -> None:
    said = moments(peers, early=False, until=60.0)
    assert [after - before for before, after in pairwise(said)] == pytest.approx([apart] * (len(said) - 1))
    assert len(said) > 10 and apart < LISTED_LATELY


def test_while_somebody_is_unknown_greetings_are_more_frequent() -> None:
    assert len(moments(11, early=True, until=60.0)) == 240
    assert len(moments(200, early=True, until=60.0)) == 30


def test_all_who_come_within_a_moment_get_one_greeting() -> None:
    greetings = AnnouncementSchedule(3, lambda: True)
    greetings.start(0.0)
    greetings.take_due(3, False, 0.25)
    for now in (1.0, 1.01, 1.02):
        greetings.peer_appeared(3, now)
    assert greetings.due == pytest.approx(1.0 + REPLY_DELAY)


def test_the_moment_is_longer_among_many() -> None:
    greetings = AnnouncementSchedule(2 * REPLY_CROWD, lambda: True)
    greetings.start(0.0)
    greetings.peer_appeared(2 * REPLY_CROWD, 0.1)
    assert greetings.due == pytest.approx(0.1 + 2 * REPLY_DELAY)


def test_a_clock_that_jumps_back_does_not_silence_greetings() -> None:
    greetings = AnnouncementSchedule(3, lambda: True)
    greetings.start(1000.0)
    greetings.observation_arrived(10.0)
    assert greetings.due is not None and greetings.due <= 10.0 + LISTED_LATELY
