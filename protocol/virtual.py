"""The virtual driver: many nodes in one process and in virtual time, on a bus of events.

Events of one instant are delivered first come, first served, but what is said to many after all others, that of a listener together;
time moves on only when none is left. With `codec` the real bytes travel (each message is encoded and decoded once); a `Link` may drop,
delay, copy or spoil them per receiver. Nodes can be stopped, slowed down, started twice under one name, and given clocks that jump.
"""

import heapq
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from protocol import codec
from protocol.fans import Fan
from protocol.fields import Malformed
from protocol.keys import is_of_tokens, message_key, tokens_of
from protocol.messages import Command, Message
from protocol.node import QUIET, Alive, Effect, Event, Gone, Node, Received, Rejected, Started, Stop, Subscribe, Timer, Unsubscribe
from protocol.routes import Routes
from protocol.seats import Batch, Seat, is_observation, place_of


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


_Entry = tuple[Seat, Event | _Done] | Fan | _Call  # of the queue


class VirtualBus:
    """Drives nodes in virtual time; `now` is in s."""

    def __init__(self, *, use_codec: bool = True, link: Link | None = None, pace: float = 0.0) -> None:
        """`pace`: how long every Command is on its way, s, so that time passes in a world that waits for nothing else."""
        self.now = 0.0
        self.stopped: dict[str, Stop] = {}  # who left by itself, and why
        self.messages = 0  # published
        self.deliveries = 0
        self.bytes = 0  # published
        self.tap: Callable[[Node, Sequence[Event]], None] | None = None  # called when a node has taken an event, or a batch of events
        self.batches = True  # what comes in one instant is handed over together; False: one by one, for comparison
        self._use_codec = use_codec
        self._link = link
        self._pace = pace
        self._seats: dict[str, Seat] = {}
        self._ready: deque[_Entry] = deque()
        self._boxed: list[Seat] = []  # whose box may hold something
        self._later: list[tuple[float, int, _Entry]] = []
        self._sequence = 0
        self._routes: Routes[Seat] = Routes(place_of)  # of messages
        self._all_seeing: dict[Seat, None] = {}  # who sees every token
        self._holders: dict[str, dict[Seat, None]] = {}  # of tokens, by role and name
        self._watchers: Routes[Seat] = Routes(place_of)  # of tokens, by those who do not see all of them

    def nodes(self) -> list[str]:
        """Labels of the nodes on the bus, paused ones included."""
        return list(self._seats)

    def add(self, node: Node, label: str | None = None) -> None:
        """Start a node: it and the others see each other's liveliness tokens. Only a second node of a name needs a label of its own."""
        label = node.name if label is None else label
        if label in self._seats:
            raise ValueError(f"{label} is on the bus already")
        self._sequence += 1
        seat = self._seats[label] = Seat(node, self._sequence)
        self._ready.append((seat, Started()))
        self._holders.setdefault(_parent(seat.token), {})[seat] = None
        if seat.sees_all:
            self._all_seeing[seat] = None
        watching = self._watching(seat.token)
        for other in self._seats.values() if seat.sees_all else watching:
            if other is not seat:
                if seat.sees_all:
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
            if not subject and (seat.sees_all or tokens_of(seat.node.run, event.role, event.name) in seat.expressions):
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

    def _wake(self, seat: Seat) -> None:
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
        if isinstance(entry, Fan):
            self._hand_all(entry)
        elif isinstance(entry, _Call):
            entry.function()
        elif isinstance(entry[1], _Done):
            entry[0].at_work = False
            self._wake(entry[0])
        else:
            self._hand(entry[0], entry[1])
        return True

    def _hand_all(self, fan: Fan) -> None:
        """Bring a message to all its listeners; what agents say to each other goes into their boxes."""
        sender, event, boxed = fan.sender, fan.event, self._boxed
        if not fan.is_boxed:
            for seat in fan.listeners:
                if seat is not sender:
                    self._hand(seat, event)
            return
        batch = fan.gather(self._ready) if self.batches else None
        for seat in fan.listeners:
            if batch is None and seat is sender:
                continue
            if not seat.box:
                boxed.append(seat)
            if batch is None:
                seat.box.append(event)  # type: ignore[arg-type]
            else:
                seat.put(batch)

    def _empty_boxes(self) -> None:
        """Nothing else is left of this instant: let everybody take what has come, one listener after the other.

        With all that a node has heard in hand at once it is not fetched into the caches of the machine anew for every message.
        """
        seats, self._boxed = self._boxed, []
        for seat in seats:
            self._empty(seat)

    def _empty(self, seat: Seat) -> None:
        for part in seat.empty_box():
            if seat.take_all is not None and seat.can_take() and self.batches:
                effects = seat.take(part, self.now)
                if effects is not QUIET or seat.armed is None or self.tap is not None:
                    self._taken(seat, part.without(seat) if isinstance(part, Batch) else part, effects)
                continue
            for event in part.without(seat) if isinstance(part, Batch) else part:
                self._hand(seat, event)

    def _hand(self, seat: Seat, event: Event) -> None:
        """Let a node take an event, or keep it until the node can."""
        if seat.box:
            self._empty(seat)
        if seat.paused or seat.at_work:
            if not isinstance(event, Timer):
                seat.waiting.append(event)
            return
        self._taken(seat, (event,), seat.handle(event, self._time_of(seat) if seat.clock else self.now))

    def _taken(self, seat: Seat, events: Sequence[Event], effects: list[Effect]) -> None:
        """A node has taken events together: what follows."""
        for effect in effects:
            self._carry_out(seat, effect)
        if self.tap is not None:
            self.tap(seat.node, events)
        if effects is QUIET and seat.armed is not None:
            return
        if seat.work > 0.0 and any(map(is_observation, events)):
            seat.at_work = True
            self._schedule(seat, _Done(), seat.work)
        elif seat.deadline() != seat.armed:
            self._rearm(seat)

    def _time_of(self, seat: Seat) -> float:
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

    def _schedule(self, seat: Seat, event: Event | _Done, delay: float) -> None:
        if delay <= 0.0:
            self._ready.append((seat, event))
        else:
            self._push(self.now + delay, (seat, event))

    def _push(self, time: float, entry: _Entry) -> None:
        self._sequence += 1
        heapq.heappush(self._later, (time, self._sequence, entry))

    def _rearm(self, seat: Seat) -> None:
        deadline = seat.armed = seat.deadline()
        if deadline is None:
            seat.timer = None
        elif seat.timer is None or deadline - seat.clock != seat.timer:
            seat.timer = max(deadline - seat.clock, self.now)
            self._push(seat.timer, (seat, Timer()))

    def _carry_out(self, seat: Seat, effect: Effect) -> None:
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

    def _subscribe(self, seat: Seat, expression: str) -> None:
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

    def _unsubscribe(self, seat: Seat, expression: str) -> None:
        seat.expressions[expression] -= 1
        if seat.expressions[expression] == 0:
            del seat.expressions[expression]
            (self._watchers if is_of_tokens(expression) else self._routes).remove(expression, seat)

    def _watching(self, token: str) -> dict[Seat, None]:
        """Who sees a token come and go, in the order in which they came to the bus."""
        watching = self._watchers.listeners(token)
        return dict.fromkeys(sorted([*self._all_seeing, *watching], key=place_of)) if watching else self._all_seeing

    def _publish(self, seat: Seat, message: Message) -> None:
        key = message_key(seat.node.run, message)
        listeners = self._routes.listeners(key)
        payload = codec.encode(message) if self._use_codec else b""
        self.messages += 1
        self.bytes += len(payload)
        event = self._event(seat, key, message, payload)
        pace = self._pace if isinstance(message, Command) else 0.0
        if self._link is None and pace == 0.0:
            self._ready.append(Fan(listeners, seat, event))
            self.deliveries += len(listeners)
            return
        at_once: list[Seat] = []
        for listener in listeners:
            if listener is not seat:
                for delay, arrived in self._carried(seat, listener, key, payload):
                    self.deliveries += 1
                    if arrived is payload and pace + delay <= 0.0:
                        at_once.append(listener)
                    else:
                        self._schedule(listener, event if arrived is payload else self._event(seat, key, message, arrived), pace + delay)
        if at_once:
            self._ready.append(Fan(at_once, seat, event))

    def _carried(self, seat: Seat, listener: Seat, key: str, payload: bytes) -> Sequence[tuple[float, bytes]]:
        if self._link is None:
            return [(0.0, payload)]
        return self._link.carry(seat.node.name, listener.node.name, key, payload, self.now)

    def _event(self, seat: Seat, key: str, message: Message, payload: bytes) -> Event:
        if not self._use_codec:
            return Received(message)
        try:
            return Received(codec.decode(key, payload), len(payload), payload)
        except Malformed as error:
            return Rejected(seat.node.name, error.reason, key, payload)


def _parent(key: str) -> str:
    return key.rpartition("/")[0]
