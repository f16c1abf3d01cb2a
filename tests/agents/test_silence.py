"""A silent peer stays a generator while the claims of others state newer generators of it; and what an agent states in its own claim."""

import msgspec
import numpy as np
import pytest

from agents.membership.peer_table import PeerTable
from protocol.codec import encode
from protocol.fields import pack
from protocol.messages import UNKNOWN_AGE, Gossip
from protocol.node import Timer
from tests.agents.test_peer_table import CONFIG, generators, gossip, hear, hello
from tests.agents.test_two_agents import hear as hear_s2
from tests.agents.test_two_agents import met, of_kind, see

ROUNDS = 4  # a silent peer stays so long


def table(diagram: str = "power") -> PeerTable:
    """The peers s2 and s3 of s1, of which both have spoken in tick 0."""
    peers = PeerTable(msgspec.structs.replace(CONFIG, partition=msgspec.structs.replace(CONFIG.partition, kind=diagram)), "s1")
    for name in ("s2", "s3"):
        peers.alive(name, 1)
        peers.take_hello(hello(name))
        hear(peers, gossip(name, 0))
    peers.close(0)
    return peers


def claim(tick: int, *ages: int, x: float = 40.0, radius: float = 1.5, name: str = "s2") -> Gossip:
    """A gossip of s3 whose claim names s2 at (x, 30) m, so many ticks before the round of the claim; without ages: in that round."""
    rows = pack(np.array([[13.0, 20.0, 2.0], [x, 30.0, radius]]), "<f8")
    said = msgspec.structs.replace(gossip("s3", tick), claim_tick=tick - 1, claim_names=("s3", name), claim_bytes=rows)
    return msgspec.structs.replace(said, claim_ages=bytes([0, *ages])) if ages else said


def present(peers: PeerTable, claims: dict[int, Gossip], until: int = 14) -> list[int]:
    """The ticks in which s2, silent since tick 0, is a generator, when s3 says the gossips of these ticks."""
    found = []
    for tick in range(1, until):
        if tick in claims:
            assert hear(peers, claims[tick]) is None
        found += [tick] if "s2" in generators(peers, tick) else []
        peers.close(tick)
    return found


def test_a_silent_peer_is_silent_since_the_newest_generator_that_a_claim_states() -> None:
    """s3 says in tick 5 where s2 was in tick 4; four rounds later s2 is given up."""
    assert present(table(), {}) == [1, 2, 3, 4]
    assert present(table(), {3: claim(3), 4: claim(4), 5: claim(5)}) == [*range(1, 4 + ROUNDS + 1)]


def test_ticks_in_which_the_agent_itself_was_paused_are_no_silence_of_its_peers() -> None:
    peers, found = table(), []
    for tick in range(20, 26):  # it was paused from tick 1 on; its peers are silent from now on
        found += [tick] if "s2" in generators(peers, tick) else []
        peers.close(tick)
    assert found == [20, 21, 22, 23]


@pytest.mark.parametrize("pace", [1, 2, 4, 8])
def test_at_any_pace_a_silent_peer_stays_for_as_many_rounds(pace: int) -> None:
    """And for no longer than it keeps its own claim, whether or not it is the one that needs the pace."""
    for need in {1, pace}:
        peers = table()
        peers.keep_pace(pace)
        hear(peers, msgspec.structs.replace(gossip("s2", pace), pace=need))
        hear(peers, gossip("s3", pace))
        peers.close(pace)
        found = []
        for tick in range(2 * pace, 12 * pace, pace):
            hear(peers, gossip("s3", tick))
            found += [tick] if "s2" in generators(peers, tick) else []
            peers.close(tick)
        assert found == [pace * (1 + number) for number in range(1, ROUNDS + 1)]


def test_a_peer_of_a_slower_pace_than_ones_own_may_be_silent_between_its_rounds() -> None:
    peers = table()
    for tick in range(1, 9):
        hear(peers, gossip("s3", tick))
        if tick == 4:
            hear(peers, msgspec.structs.replace(gossip("s2", tick), pace=4))
        peers.close(tick)
    assert "s2" in generators(peers, 9)


def test_a_claim_that_keeps_an_old_generator_keeps_nobody_alive() -> None:
    """s3 has not heard s2 since tick 1 either, and says so."""
    assert present(table(), {tick: claim(tick, tick - 2) for tick in range(2, 12)}) == [1, 2, 3, 4, 5]
    assert present(table(), {tick: claim(tick, UNKNOWN_AGE) for tick in range(2, 12)}) == [1, 2, 3, 4]


