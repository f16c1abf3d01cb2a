"""One agent: the Node of one sensor.

An `Observation` of tick k opens the tick k and its round, and the agent publishes its `Gossip` of tick k at once. The round is played when
the gossips of all expected peers are in, or at the deadline; `run_round` computes what follows from it. Exceptions: an agent that joins
opens no round yet, a slower pace leaves ticks out, and when gossips come late the round that is *due* at the end of a tick is that of an
earlier one.

This file keeps the order of events and the time. `agents.round` holds the steps of a round, `agents.tracking` and `agents.coverage` their
mathematics.
"""

from collections import Counter
from dataclasses import replace
from itertools import chain

from agents.backend import PLAIN, Backend
from agents.config import AgentConfig
from agents.coverage.keep_apart import keep_apart
from agents.gossip import message_builders
from agents.gossip_history import OpenRound
from agents.interest.manager import InterestManager
from agents.look_ahead import look_ahead
from agents.membership.announcements import REPLY_DELAY
from agents.membership.listening import Listening
from agents.membership.local_health import LocalHealth
from agents.membership.membership import Membership
from agents.membership.peer_table import ACCEPTED, OWN, UNASKED, PeerTable
from agents.open_rounds import OpenRounds
from agents.own_pose import OwnPose
from agents.pace import Pace
from agents.round import RoundResult, context_of, result_at_start, run_round
from agents.round_alone import is_claim_valid, predict_missed_ticks, unsent_gossip, update_without_gossips
from agents.tracking.extraction import forecast
from protocol.keys import all_of, one_of, tokens_of
from protocol.messages import Beacon, Gossip, Hello, Observation
from protocol.node import NO_EFFECTS, Alive, Batch, Effect, Event, Gone, Node, Received, Rejected, Started, Subscribe, Timer

NO_WAKE_UP = 1 << 30
NOWHERE = 0.0, 0.0, -1.0, -1.0  # the box of an agent that has not chosen its peers yet
MOST_OVERDUE = 0.5  # of the time for which a round waits: when it closes later, its agent was not served in time


