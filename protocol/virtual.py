"""The virtual driver: many nodes in one process and in virtual time, on a bus of events.

Events of one instant are delivered in the order of their creation. Gossips, beacons, Hellos and estimates come after all other events,
and each receiver takes its own in batches. Time advances only when no event of the instant is left. Each message is encoded and decoded
once, as real bytes. A `Link` may drop, delay, copy or corrupt them per receiver. Nodes can be stopped, slowed down, started twice under
one name, and given clocks that jump.
"""

import heapq
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from protocol import codec
from protocol.delivery import MAILBOX_KINDS, BusEndpoint, Delivery, Item, order_of_joining
from protocol.keys import is_of_tokens, message_key, tokens_of
from protocol.message import Message
from protocol.messages import Command, Gossip
from protocol.node import NO_EFFECTS, Alive, Effect, Event, Gone, Node, Started, Stop, Subscribe, Timer, Unsubscribe
from protocol.reception import event_of, read_all
from protocol.subscription_index import SubscriptionIndex


class Link(Protocol):
    """The faults between two nodes."""

    def carry(self, sender: str, receiver: str, key: str, payload: bytes, now: float) -> Sequence[tuple[float, bytes]]:
        """(delay s, payload) of each copy that arrives; the same object `payload` unless the copy is corrupt."""


@dataclass
class _Call:
    """The event that a function is due."""

    function: Callable[[], None]


_Entry = tuple[BusEndpoint, Item] | Delivery | _Call  # of the queue


