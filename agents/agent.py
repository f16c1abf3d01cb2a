"""One agent: the round of a masterless sensor, as a Node.

In comes an `Observation` of tick k; out goes at once a `Gossip` of tick k. When the gossips of all peers that are expected are in,
or at the deadline, the round closes: merge, predict, cut the cell, correct with every scan that was heard, resample what is owned,
and drive. The mathematics lives in `phd`, `belief`, `cells`, `capacity` and `control`; this file keeps the order and the time.
"""

from collections import Counter

from agents.backend import PLAIN
from agents.backend import Backend as Arithmetic
from agents.config import AgentConfig
from agents.gossip import outbox
from agents.interest.manager import InterestManager
from agents.membership.agreement import SettingsAgreement
from agents.membership.announcements import SOON, AnnouncementSchedule
from agents.membership.peer_table import ACCEPTED, OWN, UNASKED, PeerTable
from agents.round import RoundResult, context_of, run_round
from agents.tracking.belief import start
from agents.tracking.births import prior, prior_around, prior_size
from agents.tracking.particles import NONE
from protocol.failure_detector import FailureDetector
from protocol.keys import all_of, one_of, tokens_of
from protocol.messages import Beacon, Gossip, Hello, Observation
from protocol.node import NO_EFFECTS, Alive, Batch, Effect, Event, Gone, Node, Received, Rejected, Reopen, Started, Stop, Subscribe, Timer

EXIT_FENCED = 3
MANY = 1 << 30


