"""One agent: the Node of one sensor.

An `Observation` of tick k opens the round k, and the agent publishes its `Gossip` of tick k at once. The round closes when the gossips of
all expected peers are in, or at the deadline. `run_round` computes what follows from it.

This file keeps the order of events and the time. `agents.round` holds the steps of a round, `agents.tracking` and `agents.coverage` their
mathematics.
"""

from collections import Counter

from agents.backend import PLAIN, Backend
from agents.config import AgentConfig
from agents.gossip import outbox
from agents.gossip.table import announced_sensor
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
    """The Node of one sensor. Its rounds follow the ticks of the observations; `counters` counts what happened, by name."""

    role = "agent"
    patient = "/gossip/"  # a driver may hold gossips back until `awaiting` of them have come
    newest_only = "/observation/"

    def __init__(self, config: AgentConfig, name: str, incarnation: int = 1, backend: Backend = PLAIN, sensor_class: str = "") -> None:
        """`incarnation` grows with every restart under the same name; `sensor_class` empty: the one that the roster names."""
        self.name, self.incarnation, self.run = name, incarnation, config.run.name
        self.config = config
        self.sensor_class = sensor_class or config.members[name]  # empty: the class that the roster names
        self.counters: Counter[str] = Counter()
        self.neighbours = PeerTable(config, name)
        self.tick = -1  # of the newest observation; -1: none has come
        self.context = context_of(config, name, self.sensor_class, backend)
        self.neighbours.own_sensor = announced_sensor(name, self.context.sensor, config.detection.clutter)
        self.local = self.neighbours.local
        self.sees_all_tokens = not self.local
        self._interest = InterestManager(self.context, self.neighbours, incarnation) if self.local else None
        everywhere = NONE if self.local else prior(config.filter.seed, prior_size(config.filter, config.arena), config.filter, config.arena)
        self.outcome = RoundResult(start(everywhere, name), self.context.facts.capability)
        self._failure_detector = FailureDetector(name, ["world"] if self.local else [*config.others(name), "world"])
        self._world_incarnation = 0  # incarnation of the world
        self._observation: Observation | None = None  # of the open round
        self._gossip: Gossip | None = None  # the own one of the open round; None: no round is open
        self._awaited: set[str] = set()  # peers for whose gossips the open round waits
        self._listening_rounds = 0  # rounds left in which the agent listens and has no cell
        self._rounds_alone = 0  # listening rounds left without any gossip, before the agent takes itself to be alone
        self._close_at: float | None = None
        self._answer_at: float | None = None
        self._announcements = AnnouncementSchedule(0 if self.local else len(config.others(name)), self.neighbours.is_roster_alive)
        self._opened_at = 0.0
        self._agreement = SettingsAgreement(name, self.neighbours.settings, self.counters)

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event at `now`, s. Return the effects in order; `NO_EFFECTS` when nothing follows (Node)."""
        if type(event) is Received:
            return self._on_batch(event.batch, now)
        match event:
            case Timer():
                return self._on_timer(now)
            case Alive(role="agent") if event.name == self.name:
                return self._fence(event.incarnation)
            case Alive():
                if event.role == "agent":
                    self._failure_detector.appear(event.name, event.incarnation)
                    self.neighbours.alive(event.name, event.incarnation)
                if event.role != "agent" or not self.local:
                    self._announcements.peer_appeared(len(self.neighbours.peers), now)
            case Gone(role="agent"):
                self._failure_detector.leave(event.name, event.incarnation)
                self.neighbours.gone(event.name, event.incarnation, self.tick)
                self._awaited.discard(event.name)
                return self._close_if_complete(now)
            case Started():
                self._announcements.start(now)
                return [*map(Subscribe, [*self._expressions(), one_of(self.run, "observation", self.name)]), self._hello(now)]
            case Rejected(reason=reason):
                self.counters[f"rejected.{reason}"] += 1
        return []

    def _on_batch(self, batch: Batch, now: float) -> list[Effect]:
        """Take messages of one kind that arrived together."""
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
        """The key expressions to which the agent subscribes at the start."""
        if not self.local:
            return [all_of(self.run, "hello"), all_of(self.run, "gossip")]
        return [one_of(self.run, "hello", "world"), tokens_of(self.run, "agent", self.name), tokens_of(self.run, "world", "world")]

    @property
    def awaiting(self) -> int:
        """The number of gossips for which the open round waits (Node). Without an open round, gossips wait for the observation."""
        return len(self._awaited) if self._gossip else MANY

    def deadline(self) -> float | None:
        """When to call with `Timer`, s (Node): the earliest of the round's end, the next Hello, the next answer and the next selection."""
        if self._interest is None:
            close, announce = self._close_at, self._announcements.due
            return announce if close is None or (announce is not None and announce < close) else close
        times = [time for time in (self._close_at, self._announcements.due, self._answer_at, self._interest.due) if time is not None]
        return min(times, default=None)

    def _on_observation(self, observation: Observation, now: float) -> list[Effect]:
        """Close a round that is still open, and open that of the observation. An old observation is counted and ignored."""
        if observation.incarnation < self._world_incarnation or observation.tick <= self.tick:
            self.counters["rejected.stale"] += 1
            return []
        self._world_incarnation = observation.incarnation
        self._failure_detector.speak(observation.sender, now)
        effects = self._close(now) if self._gossip else []
        if self.tick < 0:
            self._listening_rounds = self.config.timing.listening_rounds if observation.tick > 0 else 0
            self._rounds_alone = 2 * self.config.timing.silent_rounds
        elif observation.tick > self.tick + 1:
            self.counters["skipped"] += observation.tick - self.tick - 1
        self.tick, self._observation, self._opened_at = observation.tick, observation, now
        self._announcements.observation_arrived(now)
        if self._interest is not None and not self._interest.settled:
            return [*effects, *self._interest.start(observation, self.outcome, now)]
        return [*effects, *self._open_round(observation, now)]

    def _open_round(self, observation: Observation, now: float) -> list[Effect]:
        """Open the round: publish the own gossip, and determine which gossips it waits for."""
        self._gossip = outbox.gossip(self.context, self.incarnation, self.outcome, observation, listening=self._listening_rounds > 0)
        self._awaited = self.neighbours.missing(self.tick, newcomer=self._listening_rounds > 0)
        self._close_at = now + self.config.gossip_timeout(missed=self.neighbours.any_missed())
        return [self._gossip, *self._close_if_complete(now)]

    def _join(self, now: float) -> list[Effect]:
        """Ask for peers until the interest manager is settled. Then start the filter around the expected cell and open the first round."""
        observation, interest = self._observation, self._interest
        assert observation is not None and interest is not None
        effects = interest.on_timer(observation, self.outcome, now)
        if not interest.settled:
            return effects
        nearby = interest.surroundings(observation, self.outcome)
        config = self.config
        known = prior_around(config.filter.seed, prior_size(config.filter, config.arena), config.filter, config.arena, nearby)
        self.outcome = RoundResult(start(known, self.name), self.context.facts.capability)
        return [*effects, *self._open_round(observation, now)]

    def _on_gossips(self, batch: Batch, now: float) -> list[Effect]:
        """Take gossips that arrived together. The open round closes when none is awaited any more."""
        if self.name in batch.senders:
            for message in batch.messages:
                if message.sender == self.name and message.incarnation > self.incarnation:
                    return self._fence(message.incarnation)
        if not self.local:
            self._failure_detector.speak_all(batch.senders, now)
        if self.tick < 0:
            self._announcements.run_started()
        effects: list[Effect] = NO_EFFECTS
        start = 0
        while start < len(batch):  # a round closes with the gossip that completes it; later rows belong to the next one
            more, judged = self._accept(batch, start, now)
            effects = more if effects is NO_EFFECTS else [*effects, *more]
            start += judged
        return effects

    def _accept(self, batch: Batch, start: int, now: float) -> tuple[list[Effect], int]:
        """Take gossips from the row `start` on, until the open round is complete or the batch ends.

        Returns the effects and the number of rows taken.
        """
        reasons = self.neighbours.accept(batch, start, self.tick, self._awaited if self._gossip is not None else None)
        accepted = [gossip for gossip, reason in zip(batch.messages[start:], reasons) if reason == ACCEPTED]
        if len(accepted) < len(reasons):
            refused = [reason for reason in reasons if reason not in (ACCEPTED, OWN, UNASKED)]
            self.counters.update([f"rejected.{reason}" for reason in refused])
        if accepted:
            self.counters["heard"] += len(accepted)
        reopenings = self._reopen_if_behind(accepted, now) if self._interest is not None else []
        if self._gossip is not None and not self._awaited:
            return [*reopenings, *self._close(now)], len(reasons)
        return reopenings or NO_EFFECTS, len(reasons)

    def _reopen_if_behind(self, gossips: list[Gossip], now: float) -> list[Effect]:
        """The effects that open a new session, if peers have been more than one tick ahead for long; else none."""
        assert self._interest is not None
        for gossip in gossips:
            if gossip.tick > self.tick + 1:
                reopenings = self._interest.reopen_if_behind(self.tick, now)
                self.counters["reopened"] += len(reopenings)
                if reopenings:
                    return reopenings
        return []

    def _on_beacons(self, beacons: list[Beacon], now: float) -> list[Effect]:
        """Take the beacons of other agents, and plan an answer if one of them needs it."""
        if self._interest is None:
            return NO_EFFECTS
        refused = [beacon for beacon in beacons if self._agreement.differs(beacon)]
        warnings = self._agreement.refuse(refused) if refused else NO_EFFECTS
        if not self._interest.take_beacons([beacon for beacon in beacons if beacon not in refused] if refused else beacons):
            return warnings
        self._answer_at = now + SOON if self._answer_at is None else self._answer_at
        return [*warnings]

    def _on_hello(self, hello: Hello, now: float) -> list[Effect]:
        """Take a Hello: remember the announced sensor, compare the settings, and check the session for a half-open link."""
        if hello.sender == self.name:
            return self._fence(hello.incarnation)
        if hello.role == "agent" and self.neighbours.has_announced(hello) and self._failure_detector.greet_again(hello.sender, now):
            return NO_EFFECTS
        reason = self.neighbours.take_hello(hello) if hello.role == "agent" else None
        # a refused sender still counts as heard, and the own Hello lists it
        warnings = self._agreement.refuse([hello]) if self._agreement.differs(hello) else []
        if reason and reason != "settings":
            self.counters[f"rejected.{reason}"] += 1
            return warnings
        is_new = self._failure_detector.greet(hello.sender, now)
        if is_new:
            self._announcements.peer_appeared(len(self.neighbours.peers), now)
        reason = self._failure_detector.split(hello, now) if hello.role == "agent" else ""
        if not reason:
            return warnings or ([] if is_new else NO_EFFECTS)
        self.counters["reopened"] += 1
        return [*warnings, Reopen(reason)]

    def _on_timer(self, now: float) -> list[Effect]:
        """Do everything that is due."""
        effects: list[Effect] = []
        if self._announcements.is_due(len(self.neighbours.peers), self.tick < 0 or self.neighbours.lacks_announcements(), now):
            effects.append(self._hello(now))
        if self._interest is not None:
            effects += self._on_interest_timer(self._interest, now)
        if self._close_at is not None and now >= self._close_at:
            self.counters["late"] += 1
            effects += self._close(now)
        return effects

    def _on_interest_timer(self, interest: InterestManager, now: float) -> list[Effect]:
        """Answer a beacon, or continue to join, if that is due."""
        effects: list[Effect] = []
        if self._answer_at is not None and now >= self._answer_at:
            self._answer_at = None
            effects += interest.answer()
        if interest.due is not None and now >= interest.due:
            effects += self._join(now)
        return effects

    def _update_interest(self, interest: InterestManager, gossip: Gossip, now: float) -> list[Effect]:
        """Check for half-open links, publish a beacon and select peers anew where they are due; the effects of that."""
        reopenings = interest.reopen_if_unheard(gossip.tick, now)
        if reopenings:
            self.counters["reopened"] += 1
        effects = [*interest.close_round(gossip, self.outcome), *reopenings]
        self.outcome.belief.everyone &= self.neighbours.interest_set.keys() | {self.name}
        return effects

    def _close_if_complete(self, now: float) -> list[Effect]:
        """Close the open round if it awaits no gossip."""
        if self._gossip is None or self._awaited:
            return []
        return self._close(now)

    def _close(self, now: float) -> list[Effect]:
        """Run the open round; the effects are its command and, where due, its estimate and the changes of interest."""
        observation, gossip = self._observation, self._gossip
        assert observation is not None and gossip is not None
        fresh = self.neighbours.fresh(self.tick)
        self.outcome = run_round(self.context, self.outcome, self.neighbours, gossip, fresh)
        missing = self.neighbours.close(self.tick, newcomer=self._listening_rounds > 0)
        if self._listening_rounds:
            self._count_listening_round(len(fresh), missing)
        self.counters["missing"] += missing
        self.counters["rounds"] += 1
        self._observation = self._gossip = self._close_at = None
        command = outbox.command(self.context, self.incarnation, self.outcome, self.tick)
        effects = self._update_interest(self._interest, gossip, now) if self._interest else []
        if self.tick % self.config.timing.estimate_every:
            return [*effects, command]
        seconds = max(0.0, now - self._opened_at)  # a clock may have jumped
        return [*effects, outbox.estimate(self.context, self.incarnation, self.outcome, gossip, self.counters, seconds), command]

    def _count_listening_round(self, fresh: int, missing: int) -> None:
        """Count a listening round, in which the agent has no cell.

        Listening ends with a complete round, after `listening_rounds` incomplete rounds, or after more rounds without any gossip.
        """
        if fresh:
            self._listening_rounds = self._listening_rounds - 1 if missing else 0
        else:
            self._rounds_alone -= 1
            self._listening_rounds = self._listening_rounds if self._rounds_alone > 0 else 0

    def _hello(self, now: float) -> Hello:
        """The Hello of this agent at `now`. Before the first observation it lists all peers that ever sent a Hello and are alive."""
        heard = self._failure_detector.heard(now if self.tick >= 0 else None)
        return outbox.hello(self.context, self.incarnation, heard, self.neighbours.settings)

    def _fence(self, incarnation: int) -> list[Effect]:
        """Stop if another process with the same name has a younger incarnation."""
        if incarnation > self.incarnation:
            return [Stop(EXIT_FENCED, f"a younger incarnation {incarnation} of {self.name} is alive")]
        return NO_EFFECTS