def test_a_claim_brings_nobody_back_whose_token_has_gone_or_who_was_never_heard() -> None:
    peers = table()
    peers.gone("s2", 1, 0)
    assert present(peers, {tick: claim(tick) for tick in range(1, 9)}) == []
    peers = table()
    peers.alive("s4", 1)
    peers.take_hello(hello("s4"))
    hear(peers, claim(1, name="s4"))
    assert generators(peers, 1) == ["s2", "s3"]


@pytest.mark.parametrize(
    ("diagram", "place", "radius"), [("power", (40.0, 30.0), 1.5), ("voronoi-cod", (40.0, 30.0), 2.0), ("voronoi", (43.0, 30.0), 2.0)]
)
def test_the_generator_is_that_of_the_claim_and_the_sensor_moves_with_it(diagram: str, place: tuple[float, float], radius: float) -> None:
    """s2 was last heard at (10, 20) m, with its COD 3 m east of that. A claim of Voronoi cells states the position."""
    peers = table(diagram)
    hear(peers, claim(3))
    found = peers.generator_gossips(3, peers.fresh(3))["s2"]
    assert (found.tick, found.cod, found.power_radius) == (2, place, radius)
    assert found.pose[:2] == (place[0] - 3.0, place[1])


def test_of_a_word_of_its_own_and_a_claim_the_newer_one_counts() -> None:
    peers = table()
    hear(peers, claim(2, x=41.0))
    hear(peers, gossip("s2", 2))
    peers.close(2)
    hear(peers, claim(3, 2))  # in tick 0
    assert peers.generator_gossips(3, peers.fresh(3))["s2"].cod == (13.0, 20.0)
    peers.close(3)
    hear(peers, claim(4))
    assert peers.generator_gossips(4, peers.fresh(4))["s2"].cod == (40.0, 30.0)


def test_a_generator_that_the_sensor_cannot_have_does_not_count() -> None:
    """Class B has g(U) <= 2.81 m."""
    assert present(table(), {4: claim(4, radius=2.9)}) == [1, 2, 3, 4]
    assert present(table(), {4: claim(4, radius=2.8)}) == [1, 2, 3, 4, 5, 6, 7]


def test_who_listened_when_last_heard_has_a_cell_when_a_claim_names_it() -> None:
    peers = table()
    hear(peers, gossip("s2", 1, listening=True))
    assert generators(peers, 1) == ["s3"]
    peers.close(1)
    hear(peers, claim(4))
    assert generators(peers, 4) == ["s2", "s3"]


def test_an_agent_states_how_old_the_generators_of_its_claim_are_where_they_are_older() -> None:
    """s2 speaks in the ticks 0 to 2; the gossip of tick k holds the claim of tick k - 1."""
    agent, ages, sizes = met(), [], []
    for tick in range(7):
        said = of_kind(see(agent, tick, 100.0 * tick), Gossip)
        ages.append(said.claim_ages)
        sizes.append(b"claim_ages" in encode(said))
        if tick < 3:
            hear_s2(agent, tick, 100.0 * tick)
        agent.handle(Timer(), 100.0 * tick + 50.0)
    assert ages == [b""] * 4 + [b"\0\1", b"\0\2", b"\0\3"]
    assert sizes == [False] * 4 + [True] * 3
    late = of_kind(see(agent, 60, 6000.0), Gossip)
    assert (late.claim_names, late.claim_ages) == ((), b""), "ages without names are refused"


def test_a_generator_that_came_by_a_claim_is_passed_on_with_the_age_that_was_stated() -> None:
    agent = met(others=2)
    rows = pack(np.array([[25.0, 35.0, 2.0], [32.0, 20.0, 2.0]]), "<f8")
    for tick in range(4):
        said = of_kind(see(agent, tick, 100.0 * tick), Gossip)
        named = {"claim_tick": tick - 1, "claim_names": ("s3", "s2"), "claim_bytes": rows, "claim_ages": b"\0\1"} if tick == 3 else {}
        hear_s2(agent, tick, 100.0 * tick, sender="s3", pose=(25.0, 33.0, 1.5), cod=(25.0, 35.0), **named)
        if tick == 0:
            hear_s2(agent, tick, 100.0 * tick)
        agent.handle(Timer(), 100.0 * tick + 50.0)
    said = of_kind(see(agent, 4, 400.0), Gossip)
    assert dict(zip(said.claim_names, said.claim_ticks)) == {"s1": 3, "s2": 1, "s3": 3}
