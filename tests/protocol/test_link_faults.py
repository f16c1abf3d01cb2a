"""Links lose, delay, copy and spoil what the dice of each direction say, and nothing when they are clear."""

import json

import numpy as np
import pytest

from protocol.link_faults import CLEAR, Channel, IncomingLinks, LinkCondition, LinkConditions, LiveLink, as_line, corrupted, sender_of


def arrivals(condition: LinkCondition, number: int = 20000, seed: int = 1) -> list[list[tuple[float, bytes]]]:
    channel = Channel(seed, "a", "b")
    return [channel.copies(b"payload", condition, 0.0) for _ in range(number)]


def test_a_clear_link_hands_over_the_very_object_at_once() -> None:
    payload = b"x" * 10
    [(delay, arrived)] = Channel(1, "a", "b").copies(payload, CLEAR, 0.0)
    assert delay == 0.0 and arrived is payload


def test_before_any_fault_is_set_all_arrives() -> None:
    assert LiveLink(1, "s1").incoming("covey/r/gossip/s2", b"x", 0.0) == [(0.0, b"x")]


@pytest.mark.parametrize("burst", [0.0, 4.0])
def test_the_share_that_is_lost_is_the_share_asked_for_with_and_without_bursts(burst: float) -> None:
    lost = np.array([not copies for copies in arrivals(LinkCondition(drop=0.3, burst=burst))])
    assert abs(lost.mean() - 0.3) < 4.0 * (0.3 * 0.7 / len(lost)) ** 0.5 * (1.0 + burst)  # 4 sigma, wider for bursts


def test_losses_come_in_runs_of_the_mean_length_asked_for() -> None:
    lost = np.array([not copies for copies in arrivals(LinkCondition(drop=0.2, burst=5.0), number=40000)])
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]]))))[::2]
    assert abs(runs.mean() - 5.0) < 4.0 * 5.0 / len(runs) ** 0.5  # a geometric run of mean 5 scatters by less than 5


def test_what_is_lost_at_ten_per_cent_is_lost_at_thirty_too() -> None:
    few, many = (np.array([not copies for copies in arrivals(LinkCondition(drop=drop))]) for drop in (0.1, 0.3))
    assert few.any() and not np.any(few & ~many)


def test_delay_and_jitter_bound_every_arrival() -> None:
    delays = np.array([copies[0][0] for copies in arrivals(LinkCondition(delay=0.5, jitter=0.2))])
    assert delays.min() >= 0.5 and delays.max() < 0.7 and np.ptp(delays) > 0.19


def test_a_throttled_link_carries_so_much_and_no_more_in_order_and_loses_what_waits_too_long() -> None:
    channel, condition = Channel(1, "a", "b"), LinkCondition(throttle=8.0, queue=0.5)  # a kilobyte a second
    sent = [(0.05 * number, channel.copies(bytes(100), condition, 0.05 * number)) for number in range(200)]  # two kilobytes a second
    arrived = [now + copies[0][0] for now, copies in sent if copies]
    assert np.diff(arrived) == pytest.approx(0.1)  # s for 100 bytes
    assert max(copies[0][0] for _, copies in sent if copies) <= 0.5 + 0.1 + 1e-9
    assert len(arrived) == pytest.approx(100, abs=6)
    assert channel.copies(bytes(100), condition, 20.0) == [(pytest.approx(0.1), bytes(100))]  # the queue is empty again


def test_a_throttled_link_throws_the_dice_of_a_clear_one() -> None:
    lost = [
        [not channel.copies(b"x", LinkCondition(drop=0.5, throttle=rate), 10.0 * number) for number in range(100)]
        for rate, channel in ((0.0, Channel(1, "a", "b")), (64.0, Channel(1, "a", "b")))
    ]
    assert lost[0] == lost[1]


def test_a_share_of_the_messages_comes_twice_and_a_share_is_overtaken() -> None:
    copies = arrivals(LinkCondition(duplicate=0.25, reorder=0.5, spread=0.1))
    twice = np.mean([len(found) == 2 for found in copies])
    held = np.mean([found[0][0] > 0.0 for found in copies])
    assert abs(twice - 0.25) < 0.015 and abs(held - 0.5) < 0.015  # 4 sigma of 20000 draws
    assert all(0.0 <= found[1][0] < 0.2 for found in copies if len(found) == 2)


