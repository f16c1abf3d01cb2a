"""Where peers are is what they said last; those who are not there are nowhere, and who is far away changes no choice."""

import msgspec
import numpy as np

from agents.config import AgentConfig, TimingSettings
from agents.gossip.table import announced_sensor
from agents.interest.position_table import SENSOR_X, beacon_row
from agents.interest.selection import Selection
from agents.interest.tiles import Rectangle
from agents.membership.peer_table import PeerTable
from protocol.fields import pack
from protocol.messages import Beacon, Gossip
from protocol.sensing import SENSOR_CLASSES
from tests.agents.test_peer_table import gossip, hear

CONFIG = AgentConfig(members={"s1": "A", "s2": "B", "s3": "C"}, timing=TimingSettings(interest="neighbours"))


def beacon(name: str, tick: int, x: float, incarnation: int = 1) -> Beacon:
    place = x, 20.0
    return Beacon(
        sender=name,
        incarnation=incarnation,
        tick=tick,
        position=place,
        cod=place,
        power_radius=2.0,
        reach=5.0,
        column=0,
        row=0,
        sensor_class="B",
    )


def peers() -> PeerTable:
    """Of s1, who hears s2 and s3 and has chosen for the ground up to 50 m east."""
    found = PeerTable(CONFIG, "s1")
    assert found.take_beacon(beacon("s2", 0, 10.0)) and found.take_beacon(beacon("s3", 0, 20.0))
    choose(found)
    return found


def choose(found: PeerTable) -> None:
    """Listen to everybody who is known."""
    found.forget_outside(-1, 100)
    table = found.positions.table(beacon_row(beacon("s1", 0, 0.0), "power"))
    everybody = [True] * len(found.positions)
    found.choose(table, Selection(np.array(everybody), Rectangle(-50.0, -50.0, 50.0, 50.0)))


def eyes(found: PeerTable) -> dict[str, float]:
    """Where everybody's sensor is, m east."""
    found.forget_outside(-1, 100)
    table = found.positions.table(beacon_row(beacon("s1", 0, 0.0), "power"))
    return dict(zip(found.positions.names, table[:, SENSOR_X].tolist()))


def test_a_closed_round_says_where_peers_are_once_somebody_asks() -> None:
    found = peers()
    for tick in (0, 1):
        words: list[Gossip] = [gossip("s2", tick), gossip("s3", tick)]
        assert [hear(found, word) for word in words] == [None, None]
        found.close(tick)
    assert eyes(found) == {"s2": 10.0, "s3": 10.0}  # all gossips of these tests are said there


def test_who_has_gone_since_it_spoke_is_nowhere() -> None:
    found = peers()
    assert [hear(found, gossip(name, 0)) for name in ("s2", "s3")] == [None, None]
    found.close(0)
    found.gone("s2", 1, 0)
    assert eyes(found) == {"s3": 10.0}


def test_beacons_of_the_well_known_are_noted_and_the_others_are_given_back() -> None:
    found = peers()
    plain, stale, younger, stranger = (
        beacon("s2", 4, 12.0),
        beacon("s3", -1, 99.0),
        beacon("s3", 4, 99.0, incarnation=2),
        beacon("s4", 4, 40.0),
    )
    assert [*found.positions.note_all([plain, younger, stranger], found.peers)] == [younger, stranger]
    assert [*found.positions.note_all([stale], found.peers)] == [stale]
    assert eyes(found) == {"s2": 12.0, "s3": 20.0} and found.peers["s2"].beacon is plain


def test_a_newcomer_calls_for_a_choice_only_where_it_may_matter() -> None:
    found = peers()
    assert found.take_beacon(beacon("s4", 1, 60.0)) and not found.selection_outdated
    assert found.take_beacon(beacon("s5", 1, 40.0)) and found.selection_outdated
    choose(found)
    assert found.take_beacon(beacon("s4", 1, 60.0, incarnation=2)) and found.selection_outdated  # somebody known has been restarted
    choose(found)
    assert not found.take_beacon(beacon("s4", 2, 60.0, incarnation=1)) and not found.selection_outdated  # an older incarnation is nobody
    assert found.gone("s5", 1, 3) and found.selection_outdated


def test_the_silent_are_nowhere_but_for_those_of_whom_a_claim_has_told() -> None:
    """In tick 4 s3 says where s2, silent since tick 0, was in tick 3. Four rounds after that tick s2 is nowhere."""
    found = peers()
    places: list[set[str]] = []
    for tick in range(10):
        said = [gossip("s3", tick)] + ([gossip("s2", 0)] if tick == 0 else [])
        if tick == 4:
            rows = pack(np.array([[13.0, 20.0, 2.0], [30.0, 30.0, 1.5]]), "<f8")
            said = [msgspec.structs.replace(said[0], claim_tick=3, claim_names=("s3", "s2"), claim_bytes=rows)]
        assert [hear(found, word) for word in said] == [None] * len(said)
        found.close(tick)
        places.append({*eyes(found)})
    assert places == [{"s2", "s3"}] * 7 + [{"s3"}] * 3


