"""Who is there: tokens, greetings and gossips decide who bounds the diagram of a tick and whose word a round waits for."""

import msgspec
import pytest

from agents.config import AgentConfig
from agents.gossip.round_inbox import WINDOW_TICKS
from agents.membership.peer_table import MOST_STRANGERS, PeerTable
from protocol.messages import Gossip, Hello
from protocol.node import Batch
from protocol.sensing import SENSOR_CLASSES, WedgeSensor

CONFIG = AgentConfig(members={"s1": "A", "s2": "B", "s3": "C"})  # a silent peer stays for 4 rounds


def hello(name: str, incarnation: int = 1, sensor_class: str = "B") -> Hello:
    return Hello(sender=name, incarnation=incarnation, sensor_class=sensor_class)


def differing(name: str) -> Hello:
    """Of somebody who works in another arena."""
    return msgspec.structs.replace(hello(name), settings={**CONFIG.shared_settings(), "arena": {"width": 1}})


def gossip(name: str, tick: int, incarnation: int = 1, listening: bool = False, radius: float = 2.0, cod: float = 3.0) -> Gossip:
    return Gossip(
        sender=name,
        incarnation=incarnation,
        tick=tick,
        pose=(10.0, 20.0, 0.0),
        cod=(10.0 + cod, 20.0),
        power_radius=radius,
        unused=radius * radius * 3.0,
        listening=listening,
    )


def neighbours(*names: str) -> PeerTable:
    """The peers of s1, alive and greeted."""
    found = PeerTable(CONFIG, "s1")
    for name in names:
        found.alive(name, 1)
        assert found.take_hello(hello(name)) is None
    return found


def hear(peers: PeerTable, said: Gossip) -> str | None:
    """The reason for which a gossip that arrives alone is refused; None: it is accepted."""
    [reason] = peers.accept(Batch([said]))
    return reason or None


def generators(peers: PeerTable, tick: int) -> list[str]:
    """Names of the generators of a tick."""
    return list(peers.generator_gossips(tick, peers.fresh(tick)))


@pytest.mark.parametrize("pace", [1, 8, 64])
def test_at_every_pace_the_gossip_of_the_next_tick_ends_a_silence(pace: int) -> None:
    peers = neighbours("s2")
    hear(peers, gossip("s2", pace))
    peers.close(pace)
    peers.close(2 * pace)
    assert peers.peers["s2"].silent_rounds == 1
    assert hear(peers, gossip("s2", 3 * pace)) is None and peers.peers["s2"].silent_rounds == 0


def test_a_peer_that_says_ticks_far_ahead_pushes_out_nobody_elses_gossips() -> None:
    peers = neighbours("s2", "s3")
    for tick in range(3 * WINDOW_TICKS):
        assert hear(peers, gossip("s3", 10_000 + tick)) is None
        assert hear(peers, gossip("s2", tick)) is None
        assert peers.fresh(tick).keys() == {"s2"}
        peers.close(tick)
    assert len(peers.inbox.rounds) == WINDOW_TICKS


def test_of_a_peer_whose_rounds_nobody_closes_the_next_and_the_newest_ticks_are_kept() -> None:
    peers = neighbours("s2", "s3")
    for tick in range(4 * WINDOW_TICKS):
        assert hear(peers, gossip("s2", tick)) is None and hear(peers, gossip("s3", tick)) is None
    assert sorted(peers.inbox.rounds) == [*range(WINDOW_TICKS), *range(3 * WINDOW_TICKS, 4 * WINDOW_TICKS)]


@pytest.mark.parametrize("wrong", [+10_000, +1, -10_000])
@pytest.mark.parametrize("first", [True, False])
def test_sixteen_wrong_ticks_of_a_peer_in_every_round_push_out_none_of_its_right_ones(wrong: int, first: bool) -> None:
    peers = neighbours("s2", "s3")
    peers.close(19_999)
    for tick in range(20_000, 20_000 + 3 * WINDOW_TICKS):
        right, fakes = gossip("s3", tick), [gossip("s3", tick + wrong + number) for number in range(WINDOW_TICKS)]
        hear(peers, gossip("s2", tick))
        for said in [*fakes, right] if first else [right, *fakes]:
            hear(peers, said)
        assert peers.fresh(tick).keys() == {"s2", "s3"}
        peers.close(tick)


def test_an_agent_that_wakes_hears_the_last_ticks_of_all() -> None:
    peers = neighbours("s2", "s3")
    for tick in range(600):
        assert hear(peers, gossip("s2", tick)) is None and hear(peers, gossip("s3", tick)) is None
    assert peers.fresh(599).keys() == {"s2", "s3"}