@pytest.mark.parametrize("slow", [LinkCondition(delay=2.0, duplicate=0.5), LinkCondition(throttle=0.004, duplicate=0.5, queue=1e9)])
def test_a_second_copy_is_as_late_as_the_first(slow: LinkCondition) -> None:
    pairs = [found for found in arrivals(slow, number=200) if len(found) == 2]
    assert pairs and all(first[0] >= 1.9 and first[0] <= second[0] < first[0] + slow.spread for first, second in pairs)


def test_a_share_too_large_for_short_bursts_is_lost_all_the_same() -> None:
    for drop, burst in ((0.9, 4.0), (0.95, 1.5)):
        lost = np.array([not copies for copies in arrivals(LinkCondition(drop=drop, burst=burst), number=40000)])
        assert abs(lost.mean() - drop) < 0.02


def test_a_spoilt_message_differs_in_one_bit_or_holds_eight_bytes_of_ones() -> None:
    payload = bytes(range(100, 120))
    arrived = {copies[0][1] for copies in (Channel(seed, "a", "b").copies(payload, LinkCondition(flip=1.0), 0.0) for seed in range(4000))}
    one_bit = {found for found in arrived if sum((one ^ two).bit_count() for one, two in zip(found, payload)) == 1}
    blank = {found for found in arrived if b"\xff" * 8 in found}
    assert len(one_bit) == 8 * 20  # every bit is hit
    assert len(blank) == 20 - 8 + 1 and arrived == one_bit | blank


def test_the_place_of_a_fault_is_bounded_by_the_payload() -> None:
    assert corrupted(b"\x00\x00", 0.6) == b"\x00\x02"  # bit 9.6
    assert corrupted(b"\x00\x00", 0.99) == b"\x00\x80" and corrupted(b"\x00\x00", 0.0) == b"\xff\xff"


def test_each_direction_has_dice_of_its_own_and_the_same_seed_repeats_them() -> None:
    def lost(seed: int, sender: str, receiver: str) -> list[bool]:
        channel = Channel(seed, sender, receiver)
        return [not channel.copies(b"x", LinkCondition(drop=0.5), 0.0) for _ in range(100)]

    assert lost(1, "a", "b") == lost(1, "a", "b")
    assert len({tuple(lost(*case)) for case in [(1, "a", "b"), (1, "b", "a"), (2, "a", "b"), (1, "a", "c")]}) == 4


def test_ears_are_deaf_to_those_who_are_cut_off_and_clear_to_all_others() -> None:
    ears = IncomingLinks(1, "b")
    ears.set(LinkConditions(cut=("a",), conditions={"c": LinkCondition(delay=1.0)}))
    assert ears.hear("a", b"x", 0.0) == []
    assert ears.hear("c", b"x", 0.0) == [(1.0, b"x")]
    assert ears.hear("d", b"x", 0.0) == [(0.0, b"x")]


def test_a_process_hears_by_the_line_it_was_sent_and_goes_on_as_before_after_a_wrong_one() -> None:
    complaints: list[str] = []
    link = LiveLink(1, "s2", complaints.append)
    link.on_line(as_line(LinkConditions(cut=("s1",))))
    assert link.incoming("covey/r/gossip/s1", b"x", 0.0) == []
    for wrong in ("", "no json", json.dumps({"links": {"cut": 3}}), json.dumps({"links": {"kut": []}}), json.dumps([1])):
        link.on_line(wrong)
    assert len(complaints) == 4
    assert link.incoming("covey/r/gossip/s1", b"x", 0.0) == [] and link.incoming("covey/r/gossip/s3", b"x", 0.0) == [(0.0, b"x")]
    link.on_line(as_line(LinkConditions()))
    assert link.incoming("covey/r/gossip/s1", b"x", 0.0) == [(0.0, b"x")]


@pytest.mark.parametrize(
    ("key", "sender"),
    [
        ("covey/r/gossip/s1", "s1"),
        ("covey/r/hello/world", "world"),
        ("covey/r/observation/s1", "world"),
        ("covey/r/truth", "world"),
        ("covey/r/alive/agent/s1/3", ""),
    ],
)
def test_the_key_says_who_sent_a_message(key: str, sender: str) -> None:
    assert sender_of(key) == sender


def test_a_share_of_one_loses_all_and_a_share_of_zero_nothing() -> None:
    assert not any(arrivals(LinkCondition(drop=1.0), 200)) and all(arrivals(LinkCondition(drop=0.0, spread=0.1), 200))
