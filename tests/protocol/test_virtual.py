"""The virtual bus: time moves only when nothing is left to do, and nodes can be stopped, slowed, doubled and given wrong clocks."""

from dataclasses import dataclass, field

import pytest

from protocol import codec
from protocol.keys import all_of, one_of, tokens_of
from protocol.messages import Command, Gossip, Observation
from protocol.node import Alive, Effect, Event, Gone, Node, Received, Rejected, Started, Stop, Subscribe, Timer, Unsubscribe, messages_of
from protocol.virtual import VirtualBus


@dataclass
class Scribe(Node):
    """A Node that writes down what happens to it, and says what it is told to say."""

    name: str
    incarnation: int = 1
    role: str = "agent"
    run: str = "r"
    due: float | None = None
    events: list[tuple[float, Event]] = field(default_factory=list)
    answers: list[Effect] = field(default_factory=list)  # to the next event
    most: int = 1  # observations that it needs

    def handle(self, event: Event, now: float) -> list[Effect]:
        self.events.append((now, event))
        if isinstance(event, Timer):
            self.due = None
        if isinstance(event, Started):
            return [Subscribe(all_of(self.run, "command")), Subscribe(one_of(self.run, "observation", self.name))]
        answers, self.answers = self.answers, []
        return answers

    @property
    def most_observations(self) -> int:
        return self.most

    def deadline(self) -> float | None:
        return self.due

    def heard(self) -> list[tuple[float, int]]:
        """(time, tick) of every message."""
        return [(now, message.tick) for now, event in self.events for message in messages_of(event)]


class Local(Scribe):
    """Sees the tokens of `b` alone."""

    sees_all_tokens = False

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
    bus._rearm(bus._endpoints[node.name])
    bus.run(bus.now)


def test_a_message_reaches_all_who_subscribed_but_its_sender() -> None:
    one, two, three = Scribe("a"), Scribe("b"), Scribe("c")
    bus = bus_of(one, two, three)
    say(bus, one, command("a", 7))
    assert one.heard() == [] and two.heard() == three.heard() == [(0.0, 7)]
    assert (bus.messages, bus.deliveries, bus.bytes) == (1, 3, len(codec.encode(command("a", 7))))


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
    bus._rearm(bus._endpoints["a"])
    bus.run(2.0)
    bus.add(Scribe("b", incarnation=5))
    bus.run(3.0)
    assert [event for _, event in early.events if isinstance(event, Alive)] == [Alive("agent", "b", 4)]


def test_a_second_subscription_shows_no_token_again_and_outlives_the_end_of_one() -> None:
    local, token = Local("a"), tokens_of("r", "agent", "b")
    bus = bus_of(local)
    bus.add(Scribe("b"))
    bus.run(1.0)
    say(bus, local, Subscribe(token))
    say(bus, local, Unsubscribe(token))
    bus.remove("b")
    bus.run(2.0)
    assert [type(event) for _, event in local.events if isinstance(event, Alive | Gone)] == [Alive, Gone]


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


def test_a_stopped_node_finds_as_many_observations_as_it_needs() -> None:
    world, one = Scribe("world", role="world"), Scribe("a", most=2)
    bus = bus_of(world, one)
    bus.pause("a")
    for tick in (1, 2, 3, 4):
        say(bus, world, observation(tick))
    bus.resume("a")
    bus.run(4.0)
    assert [tick for _, tick in one.heard()] == [3, 4]


def test_a_slow_node_looks_at_nothing_while_it_works_over_a_round() -> None:
    world, one, two = Scribe("world", role="world"), Scribe("a"), Scribe("b")
    bus = bus_of(world, one, two)
    bus.slow("a", lambda: 0.2)
    bus.run(0.0)
    one.answers = [gossip("a", 1)]
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
    bus._rearm(bus._endpoints["a"])
    bus.run(10.0)
    assert [now for now, event in one.events if isinstance(event, Timer)] == [292.5]


def test_after_the_jump_of_a_clock_the_next_event_sets_the_timer_anew() -> None:
    one, two = Scribe("a"), Scribe("b")
    bus = bus_of(one, two)
    one.due = 10.0
    bus._rearm(bus._endpoints["a"])
    bus.jump("a", 4.0)
    say(bus, two, command("b", 5))
    bus.run(20.0)
    assert [now for now, event in one.events if isinstance(event, Timer)] == [10.0]


def test_a_deadline_that_is_taken_back_wakes_nobody() -> None:
    one = Scribe("a")
    bus = bus_of(one)
    for due in (1.0, None):
        one.due = due
        bus._rearm(bus._endpoints["a"])
    bus.run(2.0)
    assert not [event for _, event in one.events if isinstance(event, Timer)]


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
    """Listens to gossips, and says `word` when it is told where it is."""

    word: Gossip | None = None

    def handle(self, event: Event, now: float) -> list[Effect]:
        effects = super().handle(event, now)
        if isinstance(event, Started):
            return [*effects, Subscribe(all_of(self.run, "gossip"))]
        told = any(isinstance(message, Observation) for message in messages_of(event))
        return [self.word] if told and self.word is not None else effects

    def batches(self) -> list[list[str]]:
        """The senders of the gossips, batch by batch."""
        found = [[message.sender for message in messages_of(event) if isinstance(message, Gossip)] for _, event in self.events]
        return [senders for senders in found if senders]


class OfOne(Choir):
    """Listens to the gossips of `b` alone."""

    def handle(self, event: Event, now: float) -> list[Effect]:
        effects = Scribe.handle(self, event, now)
        return [*effects, Subscribe(one_of(self.run, "gossip", "b"))] if isinstance(event, Started) else effects