def test_an_agent_that_wakes_hears_the_last_ticks_of_one_whatever_order_another_has_said_them_in() -> None:
    peers = neighbours("s2", "s3")
    peers.close(99)
    for tick in range(131, 115, -1):
        assert hear(peers, gossip("s2", tick)) is None
    for tick in range(100, 134):
        assert hear(peers, gossip("s3", tick)) is None
    kept = [tick for tick in range(100, 134) if "s3" in peers.fresh(tick)]
    assert kept == [*range(100, 116), *range(118, 134)]


def test_a_gossip_of_a_tick_far_ahead_brings_nobody_back_who_has_gone() -> None:
    peers = neighbours("s2", "s3")
    for tick in range(8):
        assert hear(peers, gossip("s2", tick)) is None
        if tick < 3:
            assert hear(peers, gossip("s3", tick)) is None
        peers.close(tick)
        if tick == 3:
            peers.gone("s3", 1, tick)
        if tick >= 3:
            assert hear(peers, gossip("s3", 10_000 + tick)) is None
            assert "s3" not in generators(peers, tick + 1)


def test_a_lost_token_is_no_departure_of_one_that_is_heard_by_an_agent_that_wakes() -> None:
    peers = neighbours("s2", "s3", "s4")
    for tick in (0, 40):  # in between this agent stood still
        assert tick == 0 or not peers.gone("s4", 1, 0, suspected=True)
        for name in ("s2", "s3", "s4"):
            assert hear(peers, gossip(name, tick)) is None
        peers.close(tick)
    assert generators(peers, 41) == ["s2", "s3", "s4"] and hear(peers, gossip("s4", 41)) is None


def test_no_round_waits_for_a_peer_that_says_ticks_far_ahead_alone() -> None:
    peers = neighbours("s2", "s3")
    waited = []
    for tick in range(8):
        assert hear(peers, gossip("s2", tick)) is None and hear(peers, gossip("s3", 10_000 + tick)) is None
        waited.append(peers.missing(tick) == {"s3"})
        peers.close(tick)
    assert waited == [True] * 4 + [False] * 4


def test_of_made_up_names_that_say_hello_a_fixed_number_is_kept() -> None:
    peers = neighbours("s2")
    for number in range(3 * MOST_STRANGERS):
        name = f"x{number}"
        assert hear(peers, gossip(name, 0)) == "unknown_sensor" and name not in peers.peers
        assert peers.take_hello(hello(name)) is None and hear(peers, gossip(name, 0)) is None
        assert hear(peers, gossip(name, 10_000 + number)) is None, "each in a tick of its own"
    assert len(peers.peers) == len(peers.interest_set) == 1 + MOST_STRANGERS
    assert "s2" in peers.peers and f"x{3 * MOST_STRANGERS - 1}" in peers.peers and "x0" not in peers.peers
    assert len(peers.inbox.rounds) == 1 + MOST_STRANGERS and len(peers.inbox.of(0)) == MOST_STRANGERS
    peers.close(0)
    assert len(peers.inbox.newest_closed) == MOST_STRANGERS


def test_guests_with_a_token_are_kept_however_many_strangers_say_hello_and_those_that_have_gone_are_strangers() -> None:
    peers = neighbours("s2", "g1", "g2")
    peers.gone("g2", 1, 0)
    for number in range(MOST_STRANGERS):
        peers.take_hello(hello(f"x{number}"))
    peers.alive("x0", 1)
    peers.take_hello(hello("y"))
    assert {"s2", "g1", "x0", "x1", "y"} <= peers.peers.keys() and "g2" not in peers.peers
    assert len(peers.peers) == 3 + MOST_STRANGERS


def test_a_round_waits_for_everybody_alive_until_all_have_spoken() -> None:
    peers = neighbours("s2", "s3")
    assert set(peers.missing(0)) == {"s2", "s3"}
    assert hear(peers, gossip("s3", 0)) is None
    assert set(peers.missing(0)) == {"s2"}
    assert hear(peers, gossip("s2", 0)) is None
    assert not peers.missing(0) and list(peers.fresh(0)) == ["s2", "s3"]


def test_names_are_ordered_by_number_whoever_came_first() -> None:
    peers = neighbours("s10", "s2", "s9")
    for name in ("s10", "s9", "s2"):
        hear(peers, gossip(name, 0))
    assert list(peers.fresh(0)) == generators(peers, 0) == ["s2", "s9", "s10"]


def test_nobody_waits_for_a_late_comer_before_its_first_word() -> None:
    peers = neighbours("s2")
    hear(peers, gossip("s2", 6))
    peers.close(6)
    peers.alive("s3", 1)
    peers.take_hello(hello("s3"))
    assert set(peers.missing(7)) == {"s2"}