class Agent(Node):
    """The Node of one sensor."""

    role = "agent"
    patient = "/gossip/"  # one gossip is no reason to wake up
    newest_only = "/observation/"

    def __init__(
        self, config: AgentConfig, name: str, incarnation: int = 1, arithmetic: Arithmetic = PLAIN, sensor_class: str = ""
    ) -> None:
        self.name, self.incarnation, self.run = name, incarnation, config.run.name
        self.config = config
        self.sensor_class = sensor_class or config.members[name]  # empty: as the roster says
        self.counters: Counter[str] = Counter()
        self.neighbours = PeerTable(config, name)
        self.tick = -1  # of the newest observation
        self.self = context_of(config, name, self.sensor_class, arithmetic)
        self.local = self.neighbours.local
        self.sees_all_tokens = not self.local
        self._lookout = InterestManager(self.self, self.neighbours, incarnation) if self.local else None
        everywhere = NONE if self.local else prior(config.filter.seed, prior_size(config.filter, config.arena), config.filter, config.arena)
        self.outcome = RoundResult(start(everywhere, name), self.self.facts.capability)
        self._presence = FailureDetector(name, ["world"] if self.local else [*config.others(name), "world"])
        self._world = 0  # incarnation of the world
        self._observation: Observation | None = None  # of the open round
        self._gossip: Gossip | None = None  # mine, of the open round
        self._awaited: set[str] = set()  # whose gossip the open round waits for
        self._listening = 0  # rounds left in which I have no cell, though others speak
        self._lonely = 0  # and rounds left in which I do not believe that nobody else is there
        self._close_at: float | None = None
        self._answer_at: float | None = None
        self._greetings = AnnouncementSchedule(0 if self.local else len(config.others(name)), self.neighbours.are_all_there)
        self._opened_at = 0.0
        self._accord = SettingsAgreement(name, self.neighbours.settings, self.counters)

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event; the effects in order (Node)."""
        if type(event) is Received:
            return self._on_batch(event.batch, now)
        match event:
            case Timer():
                return self._on_timer(now)
            case Alive(role="agent") if event.name == self.name:
                return self._fence(event.incarnation)
            case Alive():
                if event.role == "agent":
                    self._presence.appear(event.name, event.incarnation)
                    self.neighbours.alive(event.name, event.incarnation)
                if event.role != "agent" or not self.local:
                    self._greetings.news(len(self.neighbours.peers), now)
            case Gone(role="agent"):
                self._presence.leave(event.name, event.incarnation)
                self.neighbours.gone(event.name, event.incarnation, self.tick)
                self._awaited.discard(event.name)
                return self._close_if_complete(now)
            case Started():
                self._greetings.start(now)
                return [*map(Subscribe, [*self._expressions(), one_of(self.run, "observation", self.name)]), self._hello(now)]
            case Rejected(reason=reason):
                self.counters[f"rejected.{reason}"] += 1
        return []

    def _on_batch(self, batch: Batch, now: float) -> list[Effect]:
        """Take messages that arrived together."""
        if batch.kind is Gossip:
            return self._on_gossips(batch, now)
        if batch.kind is Beacon:
            return self._on_beacons([message for message in batch.messages if message.sender != self.name], now)
        effects: list[Effect] = NO_EFFECTS
        for message in batch.messages:
            if isinstance(message, Hello):
                more = self._on_hello(message, now)
            else:
                more = self._on_observation(message, now) if isinstance(message, Observation) else NO_EFFECTS
            effects = more if effects is NO_EFFECTS else [*effects, *more]
        return effects

    def _expressions(self) -> list[str]:
        """What I listen to from the beginning."""
        if not self.local:
            return [all_of(self.run, "hello"), all_of(self.run, "gossip")]
        return [one_of(self.run, "hello", "world"), tokens_of(self.run, "agent", self.name), tokens_of(self.run, "world", "world")]

    @property
    def awaiting(self) -> int:
        """How many gossips the open round waits for; while none is open they wait for the observation (Node)."""
        return len(self._awaited) if self._gossip else MANY

    def deadline(self) -> float | None:
        """When the open round closes, or the next greeting, answer or choice is due, whichever is earliest (Node)."""
        if self._lookout is None:
            close, greet = self._close_at, self._greetings.due
            return greet if close is None or (greet is not None and greet < close) else close
        times = [time for time in (self._close_at, self._greetings.due, self._answer_at, self._lookout.due) if time is not None]
        return min(times, default=None)

    def _on_observation(self, observation: Observation, now: float) -> list[Effect]:
        if observation.incarnation < self._world or observation.tick <= self.tick:
            self.counters["rejected.stale"] += 1
            return []
        self._world = observation.incarnation
        self._presence.speak(observation.sender, now)
        effects = self._close(now) if self._gossip else []
        if self.tick < 0:
            self._listening = self.config.timing.listening_rounds if observation.tick > 0 else 0
            self._lonely = 2 * self.config.timing.silent_rounds
        elif observation.tick > self.tick + 1:
            self.counters["skipped"] += observation.tick - self.tick - 1
        self.tick, self._observation, self._opened_at = observation.tick, observation, now
        self._greetings.observe(now)
        if self._lookout is not None and not self._lookout.settled:
            return [*effects, *self._lookout.arrive(observation, self.outcome, now)]
        return [*effects, *self._speak(observation, now)]

    def _speak(self, observation: Observation, now: float) -> list[Effect]:
        """Open the round: say my gossip, and wait for those of the others."""
        self._gossip = outbox.gossip(self.self, self.incarnation, self.outcome, observation, listening=self._listening > 0)
        self._awaited = self.neighbours.missing(self.tick, newcomer=self._listening > 0)
        self._close_at = now + self.config.patience(missed=self.neighbours.anyone_missed())
        return [self._gossip, *self._close_if_complete(now)]

    def _settle(self, now: float) -> list[Effect]:
        """The lookout asks who is there, and in the end I take part."""
        observation, lookout = self._observation, self._lookout
        assert observation is not None and lookout is not None
        effects = lookout.on_time(observation, self.outcome, now)
        if not lookout.settled:
            return effects
        nearby = lookout.surroundings(observation, self.outcome)
        config = self.config
        known = prior_around(config.filter.seed, prior_size(config.filter, config.arena), config.filter, config.arena, nearby)
        self.outcome = RoundResult(start(known, self.name), self.self.facts.capability)
        return [*effects, *self._speak(observation, now)]

    def _on_gossips(self, batch: Batch, now: float) -> list[Effect]:
        """Take gossips that arrived together; the open round closes when nobody is awaited any more."""
        if self.name in batch.senders:
            for message in batch.messages:
                if message.sender == self.name and message.incarnation > self.incarnation:
                    return self._fence(message.incarnation)
        if not self.local:
            self._presence.speak_all(batch.senders, now)
        if self.tick < 0:
            self._greetings.go_on()
        effects: list[Effect] = NO_EFFECTS
        start = 0
        while start < len(batch):  # a round closes with the gossip that completes it; the rest belongs to what follows
            more, judged = self._accept(batch, start, now)
            effects = more if effects is NO_EFFECTS else [*effects, *more]
            start += judged
        return effects

    def _accept(self, batch: Batch, start: int, now: float) -> tuple[list[Effect], int]:
        """Take gossips from a row on, until the open round is complete or all are taken; what follows, and how many were taken."""
        reasons = self.neighbours.accept(batch, start, self.tick, self._awaited if self._gossip is not None else None)
        accepted = [gossip for gossip, reason in zip(batch.messages[start:], reasons) if reason == ACCEPTED]
        if len(accepted) < len(reasons):
            refused = [reason for reason in reasons if reason not in (ACCEPTED, OWN, UNASKED)]
            self.counters.update([f"rejected.{reason}" for reason in refused])
        if accepted:
            self.counters["heard"] += len(accepted)
        doubts = self._lag(accepted, now) if self._lookout is not None else []
        if self._gossip is not None and not self._awaited:
            return [*doubts, *self._close(now)], len(reasons)
        return doubts or NO_EFFECTS, len(reasons)

    def _lag(self, gossips: list[Gossip], now: float) -> list[Effect]:
        """A new session, if others have long been more than a tick ahead."""
        assert self._lookout is not None
        for gossip in gossips:
            if gossip.tick > self.tick + 1:
                doubts = self._lookout.lag(self.tick, now)
                self.counters["reopened"] += len(doubts)
                if doubts:
                    return doubts
        return []

    def _on_beacons(self, beacons: list[Beacon], now: float) -> list[Effect]:
        if self._lookout is None:
            return NO_EFFECTS
        others = [beacon for beacon in beacons if self._accord.differs(beacon)]
        warnings = self._accord.refuse(others) if others else NO_EFFECTS
        if not self._lookout.hear_all([beacon for beacon in beacons if beacon not in others] if others else beacons):
            return warnings
        self._answer_at = now + SOON if self._answer_at is None else self._answer_at
        return [*warnings]

    def _on_hello(self, hello: Hello, now: float) -> list[Effect]:
        if hello.sender == self.name:
            return self._fence(hello.incarnation)
        if hello.role == "agent" and self.neighbours.knows(hello) and self._presence.greet_again(hello.sender, now):
            return NO_EFFECTS
        reason = self.neighbours.greet(hello) if hello.role == "agent" else None
        warnings = self._accord.refuse([hello]) if self._accord.differs(hello) else []  # heard all the same, which others shall know
        if reason and reason != "settings":
            self.counters[f"rejected.{reason}"] += 1
            return warnings
        is_new = self._presence.greet(hello.sender, now)
        if is_new:
            self._greetings.news(len(self.neighbours.peers), now)
        reason = self._presence.split(hello, now) if hello.role == "agent" else ""
        if not reason:
            return warnings or ([] if is_new else NO_EFFECTS)
        self.counters["reopened"] += 1
        return [*warnings, Reopen(reason)]

    def _on_timer(self, now: float) -> list[Effect]:
        effects: list[Effect] = []
        if self._greetings.is_due(len(self.neighbours.peers), self.tick < 0 or self.neighbours.strangers(), now):
            effects.append(self._hello(now))
        if self._lookout is not None:
            effects += self._on_time(self._lookout, now)
        if self._close_at is not None and now >= self._close_at:
            self.counters["late"] += 1
            effects += self._close(now)
        return effects

    def _on_time(self, lookout: InterestManager, now: float) -> list[Effect]:
        effects: list[Effect] = []
        if self._answer_at is not None and now >= self._answer_at:
            self._answer_at = None
            effects += lookout.answer()
        if lookout.due is not None and now >= lookout.due:
            effects += self._settle(now)
        return effects

    def _look_out(self, lookout: InterestManager, gossip: Gossip, now: float) -> list[Effect]:
        """What follows from a round for who hears me and whom I hear."""
        doubts = lookout.doubt(gossip.tick, now)
        if doubts:
            self.counters["reopened"] += 1
        effects = [*lookout.after(gossip, self.outcome), *doubts]
        self.outcome.belief.everyone &= self.neighbours.interest_set.keys() | {self.name}
        return effects

    def _close_if_complete(self, now: float) -> list[Effect]:
        if self._gossip is None or self._awaited:
            return []
        return self._close(now)

    def _close(self, now: float) -> list[Effect]:
        """Play the open round and say what follows from it."""
        observation, gossip = self._observation, self._gossip
        assert observation is not None and gossip is not None
        heard = self.neighbours.fresh(self.tick)
        self.outcome = run_round(self.self, self.outcome, self.neighbours, gossip, heard)
        missing = self.neighbours.close(self.tick, newcomer=self._listening > 0)
        if self._listening:
            self._listen_on(len(heard), missing)
        self.counters["missing"] += missing
        self.counters["rounds"] += 1
        self._observation = self._gossip = self._close_at = None
        command = outbox.command(self.self, self.incarnation, self.outcome, self.tick)
        effects = self._look_out(self._lookout, gossip, now) if self._lookout else []
        if self.tick % self.config.timing.estimate_every:
            return [*effects, command]
        seconds = max(0.0, now - self._opened_at)  # a clock may have jumped
        return [*effects, outbox.estimate(self.self, self.incarnation, self.outcome, gossip, self.counters, seconds), command]

    def _listen_on(self, heard: int, missing: int) -> None:
        """A listening round is over: I get a cell once I have heard everybody; or after some rounds in which I heard but a part; or
        after more rounds in which I heard nobody."""
        if heard:
            self._listening = self._listening - 1 if missing else 0
        else:
            self._lonely -= 1
            self._listening = self._listening if self._lonely > 0 else 0

    def _hello(self, now: float) -> Hello:
        heard = self._presence.heard(now if self.tick >= 0 else None)
        return outbox.hello(self.self, self.incarnation, heard, self.neighbours.settings)

    def _fence(self, incarnation: int) -> list[Effect]:
        """Another process speaks under my name: the older incarnation leaves."""
        if incarnation > self.incarnation:
            return [Stop(EXIT_FENCED, f"a younger incarnation {incarnation} of {self.name} is alive")]
        return NO_EFFECTS