def choir(*others: Scribe, paused: str = "") -> tuple[VirtualBus, list[Choir]]:
    """Three nodes that speak in one instant, beside others."""
    nodes, world = [Choir(name) for name in ("a", "b", "c")], Scribe("world", role="world")
    bus = bus_of(*nodes, *others, world)
    for node in nodes:
        node.word = gossip(node.name, 1)
    if paused:
        bus.pause(paused)
    told = [Observation(sender="world", incarnation=1, recipient=name, tick=1, time=1.0, pose=(0.0, 0.0, 0.0)) for name in "abc"]
    say(bus, world, *told)
    return bus, nodes


def test_gossips_that_all_say_in_an_instant_come_as_one_batch_that_all_share() -> None:
    _, nodes = choir()
    assert [node.batches() for node in nodes] == [[["a", "b", "c"]]] * 3
    batches = [event.batch for node in nodes for _, event in node.events if isinstance(event, Received) and event.batch.kind is Gossip]
    assert len(batches) == 3 and len(set(map(id, batches))) == 1


def test_a_gossip_that_comes_alone_does_not_reach_its_sender() -> None:
    bus, (one, two, _) = choir()
    say(bus, one, gossip("a", 2))
    assert one.batches() == [["a", "b", "c"]] and two.batches() == [["a", "b", "c"], ["a"]]


def test_of_gossips_that_are_said_in_one_instant_each_listener_gets_those_that_it_asked_for() -> None:
    listener = OfOne("d")
    _, nodes = choir(listener)
    assert listener.batches() == [["b"]] and [node.batches() for node in nodes] == [[["b", "c"]], [["a", "c"]], [["a", "b"]]]


def test_who_is_paused_finds_the_batch_later_and_what_it_says_then_comes_alone() -> None:
    bus, nodes = choir(paused="c")
    assert [node.batches() for node in nodes] == [[["a", "b"]], [["a", "b"]], []]
    bus.resume("c")
    bus.run(bus.now)
    assert [node.batches() for node in nodes] == [[["a", "b"], ["c"]], [["a", "b"], ["c"]], [["a", "b"]]]


def test_a_bus_without_batches_hands_over_one_by_one_and_nobody_its_own_word() -> None:
    bus, nodes = bus_of(), [Choir(name) for name in ("a", "b", "c")]
    bus.batches = False
    for node in nodes:
        bus.add(node)
    bus.run(0.0)
    nodes[0].answers, nodes[1].answers = [gossip("a", 1)], [gossip("b", 1)]
    bus.jump("a", 0.0)
    world = Scribe("world", role="world", answers=[])
    bus.add(world)
    bus.run(1.0)
    assert all(len(senders) == 1 and senders != [node.name] for node in nodes for senders in node.batches())
    assert any(node.batches() for node in nodes)


def starved(seconds: float) -> tuple[VirtualBus, Scribe, Choir]:
    """A node whose round takes `seconds` and one that hears its gossips; at 0 s its round of tick 1 begins."""
    world, one, two = Scribe("world", role="world"), Scribe("a"), Choir("b")
    bus = bus_of(world, one, two)
    bus.slow("a", lambda: seconds, published_after=0.5)
    one.answers = [gossip("a", 1)]
    say(bus, world, observation(1))
    return bus, one, two


def test_a_node_that_is_paused_in_mid_round_says_what_it_has_computed_when_it_goes_on() -> None:
    bus, _, two = starved(2.0)
    bus.pause("a")
    bus.run(1.5)
    assert two.heard() == []
    bus.resume("a")
    bus.run(1.5)
    assert two.heard() == [(1.5, 1)]


def test_a_frozen_machine_says_nothing_and_what_its_nodes_had_computed_leaves_when_it_goes_on() -> None:
    bus, _, two = starved(2.0)
    before = bus.messages
    bus.freeze(3.0)
    bus.run(2.9)
    assert bus.messages == before
    bus.run(3.1)
    assert two.heard() == [(3.0, 1)]


def test_who_is_killed_in_mid_round_never_says_what_it_has_computed() -> None:
    bus, _, two = starved(2.0)
    bus.remove("a")
    bus.run(5.0)
    assert two.heard() == []


def test_a_node_that_is_paused_while_all_are_frozen_stays_so_and_one_that_is_resumed_goes_on_with_all() -> None:
    world, one, two = Scribe("world", role="world"), Scribe("a"), Scribe("b")
    bus = bus_of(world, one, two)
    bus.pause("b")
    bus.freeze(2.0)
    bus.pause("a")
    bus.resume("b")
    bus.call_later(1.0, lambda: bus.announce(Gone("agent", "c", 1)))
    bus.run(5.0)
    assert not any(isinstance(event, Gone) for _, event in one.events)
    assert two.events[-1] == (2.0, Gone("agent", "c", 1))
    bus.resume("a")
    bus.run(5.0)
    assert one.events[-1] == (5.0, Gone("agent", "c", 1))


@pytest.mark.parametrize("spans", [(1.0, 4.0), (4.0, 1.0)])
def test_of_two_freezes_at_a_time_the_one_that_ends_later_counts(spans: tuple[float, float]) -> None:
    one = Scribe("a")
    bus = bus_of(one)
    for seconds in spans:
        bus.freeze(seconds)
    bus.announce(Gone("agent", "c", 1))
    bus.run(9.0)
    assert one.events[-1] == (4.0, Gone("agent", "c", 1))