class Agent(Node):
    """The Node of one sensor. Its rounds follow the ticks of the observations; `counters` counts what happened, by name."""

    role = "agent"

    def __init__(self, config: AgentConfig, name: str, incarnation: int = 1, backend: Backend = PLAIN, sensor_class: str = "") -> None:
        """`incarnation` grows with every restart under the same name; `sensor_class` empty: the one that the roster names."""
        self.name, self.incarnation, self.run = name, incarnation, config.run.name
        self.config = config
        self.coalesced_keys = "" if config.timing.look_ahead else "/gossip/"  # no gossip waits where it is measured how late they come
        self.counters: Counter[str] = Counter()
        self.peer_table = PeerTable(config, name)
        self.tick = -1  # of the newest observation; -1: none has come
        self.context = context_of(config, name, sensor_class or config.members[name], backend, incarnation)
        self.neighbours_only = self.peer_table.neighbours_only
        self.sees_all_tokens = not self.neighbours_only
        self._interest = InterestManager(self.context, self.peer_table) if self.neighbours_only else None
        self.outcome = result_at_start(self.context, NOWHERE if self.neighbours_only else None)
        self.membership = Membership(self.context, self.peer_table, self.counters)
        self._observation: Observation | None = None  # of the open tick
        self._gossip: Gossip | None = None  # the own one of the open tick; None: no tick is open
        self._rounds = OpenRounds(self.context)
        self._own_pose = OwnPose(config, self.context.sensor)
        self._awaited: set[str] = set()  # peers for whose gossips the round that is due waits
        self._listening = Listening(config.timing)
        self._close_at: float | None = None
        self._answer_at: float | None = None
        self._opened_at = 0.0
        self._newest_tick = -1  # of the newest observation, played or not
        self._busy_since: float | None = None  # when the driver was asked to come back at once: the next event ends its busy time
        self._gossip_free: list[Observation] = []  # of ticks that the pace leaves out; those that are not played yet
        self._gossip_free_count = 0  # how many ticks were gossip-free since the last shared one
        self._estimated = -1  # tick of the newest estimate
        self._ahead_at: float | None = None  # at a slower pace: when to compute a command early, once the own gossip is out
        self._round_seconds = 0.0  # from the opening of the last shared round to its end
        self._pace = Pace(config.run.dt / config.run.rate, measured=config.run.clock == "realtime")
        self._health = LocalHealth(measured=config.run.clock == "realtime")

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event at `now`, s. Return the effects in order; `NO_EFFECTS` where the deadline stays as it was, too (Node)."""
        if self._busy_since is not None:
            self._pace.note_busy(now - self._busy_since)
            self._busy_since = None
        if self._health.note_event(now):
            self._pace.forget()
            self._rounds.lag.forget()
        if type(event) is Received:
            return self._on_batch(event.batch, now)
        match event:
            case Timer():
                return self._on_timer(now)
            case Alive():
                return self.membership.alive(event, now)
            case Gone():
                if event.role == "body" and event.name == self.name:
                    self._pace.forget()  # ticks that do not come are not missed for want of time
                tick = self.tick if event.role == "body" else self._newest_tick
                if self.membership.gone(event, tick, suspected=self._health.has_just_stalled(now)):
                    self._awaited.discard(event.name)
                    return self._close_if_complete(now)
            case Started():
                expressions = [*self._expressions(), one_of(self.run, "observation", self.name)]
                return [*map(Subscribe, expressions), self.membership.start(now)]
            case Rejected(reason=reason):
                self.counters[f"rejected.{reason}"] += 1
        return []

    def _on_batch(self, batch: Batch, now: float) -> list[Effect]:
        """Take messages of one kind that arrived together."""
        if batch.kind is Gossip:
            return self._on_gossips(batch, now)
        if batch.kind is Beacon:
            return self._on_beacons([message for message in batch.messages if message.sender != self.name], now)
        if batch.kind is Hello:
            return self.membership.take_hellos(batch, now)
        self._measure_busy_time(now)
        observed = [self._on_observation(message, now) for message in batch.messages if isinstance(message, Observation)]
        return [*chain.from_iterable(observed), *self._play_gossip_free()]

    def _expressions(self) -> list[str]:
        """The key expressions to which the agent subscribes at the start."""
        if not self.neighbours_only:
            return [all_of(self.run, "hello"), all_of(self.run, "gossip")]
        return [one_of(self.run, "hello", "world"), tokens_of(self.run, "agent", self.name), tokens_of(self.run, "world", "world")]

    @property
    def wake_up_count(self) -> int:
        """The number of gossips for which the open round waits (Node). Without an open round, gossips wait for the observation."""
        return len(self._awaited) if self._gossip else NO_WAKE_UP

    @property
    def most_observations(self) -> int:
        """As many observations may wait as the pace has ticks: one of them is played with peers (Node)."""
        return self._pace.current

    def deadline(self) -> float | None:
        """When to call with `Timer`, s (Node): when the first of these is due.

        They are the end of the tick, the early command of a slower pace, a Hello, a beat of the local health, the moment after an event
        (it tells how long the driver was busy), an answer to a beacon, and the next step of joining.
        """
        times = [self._close_at, self._ahead_at, self.membership.announcements.due, self._health.due, self._busy_since]
        if self._interest is not None:
            times += [self._answer_at, self._interest.due]
        return min([time for time in times if time is not None], default=None)

    def _on_observation(self, observation: Observation, now: float) -> list[Effect]:
        """Close a round that is still open, and open that of the observation. An old observation is counted and ignored."""
        if observation.incarnation < self.membership.world_incarnation or observation.tick <= self._newest_tick:
            self.counters["rejected.old_observation"] += 1
            return []
        self.membership.world_incarnation = observation.incarnation
        self.membership.session_watchdog.note_messages((observation.sender,), now)
        self._newest_tick = observation.tick
        self._pace.observe(observation.tick, now)
        if not self._pace.is_shared(observation.tick):
            self._take_gossip_free(observation)
            return []
        effects = self._close(now, forced=True) if self._gossip else self._play_gossip_free()
        if self.tick < 0:
            self._health.start(now)
            self._listening.start(is_late=observation.tick > 0)
        elif observation.tick > self.tick + 1:
            self.counters["skipped"] += max(0, observation.tick - self.tick - 1 - self._gossip_free_count)
        self._gossip_free_count, observation = 0, self._own_pose.correct(observation)
        self.tick, self._observation, self._opened_at = observation.tick, observation, now
        self.membership.announcements.observation_arrived(now)
        if self._interest is not None and not self._interest.settled:
            return [*effects, *self._interest.start(observation, self.outcome, now)]
        return [*effects, *self._open_round(observation, now)]

    def _take_gossip_free(self, observation: Observation) -> None:
        """Take the observation of a gossip-free tick: none are sent, to keep the pace."""
        self._gossip_free_count += 1
        self.counters["spared"] += 1
        if self.outcome.round_cell is not None:  # else no round has been played yet
            self._gossip_free.append(self._own_pose.correct(observation))

    def _play_gossip_free(self) -> list[Effect]:
        """Play the gossip-free ticks alone, unless a shared round is still open: their estimates, and the command of the last."""
        if self._rounds:
            return []
        observations, self._gossip_free = self._gossip_free, []
        effects: list[Effect] = []
        for observation in observations:
            own = unsent_gossip(self.context, self.outcome, observation, self._own_pose.noise)
            if is_claim_valid(self.config, self.outcome.belief, own.tick, self._pace.current):
                steers = self._pace.has_time and observation is observations[-1]
                ticks = self._ticks_to_last(own.tick) if steers else 0
                self.outcome = update_without_gossips(self.context, self.outcome, own, ticks)
                effects += [*self._estimate(self.outcome, own), *(self._steer(self.outcome, observation) if steers else [])]
            else:
                moved = forecast(self.outcome.estimates, (own.tick - self.outcome.belief.tick) * self.config.run.dt)
                effects += self._estimate(replace(self.outcome, estimates=moved), own)
        return effects

    def _play_ahead(self, *, steers: bool) -> list[Effect]:
        """Play the tick of the open round alone, as gossips may come late: the estimate or, if it steers, the command. The belief stays."""
        own, observation = self._gossip, self._observation
        assert own is not None and observation is not None
        if self._rounds.due != own.tick or not is_claim_valid(self.config, self.outcome.belief, own.tick, self._pace.current):
            return []
        ahead = update_without_gossips(self.context, self.outcome, own, self._ticks_to_last(own.tick) if steers else 0)
        return self._steer(ahead, observation) if steers else self._estimate(ahead, own)

    def _estimate(self, outcome: RoundResult, own: Gossip) -> list[Effect]:
        """The estimate of the tick of `own`, where one is due and none has been said."""
        if own.tick % self.config.timing.estimate_every or own.tick <= self._estimated:
            return []
        self._estimated = own.tick
        counters, seconds, pace = self.counters, self._round_seconds, self._pace.current
        return [message_builders.estimate(self.context, outcome, own, counters, seconds, pace)]

    def _ticks_to_last(self, tick: int) -> int:
        """About how long a command of a tick will last: as long as nothing was played before it, at most the pace. 0: it has been given."""
        return min(self._pace.current, tick - self.outcome.belief.tick) if tick > self._own_pose.steered else 0

    def _steer(self, outcome: RoundResult, observation: Observation) -> list[Effect]:
        """The command of a result, such that it keeps the body away from what it senses and from where gossips of this tick say peers are.

        None where the tick of the observation has had one: a result that was computed early was in time.
        """
        if observation.tick <= self._own_pose.steered:
            return []
        command = outcome.command
        if self.config.limits.radius:
            newest = [self.peer_table.inbox.newest(name, observation.tick) for name in self.peer_table.interest_set]
            others = [peer.pose[:2] for peer in newest if peer is not None and peer.tick == observation.tick]
            others += [(x, y) for x, y in observation.obstacles.tolist()]
            seconds = self.config.run.dt * self._pace.current
            command = keep_apart(command, observation.pose[:2], others, self.config.limits, seconds)
        self._own_pose.note_command(command, observation.tick)
        return [message_builders.command(self.context, command, observation.tick)]

    def _open_round(self, observation: Observation, now: float) -> list[Effect]:
        """Open the round: publish the own gossip, and determine which gossips it waits for."""
        self._pace.open(self.tick, now)
        self._measure_busy_time(now)
        self._keep_claim(observation)
        listening, need, lag, noise = bool(self._listening), self._pace.need, self._rounds.lag.need, self._own_pose.noise
        behind = self._rounds.behind(self.tick, self.outcome.belief.tick)
        own = self._gossip = message_builders.gossip(
            self.context, self.outcome, observation, listening=listening, pace=need, behind=behind, lag=lag, pose_noise=noise
        )
        self._rounds.open(own, self.outcome.belief, now)
        self._await()
        self._close_at = now + self.config.gossip_timeout(missed=self.peer_table.any_missed()) * self._pace.current
        if self._pace.current > 1:
            self._ahead_at = now
            return [own, *self._play_ahead(steers=False)]
        return [own, *self._close_if_complete(now)]

    def _await(self) -> None:
        """Determine the round that is due, and the gossips for which it waits."""
        due = self._rounds.find_due(self.tick)
        self._awaited = set() if due is None else self.peer_table.missing(due, newcomer=bool(self._listening))

    def _keep_claim(self, observation: Observation) -> None:
        """Keep the claim over ticks of which nothing was seen, as long as peers keep the generator of the silent agent."""
        all_played = self._health.is_measuring and not self._rounds
        if all_played and is_claim_valid(self.config, self.outcome.belief, self.tick - 1, self._pace.current):
            own = unsent_gossip(self.context, self.outcome, observation, self._own_pose.noise)
            self.outcome = predict_missed_ticks(self.context, self.outcome, own, self._pace.current)

    def _join(self, now: float) -> list[Effect]:
        """Ask for peers until the interest manager is settled. Then start the filter around the expected cell and open the first round."""
        observation, interest = self._observation, self._interest
        assert observation is not None and interest is not None
        effects = interest.on_timer(observation, self.outcome, now)
        if not interest.settled:
            return effects
        self.outcome = result_at_start(self.context, interest.surroundings(observation, self.outcome))
        return [*effects, *self._open_round(observation, now)]

    def _on_gossips(self, batch: Batch, now: float) -> list[Effect]:
        """Take gossips that arrived together. The open round closes when none is awaited any more."""
        if self.name in batch.senders:
            for message in batch.messages:
                if message.sender == self.name and message.incarnation > self.incarnation:
                    return self.membership.fence(message.incarnation)
        if not self.neighbours_only:
            self.membership.session_watchdog.note_messages(batch.senders, now)
        if self.tick < 0:
            self.membership.announcements.run_started()
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
        tick = self.tick if self._rounds.due is None else self._rounds.due
        reasons = self.peer_table.accept(batch, start, tick, self._awaited if self._gossip is not None else None)
        accepted = [gossip for gossip, reason in zip(batch.messages[start:], reasons) if not reason]
        for reason in dict.fromkeys(reasons):
            if reason not in (ACCEPTED, OWN, UNASKED):
                self.counters[f"rejected.{reason}"] += reasons.count(reason)
        if accepted:
            self.counters["heard"] += len(accepted)
            self._rounds.hear(accepted, self.peer_table.interest_set, now)
        reopenings = self._reopen_if_behind(accepted, now) if self._interest is not None else []
        if self._gossip is not None and not self._awaited:
            return [*reopenings, *self._close(now)], len(reasons)
        return reopenings or NO_EFFECTS, len(reasons)

    def _reopen_if_behind(self, gossips: list[Gossip], now: float) -> list[Effect]:
        """The effects that open a new session, if peers have been more than one tick ahead for long; else none."""
        assert self._interest is not None
        if not any(gossip.tick > self._newest_tick + 1 for gossip in gossips):
            return []
        reopenings = self._interest.reopen_if_behind(self.tick, now)
        self.counters["reopened"] += len(reopenings)
        return reopenings

    def _on_beacons(self, beacons: list[Beacon], now: float) -> list[Effect]:
        """Take the beacons of other agents, and plan an answer if one of them needs it."""
        if self._interest is None:
            return NO_EFFECTS
        refused = self.peer_table.agreement.with_others(beacons)
        warnings = self.peer_table.agreement.refuse(refused, self.counters) if refused else NO_EFFECTS
        if not self._interest.take_beacons([beacon for beacon in beacons if beacon not in refused] if refused else beacons):
            return warnings
        self._answer_at = now + REPLY_DELAY if self._answer_at is None else self._answer_at
        return [*warnings]

    def _on_timer(self, now: float) -> list[Effect]:
        """Do everything that is due."""
        effects = self.membership.announce_if_due(now, has_observed=self.tick >= 0)
        if self._interest is not None:
            effects += self._on_interest_timer(self._interest, now)
        if self._ahead_at is not None:
            self._ahead_at = None
            self._measure_busy_time(now)
            effects += self._close_if_complete(now)
            effects += self._play_ahead(steers=True) if self._gossip is not None else []
        if self._close_at is not None and now >= self._close_at:
            self.counters["late"] += 1
            effects += self._close(now, forced=True)
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
        reopenings = interest.reopen_if_unheard(self.outcome.belief.tick, now)
        if reopenings:
            self.counters["reopened"] += 1
        effects = [*interest.close_round(gossip, self.outcome, self._own_pose.command), *reopenings]
        # in place, for the history of a late agent holds the same belief and replays its merge
        self.outcome.belief.generator_names &= self.peer_table.interest_set.keys() | {self.name}
        return effects

    def _close_if_complete(self, now: float) -> list[Effect]:
        """Close the open tick if its rounds await no gossip."""
        if self._gossip is None or self._awaited:
            return []
        return self._close(now)

    def _close(self, now: float, *, forced: bool = False) -> list[Effect]:
        """Play the rounds that are due, and end the tick. Each waits for its gossips, unless the end of the tick is `forced`.

        Even then a round that has heard hardly anybody may be left for a later tick (`_postpones`).
        """
        while self._rounds.due is not None:
            if self._awaited and (not forced or self._postpones(self._rounds.due, now)):
                break
            self._play(self._rounds.pop(), now)
            self._await()
        return NO_EFFECTS if self._awaited and not forced else self._end_tick(now)

    def _postpones(self, due: int, now: float) -> bool:
        """Whether the round that is due waits for another tick, because hardly any gossip has come."""
        if self._listening or self._pace.current > 1 or not self._was_responsive(now):
            return False
        return self._rounds.postpones(due, self.tick, self._awaited, len(self.peer_table.fresh(due)))

    def _play(self, opened: OpenRound, now: float) -> None:
        """Play a round. If it is that of the open tick, it gives the command; after an older one the look-ahead does."""
        gossip, newcomer = opened.gossip, bool(self._listening)
        fresh = self.peer_table.fresh(gossip.tick)
        replay, ticks = self._rounds.replay(opened, fresh), self._ticks_to_last(self.tick) if gossip.tick == self.tick else 0
        self.outcome = run_round(self.context, self.outcome, self.peer_table, gossip, fresh, replay, ticks)
        self._rounds.recent.keep(self.outcome.belief)
        missing = self.peer_table.close(gossip.tick, newcomer=newcomer, responsive=self._was_responsive(now))
        self._listening.count(len(fresh), missing)
        self.counters["missing"] += missing
        self.counters["rounds"] += 1

    def _end_tick(self, now: float) -> list[Effect]:
        """End the open tick; the effects are its command and, where due, its estimate and the changes of interest."""
        observation, gossip = self._observation, self._gossip
        assert observation is not None and gossip is not None
        if self.outcome.belief.tick < self.tick:
            self.outcome = look_ahead(self._rounds.recent, self.context, self.outcome, gossip, self._ticks_to_last(self.tick))
            self.counters["looked_ahead"] += 1
        self._keep_pace(now)
        self._observation, self._gossip, self._close_at, self._ahead_at, self._awaited = None, None, None, None, set()
        self._measure_busy_time(now)
        self._round_seconds = max(0.0, now - self._opened_at)  # a clock may have jumped
        commands = self._steer(self.outcome, observation)
        effects = self._update_interest(self._interest, gossip, now) if self._interest else []
        return [*effects, *self._estimate(self.outcome, gossip), *commands, *self._play_gossip_free()]

    def _keep_pace(self, now: float) -> None:
        """Judge the pace and the lag at the end of a tick."""
        self._pace.close(self.tick, self.peer_table.slow_paces())
        self.peer_table.keep_pace(self._pace.current)
        self._rounds.end_tick(self.tick, self._pace.current, now)
        for name, count in (("stalled_ms", round(1000.0 * self._health.stalled)), ("given_up", self.peer_table.silence_timeouts)):
            if count:
                self.counters[name] = count

    def _measure_busy_time(self, now: float) -> None:
        """Ask the driver for an event as soon as it has done what it is told, which shows how long that took."""
        self._busy_since = now if self._health.is_measuring else None

    def _was_responsive(self, now: float) -> bool:
        """Whether the silence of a peer in the open round says something: the agent was served in time, and all keep its pace."""
        assert self._close_at is not None
        overdue = now - self._close_at > MOST_OVERDUE * (self._close_at - self._opened_at)
        if not self._health.is_measuring:
            return True
        return not (overdue or self._health.has_stalled_since(self._opened_at) or self._pace.has_just_fallen(self.tick))
