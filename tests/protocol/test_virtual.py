"""The virtual bus: time moves only when nothing is left to do, and nodes can be stopped, slowed, doubled and given wrong clocks."""

from dataclasses import dataclass, field

import pytest

from protocol.keys import all_of, one_of, tokens_of
from protocol.messages import Command, Gossip, Message, Observation
from protocol.node import QUIET, Alive, Batch, Effect, Event, Gone, Received, Rejected, Started, Stop, Subscribe, Timer, Unsubscribe
from protocol.virtual import VirtualBus


@dataclass
class Scribe:
    """A Node that writes down what happens to it, and says what it is told to say."""

    name: str
    incarnation: int = 1
    role: str = "agent"
    run: str = "r"
    due: float | None = None
    events: list[tuple[float, Event]] = field(default_factory=list)
    answers: list[Effect] = field(default_factory=list)  # to the next event

    def handle(self, event: Event, now: float) -> list[Effect]:
        self.events.append((now, event))
        if isinstance(event, Timer):
            self.due = None
        if isinstance(event, Started):
            return [Subscribe(all_of(self.run, "command")), Subscribe(one_of(self.run, "observation", self.name))]
        answers, self.answers = self.answers, []
        return answers

    def deadline(self) -> float | None:
        return self.due

    def heard(self) -> list[tuple[float, int]]:
        """(time, tick) of every message."""
        return [(now, event.message.tick) for now, event in self.events if isinstance(event, Received)]


class Local(Scribe):
    """Sees the tokens of `b` alone."""

    local = True

    def handle(self, event: Event, now: float) -> list[Effect]:
        effects = super().handle(event, now)
        return [*effects, Subscribe(tokens_of(self.run, "agent", "b"))] if isinstance(event, Started) else effects


def command(sender: str, tick: int) -> Command:
    return Command(sender=sender, incarnation=1, tick=tick, velocity=(1.0, 0.0), turn_rate=0.0)


def observation(tick: int) -> Observation:
    return Observation(sender="world", incarnation=1, recipient="a", tick=tick, time=float(tick), pose=(0.0, 0.0, 0.0))


def bus_of(*nodes: Scribe) -> VirtualBus:
    bus = VirtualBus()
    for node in nodes:
        bus.add(node)
    bus.run(0.0)
    return bus


def say(bus: VirtualBus, node: Scribe, *messages: Effect) -> None:
    """Let a node publish at this time."""
    node.answers = list(messages)
    node.due = bus.now
    bus._rearm(bus._seats[node.name])
    bus.run(bus.now)


def test_a_message_reaches_all_who_subscribed_but_its_sender() -> None:
    one, two, three = Scribe("a"), Scribe("b"), Scribe("c")
    bus = bus_of(one, two, three)
    say(bus, one, command("a", 7))
    assert one.heard() == [] and two.heard() == three.heard() == [(0.0, 7)]
    assert (bus.messages, bus.deliveries) == (1, 3)


def test_tokens_are_seen_by_all_others_when_a_node_comes_and_when_it_goes() -> None:
    one, two = Scribe("a"), Scribe("b", incarnation=4)
    bus = bus_of(one, two)
    bus.remove("b", notice_after=2.0)
    bus.run(5.0)
    assert [(now, event) for now, event in one.events if not isinstance(event, Started)] == [
        (0.0, Alive("agent", "b", 4)),
        (2.0, Gone("agent", "b", 4)),
    ]
    with pytest.raises(ValueError, match="already"):
        bus.add(Scribe("a"))


def test_a_local_node_sees_the_tokens_that_it_asks_for_and_everybody_else_sees_its_own() -> None:
    early, other, late = Local("a"), Scribe("c"), Local("d")
    bus = bus_of(early, other)
    bus.add(Scribe("b", incarnation=4))
    bus.add(late)
    bus.run(1.0)
    bus.remove("c")
    bus.remove("b")
    bus.run(2.0)
    seen = [(now, event) for now, event in early.events if isinstance(event, Alive | Gone)]
    assert seen == [(0.0, Alive("agent", "b", 4)), (1.0, Gone("agent", "b", 4))]
    assert [event for _, event in late.events if isinstance(event, Alive | Gone)] == [Alive("agent", "b", 4), Gone("agent", "b", 4)]
    assert [event.name for _, event in other.events if isinstance(event, Alive)] == ["a", "b", "d"]
    early.answers, early.due = [Unsubscribe(tokens_of("r", "agent", "b"))], bus.now
    bus._rearm(bus._seats["a"])
    bus.run(2.0)
    bus.add(Scribe("b", incarnation=5))
    bus.run(3.0)
    assert [event for _, event in early.events if isinstance(event, Alive)] == [Alive("agent", "b", 4)]


def test_a_stopped_node_finds_all_that_arrived_but_of_observations_the_newest_only() -> None:
    world, one, two = Scribe("world", role="world"), Scribe("a"), Scribe("b")
    bus = bus_of(world, one, two)
    bus.pause("a")
    for tick in (1, 2, 3):
        say(bus, world, observation(tick))
        say(bus, two, command("b", tick))
    bus.run(4.0)
    assert one.heard() == []
    bus.resume("a")
    bus.run(4.0)
    assert one.heard() == [(4.0, 1), (4.0, 2), (4.0, 3), (4.0, 3)]


