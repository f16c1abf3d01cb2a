"""The inbox keeps the newest when it overflows; a flood is thinned out; the quarantine shuts a source out and lets it in again."""

import math

import pytest

from protocol.arrival_queue import Arrival, ArrivalQueue, DelayQueue
from protocol.link_faults import LinkCondition, LinkConditions, LiveLink, as_line
from protocol.sender_limits import Quarantine, RateLimiter

UNKNOWN = object()  # an origin that cannot say which session it is


def payloads(batch: list[Arrival]) -> list[bytes]:
    return [arrival.payload for arrival in batch]


def test_the_loop_is_called_once_until_it_finds_the_inbox_empty() -> None:
    inbox = ArrivalQueue()
    assert inbox.add(Arrival("a", b"1"))
    assert not inbox.add(Arrival("a", b"2"))
    assert payloads(inbox.take(1)) == [b"1"]
    assert not inbox.add(Arrival("a", b"3"))
    assert payloads(inbox.take(9)) == [b"2", b"3"]
    assert inbox.take(9) == []
    assert inbox.add(Arrival("a", b"4"))


def test_an_overflowing_inbox_keeps_the_newest_message_of_every_key_in_order_of_arrival() -> None:
    inbox = ArrivalQueue(most_entries=4)
    for key, payload in [("a", b"a1"), ("b", b"b1"), ("a", b"a2"), ("a", b"a3"), ("a", b"a4")]:
        inbox.add(Arrival(key, payload))
    assert payloads(inbox.take(9)) == [b"b1", b"a4"]
    assert inbox.dropped == 3


def test_with_too_many_keys_the_older_half_goes_but_no_token() -> None:
    inbox = ArrivalQueue(most_entries=4)
    inbox.add(Arrival("token", token=True))
    for number in range(4):
        inbox.add(Arrival(f"k{number}", bytes([number])))
    kept = inbox.take(9)
    assert kept[0].token is True
    assert payloads(kept[1:]) == [b"\x01", b"\x02", b"\x03"]


def test_the_inbox_never_holds_more_bytes_than_allowed() -> None:
    inbox = ArrivalQueue(most_entries=1000, most_bytes=100)
    for number in range(200):
        inbox.add(Arrival(f"k{number}", bytes(10)))
        assert 10 * len(inbox) <= 100
    assert inbox.dropped == 200 - len(inbox)


def test_what_was_taken_makes_room_though_the_inbox_is_never_empty() -> None:
    inbox = ArrivalQueue(most_entries=1000, most_bytes=1000)
    for _ in range(3):
        inbox.add(Arrival("k", bytes(10)))
    for _ in range(400):
        inbox.add(Arrival("k", bytes(10)))
        assert len(inbox.take(1)) == 1
    assert (inbox.dropped, len(inbox)) == (0, 3)


def test_twenty_bad_messages_in_ten_seconds_shut_a_source_out_for_ten_seconds() -> None:
    quarantine = Quarantine(most=20, window=10.0)
    for number in range(19):
        quarantine.offend("x", 0.1 * number)
    assert not quarantine.is_quarantined("x", 2.0)
    quarantine.offend("x", 2.0)
    assert quarantine.is_quarantined("x", 11.9)
    assert not quarantine.is_quarantined("y", 11.9)
    assert not quarantine.is_quarantined("x", 12.0)


def test_rare_bad_messages_never_shut_a_source_out() -> None:
    quarantine = Quarantine(most=20, window=10.0)
    for number in range(100):
        quarantine.offend("x", float(number))
        assert not quarantine.is_quarantined("x", float(number))


def test_the_quarantine_remembers_a_bounded_number_of_sources() -> None:
    quarantine = Quarantine(most=1, window=10.0)
    for number in range(Quarantine.MOST_SOURCES + 5):
        quarantine.offend(f"x{number}", 0.0)
    assert not quarantine.is_quarantined("x0", 1.0)
    assert quarantine.is_quarantined("x5", 1.0)