def test_a_silent_peer_stays_a_generator_for_four_rounds_where_it_was_last_heard() -> None:
    peers = neighbours("s2")
    hear(peers, gossip("s2", 0))
    peers.close(0)
    present = []
    for tick in range(1, 7):
        present.append(generators(peers, tick) == ["s2"])
        peers.close(tick)
    assert present == [True] * 4 + [False] * 2
    assert not peers.missing(7)


def test_the_loss_of_a_token_removes_the_generator_in_the_same_round() -> None:
    peers = neighbours("s2", "s3")
    for name in ("s2", "s3"):
        hear(peers, gossip(name, 0))
    peers.gone("s2", 1, 0)
    assert generators(peers, 0) == ["s3"] and list(peers.fresh(0)) == ["s3"] and not peers.missing(0)


def test_a_flapping_token_costs_one_round_and_one_that_stays_away_two() -> None:
    peers = neighbours("s2")
    for tick, back in ((4, True), (9, False)):
        hear(peers, gossip("s2", tick))
        peers.gone("s2", 1, tick)
        peers.close(tick)
        if back:
            peers.alive("s2", 1)
        assert hear(peers, gossip("s2", tick + 1)) == (None if back else "dead")
        assert generators(peers, tick + 1) == (["s2"] if back else [])
        peers.close(tick + 1)
        assert hear(peers, gossip("s2", tick + 2)) is None
        assert generators(peers, tick + 2) == ["s2"]


def test_what_a_dead_peer_said_before_is_refused_also_when_it_was_a_tick_ahead() -> None:
    """Tokens and gossips come through different threads, and the dead may have been told of the next tick first."""
    peers = neighbours("s2")
    peers.gone("s2", 1, 5)
    assert hear(peers, gossip("s2", 5)) == "dead" and hear(peers, gossip("s2", 6)) == "dead"
    assert generators(peers, 6) == [] and not peers.missing(6)


def test_a_younger_incarnation_replaces_the_older_whose_word_counts_no_more() -> None:
    peers = neighbours("s2")
    hear(peers, gossip("s2", 0))
    peers.alive("s2", 2)
    assert generators(peers, 0) == []
    assert hear(peers, gossip("s2", 1)) == "incarnation" and peers.take_hello(hello("s2")) == "incarnation"
    assert hear(peers, gossip("s2", 1, incarnation=2)) == "unknown_sensor"
    assert peers.take_hello(hello("s2", 2)) is None and hear(peers, gossip("s2", 1, incarnation=2)) is None
    peers.gone("s2", 1, 1)  # the token of the old process goes late
    assert generators(peers, 1) == ["s2"]


def test_one_wrong_bit_in_an_incarnation_silences_nobody_whose_token_is_up() -> None:
    peers = neighbours("s2")
    assert peers.take_hello(hello("s2", 2**40)) == "incarnation" and hear(peers, gossip("s2", 0, incarnation=3)) == "incarnation"
    assert hear(peers, gossip("s2", 0)) is None
    peers.take_hello(hello("s3", 9))  # wrong, and heard before the token
    peers.alive("s3", 1)
    assert peers.take_hello(hello("s3")) is None and hear(peers, gossip("s3", 0)) is None


def test_the_newest_hello_counts_so_that_a_spoilt_one_is_put_right() -> None:
    peers = neighbours()
    peers.alive("s2", 1)
    wrong = Hello(sender="s2", incarnation=1, sensor_class="B", sensor=WedgeSensor(1.0, 2.0, 0.5))
    peers.take_hello(wrong)
    assert hear(peers, gossip("s2", 0)) == "implausible"
    peers.take_hello(Hello(sender="s2", incarnation=1, sensor_class="B", sensor=SENSOR_CLASSES["B"]))
    assert hear(peers, gossip("s2", 0)) is None


def test_a_listener_is_heard_but_has_no_cell() -> None:
    peers = neighbours("s2")
    hear(peers, gossip("s2", 3, listening=True))
    assert list(peers.fresh(3)) == ["s2"] and generators(peers, 3) == []


def test_a_gossip_is_refused_if_not_newer_than_one_of_the_same_peer_in_a_closed_round() -> None:
    peers = neighbours("s2")
    hear(peers, gossip("s2", 3))
    peers.close(3)
    assert hear(peers, gossip("s2", 3)) == "closed" and hear(peers, gossip("s2", 2)) == "closed"


def test_a_gossip_beyond_what_its_sensor_can_do_is_refused() -> None:
    """Class B has D = 24.88 m^2, hence g(U) <= 2.81 m, and reaches 8 m."""
    peers = neighbours("s2")
    assert hear(peers, gossip("s2", 0, radius=2.9)) == "implausible"
    assert hear(peers, gossip("s2", 0, cod=8.1)) == "implausible"
    assert hear(peers, gossip("s2", 0, radius=2.8, cod=7.9)) is None


