"""The picture: the newest messages of a run; pages and metrics are drawn from it.

It takes events and keeps the latest message of each kind per agent. It sends nothing, and no process waits for it. Changes (an agent lost,
back, silent, heard again) stand in a time line.
"""

import math
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np

from agents.membership.peer_table import MOST_STRANGERS
from agents.tracking.gaussians import unpacked, weighted_points
from deploy.scenario import Scenario
from deploy.scoring.deaths import ends_run
from deploy.scoring.result import Fault
from protocol.keys import order
from protocol.measuring import to_places
from protocol.messages import Gossip, Hello, Observation
from protocol.node import Alive, Event, Gone, Received, Rejected
from protocol.observer_messages import Estimate, Truth
from protocol.sensing import SensorModel, measurement_of
from protocol.settings import BadSetting, sensor_of
from world.presence import Presence

TRAIL = 12.0  # s of the world that trails reach back, and `KEPT_TICKS` at least
MOST_HAPPENINGS = 2000
UNKNOWN = 0  # incarnation of an agent that has not been heard
OTHER = "(other)"  # under which rejected messages are counted whose sender is no known agent: anybody can make up names
KEPT_TICKS = 24  # kept of what an agent said


PAUSES = ("pause", "resume", "kill", "restart")  # verbs of faults that begin or end a pause


def paused_after(faults: Iterable[Fault], before: frozenset[str] = frozenset()) -> frozenset[str]:
    """The paused agents after some faults."""
    for fault in faults:
        names = frozenset(fault.who.split(","))
        before = before | names if fault.verb == "pause" else before - names if fault.verb in PAUSES else before
    return before


class Happening(NamedTuple):
    """An entry of the time line."""

    number: int
    time: float  # of the world, s
    kind: str  # lost, back, joined, twin, silent, paused, heard, asked, told, world; of the links partition, heal, links
    who: str
    text: str


@dataclass(slots=True)
class KnownAgent:
    """What has been heard of one agent."""

    name: str
    sensor_class: str
    sensor: SensorModel | None
    incarnation: int = UNKNOWN
    alive: bool = False  # its token is up
    seen: bool = False  # it has been alive at some time
    gone_from: int = 0  # the first tick without it, once its token has gone
    gossip: Gossip | None = None  # the newest
    estimate: Estimate | None = None
    gossips: dict[int, Gossip] = field(default_factory=dict)  # those of the last ticks
    estimates: dict[int, Estimate] = field(default_factory=dict)
    rejected: int = 0  # what watchers had to reject of what came under its name
    state: str = "waiting"  # waiting, alive, listening, silent, paused, dead

    def places(self, gossip: Gossip) -> np.ndarray:
        """The places of the detections in one of its gossips (M, 2), m."""
        if self.sensor is None:
            return gossip.detections
        return to_places(measurement_of(self.sensor), self.sensor.reach, gossip.pose, gossip.detections)

    def forget(self) -> None:
        """Forget what it has said."""
        self.gossip = self.estimate = None
        self.gone_from = 0
        self.gossips.clear()
        self.estimates.clear()


def silent_after(scenario: Scenario, pace: int = 1) -> int:
    """Ticks without a gossip after which an agent counts as silent: as many as its peers wait at this pace (`PeerTable`)."""
    return pace * max(scenario.timing.silent_rounds, math.ceil(scenario.ticks_of_silence / pace))


KeptMessage = TypeVar("KeptMessage", Gossip, Estimate)


def up_to(said: dict[int, KeptMessage], tick: int) -> KeptMessage | None:
    """The newest of this tick or before."""
    ticks = [stamp for stamp in said if stamp <= tick]
    return said[max(ticks)] if ticks else None


def _keep(said: dict[int, KeptMessage], message: KeptMessage) -> None:
    """Keep a message among those of the last ticks."""
    said[message.tick] = message
    if len(said) > KEPT_TICKS:
        del said[min(said)]