def test_a_slow_node_looks_at_nothing_while_it_works_over_an_observation() -> None:
    world, one, two = Scribe("world", role="world"), Scribe("a"), Scribe("b")
    bus = bus_of(world, one, two)
    bus.slow("a", 0.2)
    say(bus, world, observation(1))
    say(bus, two, command("b", 1))
    bus.run(0.1)
    assert one.heard() == [(0.0, 1)]
    bus.run(1.0)
    assert one.heard() == [(0.0, 1), (0.2, 1)]


def test_a_clock_that_jumps_shows_in_the_time_a_node_is_told_and_moves_no_message() -> None:
    one, two = Scribe("a"), Scribe("b")
    bus = bus_of(one, two)
    bus.jump("a", 288.0)
    bus.run(3.0)
    say(bus, two, command("b", 5))
    assert one.heard() == [(291.0, 5)]
    one.due = 292.5
    bus._rearm(bus._seats["a"])
    bus.run(10.0)
    assert [now for now, event in one.events if isinstance(event, Timer)] == [292.5]


def test_two_nodes_may_have_one_name_and_one_that_stops_leaves_the_other() -> None:
    older, younger = Scribe("a", incarnation=1), Scribe("a", incarnation=2)
    bus = VirtualBus()
    bus.add(older)
    bus.add(younger, "a#2")
    bus.run(0.0)
    assert (0.0, Alive("agent", "a", 2)) in older.events and (0.0, Alive("agent", "a", 1)) in younger.events
    say(bus, older, Stop(3, "fenced"))
    bus.run(1.0)
    assert bus.nodes() == ["a#2"] and bus.stopped == {"a": Stop(3, "fenced")}
    assert (0.0, Gone("agent", "a", 1)) in younger.events


def test_what_a_link_does_to_bytes_is_what_arrives() -> None:
    class Half:
        def carry(self, sender: str, receiver: str, key: str, payload: bytes, now: float) -> list[tuple[float, bytes]]:
            return [(1.0, payload), (2.0, payload[:3])] if receiver == "b" else []

    one, two, three = Scribe("a"), Scribe("b"), Scribe("c")
    bus = VirtualBus(link=Half())
    for node in (one, two, three):
        bus.add(node)
    bus.run(0.0)
    say(bus, one, command("a", 9))
    bus.run(5.0)
    assert two.heard() == [(1.0, 9)] and three.heard() == []
    assert (2.0, Rejected("a", "format")) in two.events


def gossip(sender: str, tick: int) -> Gossip:
    return Gossip(sender=sender, incarnation=1, tick=tick, pose=(1.0, 2.0, 0.0), cod=(1.0, 2.0), power_radius=1.0, unused=4.0)


class Choir(Scribe):
    """Takes what comes in an instant at once, and a batch of gossips whole, unless it has a mind of its own; says `word` when told."""

    whole: bool = True
    word: Gossip | None = None

    def handle(self, event: Event, now: float) -> list[Effect]:
        effects = super().handle(event, now)
        if isinstance(event, Started):
            return [*effects, Subscribe(all_of(self.run, "gossip"))]
        told = isinstance(event, Received) and isinstance(event.message, Observation)
        return [self.word] if told and self.word is not None else effects

    def take_all(self, messages: list[Message], now: float) -> list[Effect]:
        self.parts().append(("one by one", [message.sender for message in messages]))
        return QUIET

    def hear_together(self, batch: Batch, now: float) -> list[Effect] | None:
        if not self.whole:
            return None
        self.parts().append(("whole", [event.message.sender for event in batch.events]))
        return QUIET

    def parts(self) -> list[tuple[str, list[str]]]:
        """What came, and how."""
        parts: list[tuple[str, list[str]]] = self.__dict__.setdefault("_parts", [])
        return parts


def test_gossips_that_all_say_in_an_instant_come_as_one_batch_to_who_can_take_it() -> None:
    nodes = [Choir(name) for name in ("a", "b", "c")]
    nodes[1].whole = False
    world = Scribe("world", role="world")
    bus = bus_of(*nodes, world)
    bus.pause("c")
    for node in nodes:
        node.word = gossip(node.name, 1)
    told = [Observation(sender="world", incarnation=1, recipient=name, tick=1, time=1.0, pose=(0.0, 0.0, 0.0)) for name in "abc"]
    say(bus, world, *told)
    assert nodes[0].parts() == [("whole", ["a", "b"])]
    assert nodes[1].parts() == [("one by one", ["a"])]
    assert nodes[2].parts() == [] and bus.messages == 5
    bus.resume("c")
    bus.run(bus.now)
    others = [event.message.sender for _, event in nodes[2].events if isinstance(event, Received) and isinstance(event.message, Gossip)]
    assert others == ["a", "b"]
    assert nodes[0].parts()[1:] == nodes[1].parts()[1:] == [("one by one", ["c"])]
