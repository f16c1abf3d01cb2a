"""What all say in one instant is heard whole where it is what a calm round brings, and else message by message."""

import msgspec
import pytest

from agents.agent import Agent
from agents.capacity import sensor_facts
from agents.neighbours import Neighbours
from agents.peers import Outfit, understood
from agents.unison import Part, Together, Unison, together_of
from agents.words import learn
from deploy.simulation import Simulation
from protocol.messages import Beacon, Gossip, Hello
from protocol.node import Batch, Effect, Received
from protocol.sensing import SENSOR_CLASSES
from tests.agents.test_neighbours import CONFIG, gossip, hello, neighbours
from tests.swarm.scene import tracking

TICK = 1


def calm() -> Neighbours:
    """The peers of s1, s2 and s3, after a round in which nobody was missing."""
    peers = neighbours("s2", "s3")
    for name in ("s2", "s3"):
        assert peers.hear(gossip(name, 0)) is None
    assert peers.close(0) == 0
    return peers


def said() -> list[Gossip]:
    """What all three say in the next."""
    return [gossip(name, TICK) for name in ("s1", "s2", "s3")]


def batch(words: list[Gossip | Beacon | Hello]) -> Batch:
    return Batch([word.sender for word in words], [Received(word) for word in words])


def changed(change: str, words: list[Gossip]) -> list[Gossip]:
    """The same with something out of the ordinary."""
    if change == "missing":
        return words[:2]
    if change == "without me":
        return words[1:]
    if change == "a twin of mine":
        return [gossip("s1", TICK, incarnation=2), *words[1:]]
    if change == "somebody else":
        return [*words, gossip("s4", TICK)]
    if change == "boastful":
        return [*words[:2], gossip("s3", TICK, radius=100.0)]
    other = {"tick": gossip("s3", TICK + 1), "incarnation": gossip("s3", TICK, incarnation=2), "renamed": gossip("s4", TICK)}[change]
    return [*words[:2], other]


def test_a_calm_round_is_heard_whole() -> None:
    peers, words = calm(), said()
    learn(words[0], SENSOR_CLASSES["B"], CONFIG)
    assert peers.hear_together(Unison(words), TICK)
    heard = peers.fresh(TICK)
    assert isinstance(heard, Part) and len(heard) == 2 and not peers.missing(TICK)
    assert heard.gossips() == {"s2": words[1], "s3": words[2]} and list(heard.names()) == ["s2", "s3"]
    assert heard.words(words[0]).names == ("s1", "s2", "s3")
    assert peers.close(TICK) == 0
    assert peers.said.last == {"s2": words[1], "s3": words[2]}
    assert peers.missing(TICK + 1) == {"s2", "s3"}


@pytest.mark.parametrize(
    "change", ["missing", "without me", "a twin of mine", "somebody else", "boastful", "tick", "incarnation", "renamed"]
)
def test_anything_else_is_as_if_it_had_not_come(change: str) -> None:
    peers = calm()
    assert not peers.hear_together(Unison(changed(change, said())), TICK)
    assert peers.missing(TICK) == {"s2", "s3"}
    for word in said()[1:]:
        assert peers.hear(word) is None
    assert list(peers.fresh(TICK)) == ["s2", "s3"]


def test_a_sender_that_somebody_took_for_another_sensor_is_judged_by_himself() -> None:
    peers, words, other = calm(), said(), SENSOR_CLASSES["A"]
    assert understood(words[2], Outfit(other, sensor_facts(other)), CONFIG) is words[2]
    assert not peers.hear_together(Unison(words), TICK)


@pytest.mark.parametrize("trouble", ["gone", "missed", "one came before", "a later one came before", "another tick"])
def test_who_is_not_calm_hears_one_by_one(trouble: str) -> None:
    peers, tick = calm(), TICK
    if trouble == "gone":
        peers.gone("s3", 1, 0)
    elif trouble == "missed":
        peers.hear(gossip("s2", TICK))
        peers.close(TICK)
        tick = TICK + 1
    elif trouble == "one came before":
        peers.hear(gossip("s2", TICK))
    elif trouble == "a later one came before":
        peers.hear(gossip("s2", TICK + 1))
    else:
        tick = TICK + 1
    assert not peers.hear_together(Unison([gossip(name, tick) for name in ("s1", "s2", "s3")]), tick)