def test_of_keys_of_which_only_the_newest_counts_nothing_older_is_handed_out() -> None:
    inbox = ArrivalQueue()
    for key, payload in [("c/r/observation/s1", b"1"), ("c/r/gossip/s2", b"a"), ("c/r/observation/s1", b"2"), ("c/r/gossip/s2", b"b")]:
        inbox.add(Arrival(key, payload))
    assert payloads(inbox.take(2, 1)) == [b"a"]  # a newer observation is in the second half
    assert payloads(inbox.take(9, 1)) == [b"2", b"b"]
    assert inbox.dropped == 1


def test_of_such_keys_as_many_messages_as_are_needed_are_handed_out() -> None:
    inbox = ArrivalQueue()
    for number in range(5):
        inbox.add(Arrival("c/r/observation/s1", bytes([number])))
    assert payloads(inbox.take(3, 3)) == [b"\x02"]
    assert payloads(inbox.take(9, 3)) == [b"\x03", b"\x04"]
    assert inbox.dropped == 2


def test_what_another_session_says_under_a_key_makes_nothing_void() -> None:
    inbox = ArrivalQueue(most_entries=4)
    inbox.add(Arrival("c/r/observation/s1", b"1", "world"))
    for number in range(8):
        inbox.add(Arrival("c/r/observation/s1", bytes([number]), "vandal"))
    assert payloads(inbox.take(9, 1)) == [b"1", b"\x07"]


def test_a_flood_under_one_key_is_held_to_its_rate_and_nobody_else_is() -> None:
    flow = RateLimiter(most=100)
    assert sum(flow.admits("k", "one", 0.0) for _ in range(1000)) == 200, "as much until it is suspect, and the burst of a session"
    assert sum(flow.admits("k", "one", 0.001 * step) for step in range(1, 1001)) == 100
    assert sum(flow.admits("k", "one", 9.0) for _ in range(1000)) == 100
    assert sum(flow.admits("k", "other", 9.0) for _ in range(1000)) == 100 and flow.admits("l", "one", 9.0)


def test_who_stays_below_the_rate_is_never_suspect_and_never_asked_for_its_name() -> None:
    flow = RateLimiter(most=100)
    assert all(flow.admits("k", UNKNOWN, 0.01 * number) for number in range(3000))
    with pytest.raises(AttributeError):
        all(flow.admits("k", UNKNOWN, 40.0) for number in range(101))


