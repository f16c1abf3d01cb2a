"""The virtual driver: many nodes in one process and in virtual time, on a bus of events.

Events of one instant are delivered first come, first served, but what is said to many after all others, that of a listener together;
time moves on only when none is left. The real bytes travel: each message is encoded and decoded once. A `Link` may drop, delay, copy or
spoil them per receiver. Nodes can be stopped, slowed down, started twice under one name, and given clocks that jump.
"""

import heapq
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from protocol import codec
from protocol.delivery import TO_MANY, BusEndpoint, Delivery, Item, MessageRun, is_observation, place_of
from protocol.keys import is_of_tokens, message_key, tokens_of
from protocol.messages import Command, Message
from protocol.node import NO_EFFECTS, Alive, Effect, Event, Gone, Node, Started, Stop, Subscribe, Timer, Unsubscribe
from protocol.reception import in_batches, read
from protocol.routes import Routes


class Link(Protocol):
    """What lies between two nodes."""

    def carry(self, sender: str, receiver: str, key: str, payload: bytes, now: float) -> Sequence[tuple[float, bytes]]:
        """(delay s, payload) of each copy that arrives; the very object `payload` where nothing was spoilt."""


class _Done:
    """A slow node has finished its work."""


@dataclass
class _Call:
    """A function whose time has come."""

    function: Callable[[], None]


_Entry = tuple[BusEndpoint, Item | _Done] | Delivery | _Call  # of the queue