class VirtualBus:
    """The driver of all nodes of a simulation: it hands them events in the order of time, and carries out their effects; `now` is in s."""

    def __init__(self, *, link: Link | None = None, command_delay: float = 0.0) -> None:
        """`command_delay`: the delay of every Command, s, so that time passes in a world that waits for nothing else."""
        self.now = 0.0
        self.stopped: dict[str, Stop] = {}  # label -> reason, of nodes that left by themselves
        self.messages = 0  # published
        self.deliveries = 0
        self.bytes = 0  # published
        self.tap: Callable[[Node, Event], None] | None = None  # called after a node has taken an event
        self.apart: Callable[[str, str], bool] = lambda one, other: False  # whether two labels have no session, and see no token
        self.batches = True  # messages of one instant are handed over together; False: one by one, for comparison
        self.link = link  # between all nodes from now on; None: every message arrives at once
        self._command_delay = command_delay
        self._endpoints: dict[str, BusEndpoint] = {}
        self._ready: deque[_Entry] = deque()
        self._with_mail: list[BusEndpoint] = []  # endpoints with a mailbox that may hold messages
        self._later: list[tuple[float, int, _Entry]] = []
        self._sequence = 0
        self._frozen_until: float | None = None  # s; None: the nodes are not frozen
        self._subscriptions: SubscriptionIndex[BusEndpoint] = SubscriptionIndex(order_of_joining)  # of messages
        self._all_seeing: dict[BusEndpoint, None] = {}  # endpoints that see every token
        self._holders: dict[str, dict[BusEndpoint, None]] = {}  # endpoints by role and name, as part of the token key
        self._watchers: SubscriptionIndex[BusEndpoint] = SubscriptionIndex(order_of_joining)  # of tokens, but for `_all_seeing`

    def nodes(self) -> list[str]:
        """Labels of the nodes on the bus, paused ones included."""
        return list(self._endpoints)

    def add(self, node: Node, label: str | None = None) -> None:
        """Start a node: it and the others see each other's liveliness tokens, unless they are `apart`.

        Only a second node of the same name needs a label.
        """
        label = node.name if label is None else label
        if label in self._endpoints:
            raise ValueError(f"{label} is on the bus already")
        self._sequence += 1
        endpoint = self._endpoints[label] = BusEndpoint(node, label, self._sequence)
        self._ready.append((endpoint, Started()))
        self._holders.setdefault(_parent(endpoint.token), {})[endpoint] = None
        if node.sees_all_tokens:
            self._all_seeing[endpoint] = None
        watching = self._watching(endpoint.token)
        for other in self._endpoints.values() if node.sees_all_tokens else watching:
            if other is not endpoint and not self.apart(label, other.label):
                if node.sees_all_tokens:
                    self._ready.append((endpoint, Alive(other.node.role, other.node.name, other.node.incarnation)))
                if other in watching:
                    self._ready.append((other, Alive(node.role, node.name, node.incarnation)))

    def remove(self, name: str, *, notice_after: float | None = 0.0) -> Node:
        """Kill a node: the others see its token vanish after `notice_after` s (None: never)."""
        endpoint = self._endpoints.pop(name)
        endpoint.paused, endpoint.waiting = True, []
        self._all_seeing.pop(endpoint, None)
        del self._holders[_parent(endpoint.token)][endpoint]
        for expression in endpoint.expressions:
            (self._watchers if is_of_tokens(expression) else self._subscriptions).remove(expression, endpoint)
        if notice_after is not None:
            self.announce(Gone(endpoint.node.role, endpoint.node.name, endpoint.node.incarnation), notice_after)
        return endpoint.node

    def announce(self, event: Alive | Gone, delay: float = 0.0, to: Iterable[str] | None = None) -> None:
        """Show a token that appears or vanishes to all nodes but the subject, or to those named, if they subscribe to it."""
        named = {self._endpoints[label] for label in to if label in self._endpoints} if to is not None else self._endpoints.values()
        for endpoint in sorted(named, key=order_of_joining):
            node = endpoint.node
            subject = (node.role, node.name, node.incarnation) == (event.role, event.name, event.incarnation)
            if not subject and (node.sees_all_tokens or tokens_of(node.run, event.role, event.name) in endpoint.expressions):
                self._schedule(endpoint, event, delay)

    def pause(self, name: str) -> None:
        """Pause a node (SIGSTOP); its arrivals are kept, and what it has computed but not published yet."""
        self._endpoints[name].paused = True

    def resume(self, name: str) -> None:
        """Resume a paused node (SIGCONT); it publishes and takes what was kept."""
        endpoint = self._endpoints[name]
        endpoint.paused = False
        self._wake(endpoint)

    def jump(self, name: str, seconds: float) -> None:
        """Set a node's clock forward or back; its timer stays."""
        self._endpoints[name].clock += seconds
        self._endpoints[name].armed = None

    def slow(self, name: str, seconds: Callable[[], float] | None, published_after: float = 0.0) -> None:
        """Let every round of a node, from its gossip on, take the seconds that a function draws; None: no time.

        The effects come out after the share `published_after` of that. The node takes no other event before the end.
        """
        self._endpoints[name].work, self._endpoints[name].published_after = seconds, published_after

    def freeze(self, seconds: float) -> None:
        """Stop all nodes at once for some seconds: a machine that stands still. Of two freezes at a time the later end counts."""
        self._frozen_until = max(self._frozen_until or 0.0, self.now + seconds)
        self.call_later(seconds, self._thaw)

    def _thaw(self) -> None:
        if self._frozen_until is None or self.now < self._frozen_until:
            return
        self._frozen_until = None
        for endpoint in list(self._endpoints.values()):
            self._wake(endpoint)

    def _stands_still(self, endpoint: BusEndpoint) -> bool:
        """Whether a node is paused, frozen or gone: nothing reaches it, and nothing leaves it."""
        return endpoint.paused or self._frozen_until is not None

    def _wake(self, endpoint: BusEndpoint) -> None:
        """Carry out what a node had computed, and hand it the events that waited, of observations only the newest."""
        if self._stands_still(endpoint):
            return
        effects, endpoint.unpublished = endpoint.unpublished, []
        self._carry_out_all(endpoint, effects)
        if endpoint.at_work:
            return
        self._ready.extendleft((endpoint, event) for event in reversed(endpoint.catch_up()))
        self._rearm(endpoint)

    def run(self, until: float) -> None:
        """Deliver all events up to the time `until`, and set the time to it."""
        while self.step(until):
            pass
        self.now = max(self.now, until)

    def step(self, until: float = float("inf")) -> bool:
        """Deliver the next event that is due by `until`, a message to all its listeners; False when there is none."""
        while not self._ready:
            if self._with_mail:
                self._empty_mailboxes()
            elif not self._advance(until):
                return False
        entry = self._ready.popleft()
        if isinstance(entry, Delivery):
            self._deliver(entry)
        elif isinstance(entry, _Call):
            entry.function()
        else:
            self._hand(entry[0], event_of(entry[1]))
        return True

    def _deliver(self, delivery: Delivery) -> None:
        """Hand a message to all its listeners; those of kinds in `MAILBOX_KINDS` go into their mailboxes."""
        if delivery.kind not in MAILBOX_KINDS:
            [item] = read_all([(delivery.key, delivery.payload)])
            event = event_of(item)
            for endpoint in delivery.listeners:
                if endpoint is not delivery.sender:
                    self._hand(endpoint, event)
            return
        for group in delivery.with_followers(self._ready, most=None if self.batches else 1):
            only_sender = group.said[0][0] if len(group.said) == 1 else None  # to whom a single message is not handed back
            for endpoint in group.listeners:
                if endpoint is not only_sender:
                    if not endpoint.mailbox:
                        self._with_mail.append(endpoint)
                    endpoint.mailbox.append(group)

    def _empty_mailboxes(self) -> None:
        """Hand every listener the messages of its mailbox, one listener after the other; no other event of this instant is left.

        A node that takes all its messages in a row is fetched into the processor's caches once, not for every message.
        """
        endpoints, self._with_mail = self._with_mail, []
        for endpoint in endpoints:
            self._empty_mailbox(endpoint)

    def _empty_mailbox(self, endpoint: BusEndpoint) -> None:
        if self.batches:
            events = endpoint.empty_mailbox()
        else:
            events = [event for group in endpoint.mailbox for event in group.events]
            endpoint.mailbox = []
        for event in events:
            self._hand(endpoint, event)

    def _hand(self, endpoint: BusEndpoint, event: Event) -> None:
        """Hand a node an event, or keep the event while the node stands still or is at work."""
        if endpoint.mailbox:
            self._empty_mailbox(endpoint)
        if endpoint.at_work or self._stands_still(endpoint):
            if not isinstance(event, Timer):
                endpoint.waiting.append(event)
            return
        effects = endpoint.handle(event, self._time_of(endpoint) if endpoint.clock else self.now)
        if endpoint.work is not None and any(isinstance(effect, Gossip) for effect in effects):
            self._begin_work(endpoint, effects, endpoint.work())
        else:
            self._carry_out_all(endpoint, effects)
        if self.tap is not None:
            self.tap(endpoint.node, event)
        if endpoint.at_work or (effects is NO_EFFECTS and endpoint.armed is not None):
            return
        if endpoint.deadline() != endpoint.armed:
            self._rearm(endpoint)

    def _begin_work(self, endpoint: BusEndpoint, effects: list[Effect], seconds: float) -> None:
        """Let a node be at work for some seconds. Its effects come out in time, or when it wakes after that."""

        def publish() -> None:
            endpoint.unpublished = effects
            self._wake(endpoint)

        endpoint.at_work = True
        if endpoint.published_after > 0.0:
            self.call_later(endpoint.published_after * seconds, publish)
        else:
            self._carry_out_all(endpoint, effects)
        self.call_later(seconds, partial(self._end_work, endpoint))

    def _end_work(self, endpoint: BusEndpoint) -> None:
        endpoint.at_work = False
        self._wake(endpoint)

    def _time_of(self, endpoint: BusEndpoint) -> float:
        """The time of a node's clock; rounded up to a deadline within 1 us, because its timer would fire for ever otherwise."""
        now = self.now + endpoint.clock
        due = endpoint.deadline()
        return due if due is not None and 0.0 < due - now < 1e-6 else now

    def _advance(self, until: float) -> bool:
        while self._later and self._later[0][0] <= (self.now if self._ready else until):  # ready events come before a later time
            time, _, entry = heapq.heappop(self._later)
            if isinstance(entry, tuple) and isinstance(entry[1], Timer):
                if entry[0].timer != time:
                    continue
                entry[0].timer = entry[0].armed = None
            self.now = time
            self._ready.append(entry)
        return bool(self._ready)

    def call_later(self, delay: float, function: Callable[[], None]) -> None:
        """Call a function in `delay` s."""
        self._push(self.now + delay, _Call(function))

    def _schedule(self, endpoint: BusEndpoint, event: Item, delay: float) -> None:
        if delay <= 0.0:
            self._ready.append((endpoint, event))
        else:
            self._push(self.now + delay, (endpoint, event))

    def _push(self, time: float, entry: _Entry) -> None:
        self._sequence += 1
        heapq.heappush(self._later, (time, self._sequence, entry))

    def _rearm(self, endpoint: BusEndpoint) -> None:
        deadline = endpoint.armed = endpoint.deadline()
        if deadline is None:
            endpoint.timer = None
        elif endpoint.timer is None or deadline - endpoint.clock != endpoint.timer:
            endpoint.timer = max(deadline - endpoint.clock, self.now)
            self._push(endpoint.timer, (endpoint, Timer()))

    def _carry_out_all(self, endpoint: BusEndpoint, effects: list[Effect]) -> None:
        for effect in effects:
            self._carry_out(endpoint, effect)

    def _carry_out(self, endpoint: BusEndpoint, effect: Effect) -> None:
        if isinstance(effect, Message):
            self._publish(endpoint, effect)
        elif isinstance(effect, Subscribe):
            self._subscribe(endpoint, effect.expression)
        elif isinstance(effect, Unsubscribe):
            self._unsubscribe(endpoint, effect.expression)
        elif isinstance(effect, Stop) and self._endpoints.get(endpoint.label) is endpoint:
            self.stopped[endpoint.label] = effect
            self.remove(endpoint.label)  # a Reopen has no effect: no session of this bus is ever half open

    def _subscribe(self, endpoint: BusEndpoint, expression: str) -> None:
        endpoint.expressions[expression] += 1
        if endpoint.expressions[expression] > 1:
            return
        if not is_of_tokens(expression):
            self._subscriptions.add(expression, endpoint)
            return
        self._watchers.add(expression, endpoint)
        for other in self._holders.get(_parent(expression), {}):
            if other is not endpoint and not self.apart(endpoint.label, other.label):
                self._ready.append((endpoint, Alive(other.node.role, other.node.name, other.node.incarnation)))

    def _unsubscribe(self, endpoint: BusEndpoint, expression: str) -> None:
        endpoint.expressions[expression] -= 1
        if endpoint.expressions[expression] == 0:
            del endpoint.expressions[expression]
            (self._watchers if is_of_tokens(expression) else self._subscriptions).remove(expression, endpoint)

    def _watching(self, token: str) -> dict[BusEndpoint, None]:
        """The endpoints that see a token, in the order in which they were added."""
        watching = self._watchers.listeners(token)
        return dict.fromkeys(sorted([*self._all_seeing, *watching], key=order_of_joining)) if watching else self._all_seeing

    def _publish(self, endpoint: BusEndpoint, message: Message) -> None:
        key = message_key(endpoint.node.run, message)
        listeners = self._subscriptions.listeners(key)
        payload = codec.encode(message)
        self.messages += 1
        self.bytes += len(payload)
        held = self._command_delay if isinstance(message, Command) else 0.0
        if self.link is None and held == 0.0:
            self._ready.append(Delivery(listeners, endpoint, type(message), key, payload))
            self.deliveries += len(listeners)
            return
        at_once: list[BusEndpoint] = []
        decoded: Item | None = None  # for listeners that it reaches later
        for listener in listeners:
            if listener is not endpoint:
                for delay, arrived in self._carried(endpoint, listener, key, payload):
                    self.deliveries += 1
                    if arrived is not payload:
                        [corrupt] = read_all([(key, arrived)])
                        self._schedule(listener, corrupt, held + delay)
                    elif held + delay <= 0.0:
                        at_once.append(listener)
                    else:
                        decoded = decoded or read_all([(key, payload)])[0]
                        self._schedule(listener, decoded, held + delay)
        if at_once:
            self._ready.append(Delivery(at_once, endpoint, type(message), key, payload))

    def _carried(self, endpoint: BusEndpoint, listener: BusEndpoint, key: str, payload: bytes) -> Sequence[tuple[float, bytes]]:
        if self.link is None:
            return [(0.0, payload)]
        return self.link.carry(endpoint.node.name, listener.node.name, key, payload, self.now)


def _parent(key: str) -> str:
    return key.rpartition("/")[0]