def test_made_up_keys_take_the_limit_off_no_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one key as much as ever; of all keys beyond the fixed number as much as of one."""
    monkeypatch.setattr(RateLimiter, "MOST_KEYS", 8)
    flow, admitted, others = RateLimiter(most=100), 0, 0
    for burst in range(10):
        admitted += sum(flow.admits("k", "one", 0.0) for _ in range(100))
        others += sum(flow.admits(f"x{burst}.{number}", "one", 0.0) for number in range(100))
    assert admitted == 200 and others == 7 + 100


def test_the_flow_remembers_a_bounded_number_of_keys() -> None:
    flow = RateLimiter(most=1)
    for number in range(9 * RateLimiter.MOST_KEYS):
        flow.admits(f"k{number // 3}", "x", 0.0)
    assert len(flow._left) == len(flow._suspect) == RateLimiter.MOST_KEYS and len(flow._counts) == RateLimiter.MOST_KEYS


def test_of_too_many_suspect_keys_the_one_that_was_quiet_for_longest_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RateLimiter, "MOST_KEYS", 2)
    flow = RateLimiter(most=1)
    for second, key in enumerate("abac"):
        assert [flow.admits(key, "x", float(second)) for _ in range(3)].count(False), "suspect"
    assert flow.admits("b", UNKNOWN, 9.0), "forgotten"
    with pytest.raises(AttributeError):
        flow.admits("a", UNKNOWN, 9.0)


def test_patient_messages_call_the_loop_only_once_enough_of_them_have_come() -> None:
    inbox = ArrivalQueue(coalesced_keys="/gossip/")
    assert not inbox.finish_pass(3)
    assert not inbox.add(Arrival("c/r/gossip/s1", b"1"))
    assert not inbox.add(Arrival("c/r/gossip/s2", b"2"))
    assert inbox.add(Arrival("c/r/gossip/s3", b"3"))
    assert payloads(inbox.take(2)) == [b"1", b"2"]
    assert inbox.finish_pass(1), "one that is enough is there already"
    assert payloads(inbox.take(9)) == [b"3"]
    assert not inbox.finish_pass(2)


def test_any_other_message_and_any_token_calls_the_loop_at_once() -> None:
    for urgent in (Arrival("c/r/observation/s1", b"1"), Arrival("c/r/alive/agent/s2/1", token=False)):
        inbox = ArrivalQueue(coalesced_keys="/gossip/")
        assert not inbox.finish_pass(9)
        assert not inbox.add(Arrival("c/r/gossip/s1", b"1"))
        assert inbox.add(urgent)
        assert len(inbox.take(9)) == 2
        assert not inbox.finish_pass(9)


def test_what_overflows_is_no_longer_waited_for() -> None:
    inbox = ArrivalQueue(most_entries=4, coalesced_keys="/gossip/")
    inbox.finish_pass(5)
    woken = [inbox.add(Arrival("c/r/gossip/s1", bytes([number]))) for number in range(6)]
    assert not any(woken)
    assert payloads(inbox.take(9)) == [b"\x04", b"\x05"]
    assert not inbox.finish_pass(1)


def delay_queue(inbox: ArrivalQueue, **conditions: LinkCondition) -> DelayQueue:
    link = LiveLink(1, "z")
    link.on_line(as_line(LinkConditions(conditions=conditions)))
    return DelayQueue(link, inbox)


def test_the_event_loop_is_called_for_what_is_due_sooner_than_all_the_rest() -> None:
    inbox = ArrivalQueue()
    queue = delay_queue(inbox, a=LinkCondition(delay=0.5), b=LinkCondition(delay=0.125))
    assert queue.add(Arrival("covey/r/gossip/a", b"1"), 0.0)
    assert not queue.add(Arrival("covey/r/gossip/a", b"2"), 0.0)
    assert queue.add(Arrival("covey/r/gossip/b", b"3"), 0.125)
    assert [queue.release(now) for now in (0.125, 0.25, 0.375)] == [0.25, 0.5, 0.5]
    assert not queue.add(Arrival("covey/r/gossip/a", b"4"), 0.375)
    assert [queue.release(now) for now in (0.5, 1.0)] == [0.875, math.inf]
    assert [arrival.payload for arrival in inbox.take(9)] == [b"3", b"1", b"2", b"4"]
    assert queue.add(Arrival("covey/r/gossip/a", b"5"), 1.0)


def test_what_is_due_enters_the_inbox_and_its_bounds_though_the_event_loop_does_not_come() -> None:
    inbox = ArrivalQueue(most_entries=4)
    queue = delay_queue(inbox, a=LinkCondition(delay=0.5))
    called = [queue.add(Arrival("covey/r/gossip/a", bytes([number])), 0.125 * number) for number in range(40)]
    assert called == [number in (0, 4) for number in range(40)]  # to set a timer, and to read what is due
    assert len(inbox) + inbox.dropped == 36 and inbox.dropped > 30
    assert inbox.take(9)[-1].payload == bytes([35])


def test_a_throttled_link_counts_from_the_arrival() -> None:
    inbox = ArrivalQueue()
    queue = delay_queue(inbox, a=LinkCondition(throttle=8.0))  # a kilobyte a second
    for now in (0.0, 0.25, 1.0):
        queue.add(Arrival("covey/r/gossip/a", bytes(500)), now)
    assert queue.release(1.25) == 1.5 and len(inbox) == 2