class Picture:
    """Shown events, it knows the newest of everything, and one tick, `shown`, of which it has heard all: that is drawn.

    Agents are never all at one tick: cells of different ticks, put side by side, would gape and overlap though the swarm's do not.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.truth: Truth | None = None  # the newest
        self.shown: Truth | None = None  # of the tick that is drawn
        self.agents: dict[str, KnownAgent] = {}
        self.happenings: deque[Happening] = deque(maxlen=MOST_HAPPENINGS)
        self.trail: deque[Truth] = deque()
        self.messages = 0
        self.bytes = 0
        self.rejected: Counter[tuple[str, str]] = Counter()  # by sender, a known agent or `OTHER`, and reason
        self.roster_version = 0  # grows when an agent or its sensor becomes known
        self.version = 0  # grows with everything that is heard
        self.paused: frozenset[str] = frozenset()  # as the supervisor says
        self._is_over = False  # the last tick is past and the world has ended, or a body: agents that leave are dismissed
        self._presence = Presence(scenario.members)
        self._strangers: dict[str, None] = {}  # the agents that are not in the roster and have no token, the earliest first
        self._numbered = 0
        self._keeps_no_diary = False
        for name, sensor_class in scenario.members.items():
            self._meet(name, sensor_class, sensor_of(scenario, sensor_class))

    @property
    def time(self) -> float:
        """The world's newest time, s."""
        return self.truth.time if self.truth else 0.0

    def see(self, event: Event, now: float) -> None:
        """Take one event."""
        self.version += 1
        self._is_over = self._is_over or ends_run(event, self.truth, self.scenario.run.ticks)
        match event:
            case Received(batch=batch):
                self.messages += len(batch)
                self.bytes += sum(map(len, batch.payloads))
                for message in batch.messages:
                    self._hear(message)
            case Alive(role="agent"):
                self._appear(event.name, event.incarnation)
            case Gone(role="agent") if not self._is_over:
                self._vanish(event.name, event.incarnation)
            case Alive(role="world") if self.truth is not None:
                self.note("world", "world", "the world is back")
            case Gone(role="world"):
                self.note("world", "world", "the world has ended")
            case Rejected():
                self._reject(event)

    def note(self, kind: str, who: str, text: str, time: float | None = None) -> None:
        """Put an entry on the time line, now or at another world time, s; nothing when the time line is another picture's."""
        if self._keeps_no_diary:
            return
        self._numbered += 1
        self.version += 1
        self.happenings.append(Happening(self._numbered, self.time if time is None else time, kind, who, text))

    def note_fault(self, fault: Fault) -> None:
        """Put an ordered fault that no message shows on the time line; note paused agents."""
        if fault.verb in PAUSES:
            self.pause(paused_after([fault], self.paused))
        else:
            self.note(fault.verb if fault.verb in ("partition", "heal") else "links", "", fault.text, fault.time)

    def take_happenings(self, other: "Picture") -> None:
        """Show the time line of another picture, which has seen the whole recording, instead of an own one."""
        self.happenings, self._keeps_no_diary = other.happenings, True

    def forget(self) -> None:
        """Forget all messages and keep the roster and the time line: a replay has jumped."""
        self.truth = self.shown = None
        self._is_over = False
        self.trail.clear()
        for known in self.agents.values():
            known.forget()
            known.alive, known.incarnation = False, UNKNOWN
        self._presence = Presence(self.scenario.members)
        self.version += 1

    def assume(self, truth: Truth) -> None:
        """Take the live agents from the truth: a replay that has jumped has not seen the tokens."""
        for name, known in self.agents.items():
            known.alive = name in truth.alive
            known.seen = known.seen or known.alive or truth.tick > 0
        self._settle(quietly=True)

    def pause(self, names: frozenset[str]) -> None:
        """Set the paused agents, as reported by the supervisor."""
        if names != self.paused:
            self.paused = names
            self.version += 1
            self._settle()

    def show(self, tick: int) -> None:
        """Draw this tick from now on, if it is known; else the newest."""
        known = [truth for truth in self.trail if truth.tick == tick]
        self.shown = known[-1] if known else self.truth

    def is_alive(self, known: KnownAgent) -> bool:
        """Whether an agent is alive at the tick that is drawn: its token is up, or has gone after that tick."""
        return known.alive or (self.shown is not None and self.shown.tick < known.gone_from)

    def pose(self, name: str) -> tuple[float, float, float] | None:
        """Where a body is at the tick that is drawn: as the world says, else as the agent says; x, y in m, heading in rad."""
        if self.shown is not None and name in self.shown.bodies:
            x, y, heading = self.shown.poses[self.shown.bodies.index(name)].tolist()
            return x, y, heading
        gossip = self.agents[name].gossip
        return gossip.pose if gossip else None

    def said(self, known: KnownAgent) -> tuple[Gossip | None, Estimate | None]:
        """The messages of an agent at the tick that is drawn, or the last before it."""
        if self.shown is None:
            return known.gossip, known.estimate
        return up_to(known.gossips, self.shown.tick), up_to(known.estimates, self.shown.tick)

    def outcome(self, known: KnownAgent) -> Gossip | None:
        """What an agent has made of the tick that is drawn: the gossip of a tick carries the particles and the claim of the one before."""
        return up_to(known.gossips, self.shown.tick + 1) if self.shown else known.gossip

    def age(self, known: KnownAgent) -> float | None:
        """Age of the newest gossip of an agent, s of world time; None without one."""
        if known.gossip is None or self.truth is None:
            return None
        return max(0, self.truth.tick - known.gossip.tick) * self.scenario.run.dt

    def particles(self) -> np.ndarray:
        """Every particle or node of a component that a living agent owned after the tick that is drawn, (N, 3): x, y in m, weight."""
        parts = []
        for known in self.agents.values():
            gossip = self.outcome(known)
            if self.is_alive(known) and gossip is not None and len(gossip.states):
                parts.append(np.column_stack([gossip.states[:, :2], np.full(len(gossip.states), gossip.weight)]))
            if self.is_alive(known) and gossip is not None and len(gossip.components):
                spread = weighted_points(unpacked(gossip.components))
                parts.append(np.column_stack([spread.states[:, :2], spread.weights]))
        return np.concatenate(parts) if parts else np.empty((0, 3))

    def _hear(self, message: object) -> None:
        if isinstance(message, Truth):
            self._hear_truth(message)
        elif isinstance(message, Gossip):
            self._hear_gossip(message)
        elif isinstance(message, Estimate):
            known = self._known(message.sender)
            if message.incarnation >= known.incarnation:
                known.estimate = message
                _keep(known.estimates, message)
        elif isinstance(message, Hello) and message.role == "agent":
            self._hear_hello(message)
        elif isinstance(message, Observation) and self.truth is None and message.recipient in self.agents:
            self.agents[message.recipient].seen = True

    def _hear_truth(self, truth: Truth) -> None:
        if self.truth is not None and (truth.incarnation, truth.tick) <= (self.truth.incarnation, self.truth.tick):
            return
        self.truth = truth
        self.trail.append(truth)
        while (self.trail[0].time < truth.time - TRAIL and len(self.trail) > KEPT_TICKS) or self.trail[0].time > truth.time:
            self.trail.popleft()
        self._settle()

    def _hear_gossip(self, gossip: Gossip) -> None:
        known = self._known(gossip.sender)
        if gossip.incarnation >= known.incarnation:
            if gossip.incarnation > known.incarnation:
                known.forget()
            known.gossip, known.incarnation = gossip, gossip.incarnation
            _keep(known.gossips, gossip)
            if known.state == "silent":
                self._settle()  # not only with the next truth: after the last one no further truth comes

    def _hear_hello(self, hello: Hello) -> None:
        known = self._known(hello.sender)
        if known.sensor is not None:
            return
        known.sensor_class = hello.sensor_class
        try:
            known.sensor = hello.sensor or sensor_of(self.scenario, hello.sensor_class)
        except BadSetting:
            return  # an unknown sensor is not drawn
        self.roster_version += 1

    def _appear(self, name: str, incarnation: int) -> None:
        known = self._known(name)
        self._presence.appear(name, incarnation)
        if known.alive and incarnation != known.incarnation:
            self.note("twin", name, f"two processes are called {name}; the older one stops itself")
        if incarnation < known.incarnation or known.alive:
            known.incarnation = max(incarnation, known.incarnation)
            return
        if known.seen and incarnation > known.incarnation:
            known.forget()
        known.incarnation, known.alive = incarnation, True
        self._strangers.pop(name, None)
        self._settle()

    def _vanish(self, name: str, incarnation: int) -> None:
        known = self._known(name)
        self._presence.vanish(name, incarnation)
        older = self._presence.live(name)
        if not known.alive or known.incarnation not in (incarnation, UNKNOWN):
            return
        if older is not None:  # a process of this name that lives on
            known.forget()
            known.incarnation = older
            return
        known.alive = False
        known.gone_from = max(self.truth.tick if self.truth else 0, known.estimate.tick + 1 if known.estimate else 0)
        self._settle()
        self._limit_strangers(name)

    def _reject(self, event: Rejected) -> None:
        known = self.agents.get(event.sender)
        self.rejected[known.name if known else OTHER, event.reason] += 1
        if known:
            known.rejected += 1

    def _known(self, name: str) -> KnownAgent:
        known = self.agents.get(name)
        if known is None:
            known = self._meet(name, "", None)
            self._limit_strangers(name)
        return known

    def _limit_strangers(self, name: str) -> None:
        """Note an agent without a token as a stranger, unless it is in the roster; forget the earliest of too many (`PeerTable`)."""
        if name in self.scenario.members:
            return
        self._strangers[name] = None
        if len(self._strangers) <= MOST_STRANGERS:
            return
        earliest = next(iter(self._strangers))
        del self._strangers[earliest], self.agents[earliest]
        for who, reason in [key for key in self.rejected if key[0] == earliest]:
            self.rejected[OTHER, reason] += self.rejected.pop((who, reason))
        self.roster_version += 1

    def _meet(self, name: str, sensor_class: str, sensor: SensorModel | None) -> KnownAgent:
        self.agents[name] = KnownAgent(name, sensor_class, sensor)
        self.agents = dict(sorted(self.agents.items(), key=lambda item: order(item[0])))
        self.roster_version += 1
        return self.agents[name]

    def _settle(self, quietly: bool = False) -> None:
        """Find out the state of every agent, and put what has changed on the time line."""
        reached, limit = self._reached(), silent_after(self.scenario, self._pace())
        for known in self.agents.values():
            old, new = known.state, self._state(known, reached, limit)
            if old == new:
                continue
            known.state = new
            known.seen = known.seen or known.alive
            if not quietly:
                self._note_change(known, old, new)

    def _note_change(self, known: KnownAgent, old: str, new: str) -> None:
        name = known.name
        if new == "dead":
            self.note("lost", name, f"{name} is gone")
        elif new in ("silent", "paused"):
            self.note(new, name, f"{name} {'is paused' if new == 'paused' else 'has fallen silent'}")
        elif old == "dead":
            self.note("back", name, f"{name} is back")
        elif old in ("silent", "paused"):
            self.note("heard", name, f"{name} is heard again")
        elif old == "waiting" and self.truth is not None and self.truth.tick > 1:
            self.note("joined", name, f"{name} has joined")

    def _reached(self) -> int:
        """The tick by which silence is judged: the newest heard, where two or more speak. A late watcher has not lost everybody."""
        ticks = [known.gossip.tick for known in self.agents.values() if known.alive and known.gossip is not None]
        newest = self.truth.tick if self.truth is not None else 0
        return min(newest, max(ticks)) if len(ticks) > 1 else newest

    def _pace(self) -> int:
        """The slowest pace of a live agent, which all others keep."""
        return max((known.estimate.pace for known in self.agents.values() if known.alive and known.estimate is not None), default=1)

    def _state(self, known: KnownAgent, reached: int, limit: int) -> str:
        if known.name in self.paused and known.seen:
            return "paused"  # after a while its token goes, too
        if not known.alive:
            return "dead" if known.seen else "waiting"
        if known.gossip is None or self.truth is None:
            return "alive"
        if reached - known.gossip.tick > limit:
            return "silent"
        return "listening" if known.gossip.listening else "alive"