def test_strangers_and_unknown_sensors_are_refused() -> None:
    peers = PeerTable(CONFIG, "s1")
    assert hear(peers, gossip("s2", 0)) == "unknown_sensor"
    assert peers.take_hello(hello("s2", sensor_class="Z")) == "sensor"
    assert peers.take_hello(hello("s2")) is None
    announced = peers.peers["s2"].announced
    assert announced is not None and announced.sensor is SENSOR_CLASSES["B"]


def test_a_round_counts_who_was_missing() -> None:
    peers = neighbours("s2", "s3")
    hear(peers, gossip("s2", 0))
    assert peers.close(0) == 1
    assert peers.close(1) == 1  # s3 has never spoken, and after the first tick nobody waits for it


def test_who_takes_the_sender_for_another_sensor_judges_its_words_for_himself() -> None:
    """In virtual time one message has many listeners, of whom some may have been told wrong what its sender is."""
    for classes in ("DA", "AD"):
        said, believed = gossip("s2", 0, radius=15.0), []
        for sensor_class in classes:
            listener = PeerTable(CONFIG, "s1")
            listener.take_hello(hello("s2", sensor_class=sensor_class))
            believed.append(hear(listener, said) is None)
        assert believed == [sensor_class == "D" for sensor_class in classes]
    said, sensors = gossip("s2", 0), []
    for sensor_class in "ABA":
        listener = PeerTable(CONFIG, "s1")
        listener.take_hello(hello("s2", sensor_class=sensor_class))
        hear(listener, said)
        carried = [listener.peers[name].announced for name in listener.fresh(0)]
        sensors.append([announced.sensor for announced in carried if announced is not None])
    assert sensors == [[SENSOR_CLASSES[sensor_class]] for sensor_class in "ABA"]


def test_a_peer_of_other_settings_is_refused_and_waited_for_by_nobody() -> None:
    peers = neighbours("s3")
    peers.alive("s2", 1)
    assert peers.take_hello(differing("s2")) == "settings"
    assert peers.peers["s2"].differs == ("arena.width",) and not peers.lacks_announcements()
    assert set(peers.missing(0)) == {"s3"} and hear(peers, gossip("s2", 0)) == "settings"
    assert hear(peers, gossip("s3", 0)) is None
    assert generators(peers, 0) == ["s3"] and peers.close(0) == 0


def test_a_spoilt_greeting_neither_shuts_out_a_peer_that_agreed_nor_keeps_one_out_for_ever() -> None:
    peers = neighbours("s2")
    assert peers.take_hello(differing("s2")) == "settings"
    assert hear(peers, gossip("s2", 0)) is None
    peers.alive("s3", 1)
    assert peers.take_hello(differing("s3")) == "settings" and peers.take_hello(hello("s3")) is None
    assert hear(peers, gossip("s3", 0)) is None and generators(peers, 0) == ["s2", "s3"]


def test_a_peer_that_comes_back_with_the_right_settings_is_a_peer_again() -> None:
    peers = neighbours("s2")
    peers.alive("s3", 1)
    peers.take_hello(differing("s3"))
    peers.gone("s3", 1, 3)
    peers.alive("s3", 2)
    assert peers.take_hello(hello("s3", 2)) is None and list(peers.interest_set) == ["s2", "s3"]


def test_who_plays_every_second_tick_waits_for_as_many_rounds_of_silence_as_the_setting_says() -> None:
    timing = msgspec.structs.replace(CONFIG.timing, silent_rounds=6)
    peers = PeerTable(msgspec.structs.replace(CONFIG, timing=timing), "s1")
    peers.alive("s2", 1)
    peers.keep_pace(2)
    found = []
    for _ in range(6):
        peers._count_silent({"s2"})
        found.append(peers.silence_timeouts)
    assert found == [0, 0, 0, 0, 0, 1]


def test_with_neighbours_only_a_peer_is_silent_for_its_position_when_it_is_silent_for_the_diagram() -> None:
    config = msgspec.structs.replace(CONFIG, timing=msgspec.structs.replace(CONFIG.timing, interest="neighbours", silence=4.0))
    peers = PeerTable(msgspec.structs.replace(config, run=msgspec.structs.replace(config.run, clock="realtime", dt=0.5)), "s1")
    assert peers.positions.silence_limit == 8
    peers.keep_pace(2)
    assert peers.positions.silence_limit == 4


def test_the_token_of_an_older_incarnation_replaces_none_whose_own_token_is_suspected() -> None:
    peers = neighbours("s2")
    peers.alive("s2", 3)
    assert not peers.gone("s2", 3, 5, suspected=True)
    peers.alive("s2", 1)
    assert peers.peers["s2"].incarnation == 3