class VirtualBus:
    """Drives nodes in virtual time; `now` is in s."""

    def __init__(self, *, link: Link | None = None, pace: float = 0.0) -> None:
        """`pace`: how long every Command is on its way, s, so that time passes in a world that waits for nothing else."""
        self.now = 0.0
        self.stopped: dict[str, Stop] = {}  # who left by itself, and why
        self.messages = 0  # published
        self.deliveries = 0
        self.bytes = 0  # published
        self.tap: Callable[[Node, Event], None] | None = None  # called when a node has taken an event
        self.batches = True  # messages that come in one instant are handed over together; False: one by one, for comparison
        self._link = link
        self._pace = pace
        self._seats: dict[str, BusEndpoint] = {}
        self._ready: deque[_Entry] = deque()
        self._boxed: list[BusEndpoint] = []  # whose box may hold something
        self._later: list[tuple[float, int, _Entry]] = []
        self._sequence = 0
        self._routes: Routes[BusEndpoint] = Routes(place_of)  # of messages
        self._all_seeing: dict[BusEndpoint, None] = {}  # who sees every token
        self._holders: dict[str, dict[BusEndpoint, None]] = {}  # of tokens, by role and name
        self._watchers: Routes[BusEndpoint] = Routes(place_of)  # of tokens, by those who do not see all of them

    def nodes(self) -> list[str]:
        """Labels of the nodes on the bus, paused ones included."""
        return list(self._seats)

    def add(self, node: Node, label: str | None = None) -> None:
        """Start a node: it and the others see each other's liveliness tokens. Only a second node of a name needs a label of its own."""
        label = node.name if label is None else label
        if label in self._seats:
            raise ValueError(f"{label} is on the bus already")
        self._sequence += 1
        seat = self._seats[label] = BusEndpoint(node, self._sequence)
        self._ready.append((seat, Started()))
        self._holders.setdefault(_parent(seat.token), {})[seat] = None
        if seat.node.sees_all_tokens:
            self._all_seeing[seat] = None
        watching = self._watching(seat.token)
        for other in self._seats.values() if seat.node.sees_all_tokens else watching:
            if other is not seat:
                if seat.node.sees_all_tokens:
                    self._ready.append((seat, Alive(other.node.role, other.node.name, other.node.incarnation)))
                if other in watching:
                    self._ready.append((other, Alive(node.role, node.name, node.incarnation)))

    def remove(self, name: str, *, notice_after: float | None = 0.0) -> Node:
        """Kill a node: it vanishes; the others see its token go after `notice_after` s (None: never)."""
        seat = self._seats.pop(name)
        seat.paused, seat.waiting = True, []
        self._all_seeing.pop(seat, None)
        del self._holders[_parent(seat.token)][seat]
        for expression in seat.expressions:
            (self._watchers if is_of_tokens(expression) else self._routes).remove(expression, seat)
        if notice_after is not None:
            self.announce(Gone(seat.node.role, seat.node.name, seat.node.incarnation), notice_after)
        return seat.node

    def announce(self, event: Alive | Gone, delay: float = 0.0, to: Iterable[str] | None = None) -> None:
        """Let nodes (all but the subject, or those named) see a token appear or vanish, if they look for it."""
        named = {self._seats[label] for label in to if label in self._seats} if to is not None else self._seats.values()
        for seat in sorted(named, key=place_of):
            subject = (seat.node.name, seat.node.incarnation) == (event.name, event.incarnation)
            if not subject and (seat.node.sees_all_tokens or tokens_of(seat.node.run, event.role, event.name) in seat.expressions):
                self._schedule(seat, event, delay)

    def pause(self, name: str) -> None:
        """Stop a node in its tracks (SIGSTOP); what arrives is kept."""
        self._seats[name].paused = True

    def resume(self, name: str) -> None:
        """Let a paused node go on; it finds all that has arrived."""
        seat = self._seats[name]
        seat.paused = False
        self._wake(seat)

    def jump(self, name: str, seconds: float) -> None:
        """Set a node's clock forward or back; what it has set its timer to stays."""
        self._seats[name].clock += seconds
        self._seats[name].armed = None

    def slow(self, name: str, seconds: float) -> None:
        """From now on a node takes `seconds` of work over every observation and looks at nothing else meanwhile; 0: none."""
        self._seats[name].work = seconds

    def _wake(self, seat: BusEndpoint) -> None:
        """Hand a node what has waited for it; of observations the newest only, for nobody works off a queue of them."""
        if seat.paused or seat.at_work:
            return
        self._ready.extendleft((seat, event) for event in reversed(seat.catch_up()))
        self._rearm(seat)

    def run(self, until: float) -> None:
        """Deliver everything that is due up to the time `until`, which is then the time."""
        while self.step(until):
            pass
        self.now = max(self.now, until)

    def step(self, until: float = float("inf")) -> bool:
        """Deliver the next event that is due by `until`, a message to all its listeners; False when there is none."""
        while not self._ready:
            if self._boxed:
                self._empty_boxes()
            elif not self._advance(until):
                return False
        entry = self._ready.popleft()
        if isinstance(entry, Delivery):
            self._deliver(entry)
        elif isinstance(entry, _Call):
            entry.function()
        elif isinstance(entry[1], _Done):
            entry[0].at_work = False
            self._wake(entry[0])
        else:
            for event in in_batches([entry[1]]):
                self._hand(entry[0], event)
        return True

    def _deliver(self, delivery: Delivery) -> None:
        """Bring a message to all its listeners; what is said to many goes into their boxes."""
        if delivery.kind not in TO_MANY:
            for event in in_batches([delivery.item]):
                for seat in delivery.listeners:
                    if seat is not delivery.sender:
                        self._hand(seat, event)
            return
        run = delivery.with_followers(self._ready) if self.batches else MessageRun(delivery.sender, delivery.item)
        for seat in delivery.listeners:
            if len(run.items) > 1 or seat is not delivery.sender:
                if not seat.box:
                    self._boxed.append(seat)
                seat.box.append(run)

    def _empty_boxes(self) -> None:
        """Nothing else is left of this instant: let everybody take what has come, one listener after the other.

        With all that a node has heard in hand at once it is not fetched into the caches of the machine anew for every message.
        """
        seats, self._boxed = self._boxed, []
        for seat in seats:
            self._empty(seat)

    def _empty(self, seat: BusEndpoint) -> None:
        if self.batches:
            events = seat.empty_box()
        else:
            events = [event for run in seat.box for event in in_batches(run.without(seat))]
            seat.box = []
        for event in events:
            self._hand(seat, event)

    def _hand(self, seat: BusEndpoint, event: Event) -> None:
        """Let a node take an event, or keep it until the node can."""
        if seat.box:
            self._empty(seat)
        if seat.paused or seat.at_work:
            if not isinstance(event, Timer):
                seat.waiting.append(event)
            return
        effects = seat.handle(event, self._time_of(seat) if seat.clock else self.now)
        for effect in effects:
            self._carry_out(seat, effect)
        if self.tap is not None:
            self.tap(seat.node, event)
        if effects is NO_EFFECTS and seat.armed is not None:
            return
        if seat.work > 0.0 and is_observation(event):
            seat.at_work = True
            self._schedule(seat, _Done(), seat.work)
        elif seat.deadline() != seat.armed:
            self._rearm(seat)

    def _time_of(self, seat: BusEndpoint) -> float:
        """What a node's clock shows; never just short of its deadline by rounding, or its timer would fire for ever."""
        now = self.now + seat.clock
        due = seat.node.deadline() if seat.clock else None
        return due if due is not None and 0.0 < due - now < 1e-6 else now

    def _advance(self, until: float) -> bool:
        while self._later and self._later[0][0] <= (self.now if self._ready else until):  # what is ready comes before a later time
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

    def _schedule(self, seat: BusEndpoint, event: Item | _Done, delay: float) -> None:
        if delay <= 0.0:
            self._ready.append((seat, event))
        else:
            self._push(self.now + delay, (seat, event))

    def _push(self, time: float, entry: _Entry) -> None:
        self._sequence += 1
        heapq.heappush(self._later, (time, self._sequence, entry))

    def _rearm(self, seat: BusEndpoint) -> None:
        deadline = seat.armed = seat.deadline()
        if deadline is None:
            seat.timer = None
        elif seat.timer is None or deadline - seat.clock != seat.timer:
            seat.timer = max(deadline - seat.clock, self.now)
            self._push(seat.timer, (seat, Timer()))

    def _carry_out(self, seat: BusEndpoint, effect: Effect) -> None:
        if isinstance(effect, Message):
            self._publish(seat, effect)
        elif isinstance(effect, Subscribe):
            self._subscribe(seat, effect.expression)
        elif isinstance(effect, Unsubscribe):
            self._unsubscribe(seat, effect.expression)
        elif isinstance(effect, Stop):  # a Reopen is nothing here: no session of ours is ever half open
            for label in [label for label, other in self._seats.items() if other is seat]:
                self.stopped[label] = effect
                self.remove(label)

    def _subscribe(self, seat: BusEndpoint, expression: str) -> None:
        seat.expressions[expression] += 1
        if seat.expressions[expression] > 1:
            return
        if not is_of_tokens(expression):
            self._routes.add(expression, seat)
            return
        self._watchers.add(expression, seat)
        for other in self._holders.get(_parent(expression), {}):
            if other is not seat:
                self._ready.append((seat, Alive(other.node.role, other.node.name, other.node.incarnation)))

    def _unsubscribe(self, seat: BusEndpoint, expression: str) -> None:
        seat.expressions[expression] -= 1
        if seat.expressions[expression] == 0:
            del seat.expressions[expression]
            (self._watchers if is_of_tokens(expression) else self._routes).remove(expression, seat)

    def _watching(self, token: str) -> dict[BusEndpoint, None]:
        """Who sees a token come and go, in the order in which they came to the bus."""
        watching = self._watchers.listeners(token)
        return dict.fromkeys(sorted([*self._all_seeing, *watching], key=place_of)) if watching else self._all_seeing

    def _publish(self, seat: BusEndpoint, message: Message) -> None:
        key = message_key(seat.node.run, message)
        listeners = self._routes.listeners(key)
        payload = codec.encode(message)
        self.messages += 1
        self.bytes += len(payload)
        item = _item(key, payload)
        pace = self._pace if isinstance(message, Command) else 0.0
        if self._link is None and pace == 0.0:
            self._ready.append(Delivery(listeners, seat, item))
            self.deliveries += len(listeners)
            return
        at_once: list[BusEndpoint] = []
        for listener in listeners:
            if listener is not seat:
                for delay, arrived in self._carried(seat, listener, key, payload):
                    self.deliveries += 1
                    if arrived is payload and pace + delay <= 0.0:
                        at_once.append(listener)
                    else:
                        self._schedule(listener, item if arrived is payload else _item(key, arrived), pace + delay)
        if at_once:
            self._ready.append(Delivery(at_once, seat, item))

    def _carried(self, seat: BusEndpoint, listener: BusEndpoint, key: str, payload: bytes) -> Sequence[tuple[float, bytes]]:
        if self._link is None:
            return [(0.0, payload)]
        return self._link.carry(seat.node.name, listener.node.name, key, payload, self.now)


def _item(key: str, payload: bytes) -> Item:
    """What the bytes under a key are to whoever they reach."""
    [message] = codec.decode_all([(key, payload)])
    return read(key, payload, message)


def _parent(key: str) -> str:
    return key.rpartition("/")[0]