def test_who_hears_neighbours_only_hears_them_one_by_one() -> None:
    config = msgspec.structs.replace(CONFIG, timing=msgspec.structs.replace(CONFIG.timing, interest="neighbours"))
    assert not Neighbours(config, "s1").hear_together(Unison([gossip("s1", 0)]), 0)


def test_mine_stands_in_its_place_as_i_said_it() -> None:
    words = said()
    for word in words:
        learn(word, SENSOR_CLASSES["B"], CONFIG)
    unison = Unison(words)
    mine, arrived = gossip("s2", TICK), Part(unison, "s2")
    learn(mine, SENSOR_CLASSES["B"], CONFIG)
    assert arrived.words(mine) is unison.words and arrived.words(words[1]) is unison.words
    for different in (gossip("s2", TICK, radius=1.0), msgspec.structs.replace(mine, view=7)):
        learn(different, SENSOR_CLASSES["B"], CONFIG)
        assert arrived.words(different).gossips == [words[0], different, words[2]]


def test_only_gossips_in_the_order_of_names_are_looked_at_together() -> None:
    words = said()
    whole = batch([*words])
    unison = together_of(whole)
    assert isinstance(unison, Unison) and together_of(whole) is unison and unison.tick == TICK
    beacon = Beacon(
        sender="s4", incarnation=1, tick=TICK, position=(1.0, 1.0), cod=(1.0, 1.0), power_radius=1.0, reach=1.0, column=0, row=0
    )
    for spoilt in ([words[1], words[0], words[2]], [words[0], words[0], words[1]], [*words, beacon]):
        assert together_of(batch(spoilt)) is None


def test_greetings_that_all_say_again_are_known_at_a_glance() -> None:
    peers, sensor = calm(), SENSOR_CLASSES["B"]
    greetings = [msgspec.structs.replace(hello(name), sensor=sensor) for name in ("s1", "s2", "s3")]
    known = together_of(batch([*greetings]))
    assert isinstance(known, Together) and peers.are_all(known)
    other = msgspec.structs.replace(greetings[2], sensor=SENSOR_CLASSES["C"])
    younger = msgspec.structs.replace(greetings[2], incarnation=2)
    for spoilt in ([*greetings[:2], other], [*greetings[:2], younger], greetings[:2]):
        together = together_of(batch([*spoilt]))
        assert together is not None and not peers.are_all(together)
    world = msgspec.structs.replace(greetings[0], sender="world", role="world")
    for strange in ([*greetings, world], [*greetings[:2], hello("s3")]):  # the second does not say what its sensor is
        assert together_of(batch([*strange])) is None
    peers.gone("s3", 1, 0)
    assert not peers.are_all(known)


class Single(Agent):
    """Hears one by one."""

    def hear_together(self, batch: Batch, now: float) -> list[Effect] | None:
        return None


class Counting(Agent):
    """Counts the rounds that it has heard whole."""

    whole = 0

    def hear_together(self, batch: Batch, now: float) -> list[Effect] | None:
        effects = super().hear_together(batch, now)
        Counting.whole += effects is not None
        return effects


@pytest.mark.parametrize("use_codec", [True, False])
def test_a_run_is_the_same_and_nearly_all_of_its_rounds_are_heard_whole(use_codec: bool) -> None:
    Counting.whole = 0
    runs = [Simulation(tracking(), use_codec=use_codec, build=build).run() for build in (Counting, Single)]
    assert runs[0].transcript == runs[1].transcript
    ticks = runs[0].ticks
    assert 7 * (ticks - 3) <= Counting.whole <= 7 * ticks