def test_a_peer_that_starts_anew_counts_with_its_first_beacon_though_its_token_came_before() -> None:
    found = peers()
    found.alive("s2", 2)
    choose(found)
    assert not found.selection_outdated
    assert found.take_beacon(beacon("s2", 1, 10.0, incarnation=2)) and found.selection_outdated


def test_a_peer_whose_sensor_nobody_knows_is_nowhere() -> None:
    found = peers()
    for tick in (1, 2):
        for strange in found.positions.note_all([msgspec.structs.replace(beacon("s9", tick, 5.0), sensor_class="X")], found.peers):
            found.take_beacon(strange)
    assert "s9" not in found.positions


def test_a_gossip_of_a_peer_that_is_heard_no_more_stands_for_nobody_else() -> None:
    found = PeerTable(CONFIG, "s1")
    for name in ("s2", "s3", "s4"):
        found.take_beacon(beacon(name, 0, 10.0))
    choose(found)
    assert [hear(found, gossip(name, 0)) for name in ("s2", "s3", "s4")] == [None] * 3
    found.close(0)
    assert [hear(found, gossip(name, 1)) for name in ("s2", "s4")] == [None] * 2
    table = found.positions.table(beacon_row(beacon("s1", 0, 0.0), "power"))
    found.choose(table, Selection(np.array([name != "s4" for name in found.positions.names]), Rectangle(-50.0, -50.0, 50.0, 50.0)))
    assert found.missing(1) == {"s3"}
    found.close(1)
    assert found.any_missed() and found.inbox.newest("s3", 1) == gossip("s3", 0)


def test_a_peer_that_starts_anew_keeps_its_place_among_those_that_are_heard() -> None:
    found = PeerTable(CONFIG, "s1")
    assert found.take_beacon(beacon("s3", 0, 20.0)) and found.take_beacon(beacon("s2", 0, 10.0))
    choose(found)
    found.take_beacon(beacon("s3", 1, 20.0, incarnation=2))
    assert list(found.interest_set) == ["s2", "s3"] and found.interest_set["s3"].incarnation == 2


def test_the_sensor_of_the_newest_beacon_counts_so_that_one_with_wrong_bits_is_repaired() -> None:
    found = peers()
    known = found.peers["s2"].announced
    wrong, unusable, right = (msgspec.structs.replace(beacon("s2", 2 + n, 10.0), sensor_class=each) for n, each in enumerate("D?B"))
    for one, class_name in ((wrong, "D"), (unusable, "D"), (right, "B")):
        for beacons in ([one], [msgspec.structs.replace(one, position=(11.0, 5.0))]):  # said twice
            for left in found.positions.note_all(beacons, found.peers):
                found.take_beacon(left)
            assert found.peers["s2"].announced is announced_sensor("s2", SENSOR_CLASSES[class_name], AgentConfig().detection.clutter)
    assert found.peers["s2"].announced is known


def test_after_a_beacon_of_a_tick_far_ahead_the_next_right_one_counts() -> None:
    found = peers()
    found.take_beacon(beacon("s2", 10_000, 33.0))
    assert eyes(found)["s2"] == 33.0
    found.take_beacon(beacon("s2", 1, 11.0))
    assert eyes(found) == {"s2": 11.0, "s3": 20.0}
    found.take_beacon(beacon("s2", 0, 10.0))
    assert eyes(found)["s2"] == 11.0


def said(found: PeerTable, *beacons: Beacon) -> list[bool]:
    """What the agent makes of beacons as they come."""
    return [found.take_beacon(strange) for strange in found.positions.note_all([*beacons], found.peers)]


def test_a_beacon_that_comes_twice_in_a_batch_is_that_of_a_new_peer_once() -> None:
    """An agent that asks in several tiles is heard once from each."""
    assert said(peers(), *[beacon("s9", 4, 40.0)] * 3) == [True]


def test_a_beacon_lifts_a_suspicion_as_a_gossip_does() -> None:
    found = peers()
    for name in ("s2", "s3"):
        found.alive(name, 1)
        found.gone(name, 1, 5, suspected=True)
    said(found, beacon("s2", 8, 10.0))
    assert not found.peers["s2"].suspected and found.peers["s3"].suspected


def test_a_beacon_of_a_tick_far_ahead_brings_nobody_back_who_has_gone() -> None:
    found = peers()
    found.close(4)
    found.gone("s2", 1, 5)
    assert said(found, beacon("s2", 10**6, 10.0)) == [False] and found.peers["s2"].refused_until == 6
    assert said(found, beacon("s2", 8, 10.0)) == [True] and found.peers["s2"].refused_until is None
