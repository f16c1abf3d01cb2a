"""The scorer: a Node that receives truth and estimates and scores every tick. It is the same live and in a simulation.

A tick is scored when the estimates of all live agents have arrived, or when the world is far ahead. Hole and overlap are exact
areas of the published cells of live agents, as shares of the arena.
"""

import hashlib
import math
from collections.abc import Callable

import numpy as np

from deploy.scenario import Scenario, agent_config, bodies_of, has_targets, in_team_order, world_config
from deploy.scoring.chronicle import Chronicle, ScoredTick
from deploy.scoring.deaths import Deaths, ends_run
from deploy.scoring.result import EventReport, Fault, Result, Tally
from deploy.scoring.scores import NO_SCORE, Coverage, Score, figures, hole_and_overlap
from deploy.scoring.status import AgentStatus, Status
from deploy.scoring.tick_rate import TickRateMeter
from deploy.scoring.tracks import TrackLog
from protocol.codec import encode
from protocol.geometry import polygon_area
from protocol.keys import all_of
from protocol.messages import Gossip, Hello
from protocol.node import Alive, Effect, Event, Gone, Node, Received, Rejected, Started, Subscribe, received
from protocol.observer_messages import Estimate, Truth
from protocol.session_watchdog import ListenerWatchdog
from protocol.settings_digest import differing_settings
from world.newest_tick import NewestTick
from world.presence import Presence
from world.score import errors
from world.witness import Witness

MOST_GUESTS = 256  # agents with a token that are no members: anybody can make up names, and each is a row of every table
NO_POINTS = np.empty((0, 2))
LAG = {"realtime": 2, "lockstep": 20}  # ticks; in lockstep nothing is late unless it is lost
LAG_SECONDS = {"realtime": 0.0, "lockstep": 2.0}  # for which the world must have been so far ahead


def witness_of(scenario: Scenario, name: str, incarnation: int) -> Witness | None:
    """Who computes the Truths for a watcher of this name; None where a world says them."""
    clock = scenario.run.clock
    return Witness(world_config(scenario), name, incarnation, LAG[clock], LAG_SECONDS[clock]) if bodies_of(scenario) else None


class Scorer(Node):
    """The Node that scores a run; `finish` before the agents are dismissed, then `result`."""

    role = "monitor"

    def __init__(
        self, scenario: Scenario, name: str = "monitor", incarnation: int = 1, *, scores: bool = True, recorded: bool = False
    ) -> None:
        """`scores` false: ticks are counted but not scored, because the assignment of thousands of targets takes longer than a tick.

        `recorded`: it hears a recording, which holds the Truths in any case.
        """
        self.run, self.name, self.incarnation = scenario.run.name, name, incarnation
        self.last_tick = scenario.run.ticks - 1  # of the whole run
        self.scores: list[Score] = []
        self.truth: Truth | None = None  # the newest
        self.on_truth: Callable[[Truth], None] = lambda truth: None  # called with every new tick of the world
        self.on_event: Callable[[Event, float], None] = lambda event, now: None  # called first with every event: recorder, page
        self.missing: tuple[str, ...] = ()  # members that were not there at the first tick
        self.is_over = False  # the last tick is past and the world has ended, or a body: agents that leave are dismissed
        self.faults: list[Fault] = []  # ordered faults that no message shows
        self.on_fault: Callable[[Fault], None] = lambda fault: None
        self.on_report: Callable[[EventReport], None] = lambda told: None  # called with the effect of an event, once it is known
        self.on_scored: Callable[[Truth, np.ndarray], None] = lambda truth, estimates: None  # called with every scored tick
        self.on_finish: Callable[[], None] = lambda: None  # called once all is scored
        self.on_twin: Callable[[str, int, int], None] = lambda name, known, other: None  # called when a second process has a name
        self.on_differing: Callable[[str, tuple[str, ...]], None] = lambda name, fields: None  # called when settings differ
        self.newest: dict[tuple[str, str], int] = {}  # largest incarnation of each member and the world that had a token, by role and name
        self.greeted: set[str] = set()  # names of processes with at least one Hello, and of bodies with a token
        self.deaths = Deaths()
        self.tick_rate = TickRateMeter(scenario)
        self._settings = agent_config(scenario).shared_settings()
        self._differing: dict[str, tuple[str, ...]] = {}  # by name: the fields in which settings differ
        self._scenario = scenario
        self._bodies = bodies_of(scenario)
        self._witness = None if recorded else witness_of(scenario, name, incarnation)
        self._watchdog = ListenerWatchdog(scenario.members, scenario.network.lease)
        self._area = scenario.arena.width * scenario.arena.height
        self._coverage = Coverage(scenario)
        self.tracks = TrackLog(scenario)
        self._lag = LAG[scenario.run.clock]
        self._ahead = NewestTick(LAG_SECONDS[scenario.run.clock])
        self._fresh = max(agent_config(scenario).ticks_of_silence, 2 * scenario.timing.estimate_every)  # ticks
        self._names = dict.fromkeys(scenario.members)  # the agents that are scored, in team order
        self._presence = Presence(scenario.members)
        self._gone_at: dict[str, tuple[float, int]] = {}  # when an agent was lost last, s, and its incarnation then
        self._truths: dict[int, Truth] = {}
        self._estimates: dict[int, dict[str, Estimate]] = {}
        self._latest: dict[str, Estimate] = {}  # of each agent
        self._counting: dict[str, Estimate] = {}  # of each agent the newest of a tick that is scored or past
        self._next = 0
        self._chronicle = Chronicle()
        self._events: list[EventReport] = []
        self._tally = Tally()
        self._keeps_scores = scores
        self._checked = -1, 0  # a tick, and how many live agents have answered it, counted from the first
        self._transcript = hashlib.blake2b(digest_size=16)
        self._finished = False

    def deadline(self) -> float | None:
        """None: late estimates are noticed at the next ticks of the world."""
        return None

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to do. Without a world the Truths come from the witness."""
        self._take(event, now)
        if self._witness is not None:
            for truth in self._witness.take(event, now):
                self._take(received(truth, payloads=(encode(truth),)), now)
        if isinstance(event, Started):
            kinds = "truth", "estimate", "gossip", "observation", "command", "hello", "halt"
            return [Subscribe(all_of(self.run, kind)) for kind in kinds]
        return self._watchdog.take(event, now)

    def _take(self, event: Event, now: float) -> None:
        self.on_event(event, now)
        self.is_over = self.is_over or ends_run(event, self.truth, self.last_tick + 1)
        if isinstance(event, Alive) and event.name in ("world", *self._scenario.members):
            self.newest[event.role, event.name] = max(event.incarnation, self.newest.get((event.role, event.name), 0))
        match event:
            case Received(batch=batch):
                self._tally.messages += len(batch)
                self._tally.bytes += sum(map(len, batch.payloads))
                for message in batch.messages:
                    self._hear(message, now)
                if batch.kind not in (Truth, Estimate):
                    return  # nothing that could complete a tick
            case Alive(role="agent") if self._admits(event.name):
                self._gain(event.name, event.incarnation)
                if event.name not in self._names:
                    self._names = dict.fromkeys(in_team_order(self._scenario, {*self._names, event.name}))
            case Alive(role="body") if event.name in self._names:
                self.greeted.add(self._bodies.get(event.name, event.name))
            case Gone(role="body" | "world") if event.name in (*self._names, "world"):
                self.tick_rate.excuse(event.name)
            case Gone(role="agent") if not self.is_over and self._presence.vanish(event.name, event.incarnation):
                self._lose(event.name, event.incarnation, now)
            case Rejected():
                self._tally.rejected += 1
        self._score_what_is_complete(now)

    def _admits(self, name: str) -> bool:
        """Whether an agent of this name is scored: a member, or one of the first guests."""
        return name in self._names or len(self._names) < len(self._scenario.members) + MOST_GUESTS

    def _hear(self, message: object, now: float) -> None:
        if isinstance(message, Truth):
            self._hear_truth(message, now)
        elif isinstance(message, Estimate) and message.sender in self._names:
            self._hear_estimate(message)
        elif isinstance(message, Gossip):
            self._compare_mass(message)
        elif isinstance(message, Hello) and (message.sender in self._names or message.role == "world"):
            self.greeted.add(message.sender if message.role == "agent" else message.role)
            self._compare_settings(message)

    def _compare_settings(self, hello: Hello) -> None:
        """Report the settings of an agent that differ from those of the run; its peers refuse it."""
        differs = differing_settings(self._settings, hello.settings)
        if differs != self._differing.get(hello.sender, ()):
            self._differing[hello.sender] = differs
            if differs:
                self.on_differing(hello.sender, differs)

    def _hear_truth(self, truth: Truth, now: float) -> None:
        if not self._next <= truth.tick <= self.last_tick or (self.truth is not None and truth.tick <= self.truth.tick):
            return
        self.tick_rate.tick(now, truth.tick)
        self._truths[truth.tick] = self.truth = truth
        self._ahead.hear(truth.tick, now)
        self.on_truth(truth)

    def _hear_estimate(self, estimate: Estimate) -> None:
        latest = self._latest.get(estimate.sender)
        is_old = latest is not None and (estimate.incarnation, estimate.tick) <= (latest.incarnation, latest.tick)
        if is_old or estimate.tick > self.last_tick:
            return
        self._latest[estimate.sender] = estimate
        self.tick_rate.count(estimate)
        if estimate.tick >= self._next:
            self._estimates.setdefault(estimate.tick, {})[estimate.sender] = estimate
        else:
            self._counting[estimate.sender] = estimate

    def _compare_mass(self, gossip: Gossip) -> None:
        """The mass that an agent reports must be the sum of what it publishes. At a slower pace its estimate is of another round."""
        estimate = self._latest.get(gossip.sender)
        if estimate is None or estimate.pace > 1 or not gossip.claim_names:
            return
        if (estimate.incarnation, estimate.tick) == (gossip.incarnation, gossip.claim_tick):
            published = gossip.weight * len(gossip.ids) + math.fsum(gossip.components["weight"].tolist())
            self._tally.residual = max(self._tally.residual, abs(estimate.mass - published))

    def _lose(self, name: str, incarnation: int, now: float) -> None:
        """The incarnation that counted has gone. Where an older process of this name lives, that one counts again."""
        if self._presence.live(name) is not None:
            self._latest.pop(name, None)  # else the words of the older one would count as old
            return
        self.tick_rate.forget(name)
        if self._finished or self.truth is None:
            return
        self._gone_at[name] = self.truth.time, incarnation
        if name not in self.deaths.paused:  # a pause was told when it began
            self.deaths.lose(name, self.truth.tick, self.truth.time, now, self._last_cell(name))
            self._chronicle.lose(name, "died", self.truth.tick, self.truth.time)

    def _last_cell(self, name: str) -> np.ndarray:
        return self._latest[name].cell if name in self._latest else NO_POINTS

    def _gain(self, name: str, incarnation: int) -> None:
        known = self._presence.live(name)
        self._presence.appear(name, incarnation)
        if known not in (None, incarnation):
            self.on_twin(name, known, incarnation)
        if known is None and name in self._gone_at and self.truth is not None:
            lost_at, before = self._gone_at[name]
            same = before == incarnation
            self._chronicle.regain(name, self.truth.tick, same=same)
            if same and name not in self.deaths.paused:
                self.deaths.regain(name, lost_at)

    def _score_what_is_complete(self, now: float) -> None:
        while self.truth is not None and not self._finished:
            ahead = self._ahead.at(now)
            late = ahead - self._next >= self._lag
            truth = self._truths.get(self._next)
            if truth is None and late:
                self._forget(self._next)
            elif truth is not None and (late or self._is_complete(truth, ahead)):
                self._score(truth, now)
                self._forget(truth.tick)
            else:
                return

    def _forget(self, tick: int) -> None:
        self._truths.pop(tick, None)
        self._count_until(tick)
        self._next = tick + 1

    def _count_until(self, tick: int) -> None:
        """From now on each agent's newest estimate of a tick up to this one counts."""
        for past in sorted(known for known in self._estimates if known <= tick):
            self._counting.update(self._estimates.pop(past))

    def _is_complete(self, truth: Truth, ahead: int) -> bool:
        """Whether all live agents that received this tick have answered; ticks without estimates wait for the next one.

        Guests may be of another make, and need not publish estimates: they are waited for until the world is `ahead` of the tick.
        """
        if truth.tick % self._scenario.timing.estimate_every:
            return truth.tick + 1 in self._truths
        said = self._estimates.get(truth.tick, {})
        tick, place = self._checked
        place = place if tick == truth.tick else 0
        while place < len(truth.alive):
            name = truth.alive[place]
            is_awaited = ahead <= truth.tick or name in self._scenario.members
            if is_awaited and name not in said and self._presence.live(name) is not None:
                break
            place += 1
        self._checked = truth.tick, place
        return place == len(truth.alive)

    def _score(self, truth: Truth, now: float) -> None:
        if not self._keeps_scores:
            return
        said = self._estimates.get(truth.tick, {})
        self._transcript.update(truth.poses_bytes)
        for name in self._names:
            if name in said:
                self._transcript.update(said[name].targets_bytes + said[name].labels_bytes)
        self._count_until(truth.tick)
        counted = [self._counting[name] for name in self._names if name in self._counting]
        counted = [estimate for estimate in counted if self._presence.live(estimate.sender) == estimate.incarnation]
        counted = [estimate for estimate in counted if estimate.tick >= truth.tick - max(self._fresh, 2 * estimate.pace)]
        dt = self._scenario.run.dt
        targets = np.concatenate([NO_POINTS, *[estimate.targets_at(truth.tick, dt) for estimate in counted]])
        one_view = len({estimate.diagram_hash for estimate in counted}) == 1
        hole, overlap = hole_and_overlap([estimate.cell for estimate in counted], self._area, one_view=one_view)
        distance, parts = errors(truth.targets, targets, self._scenario.study.cutoff)
        score = Score(
            tick=truth.tick,
            time=truth.time,
            ospa=distance,
            gospa=parts.total,
            targets=len(truth.targets),
            in_view=truth.in_view,
            estimated=len(targets),
            mass=math.fsum(estimate.mass for estimate in counted),
            hole=hole,
            overlap=overlap,
            localisation=parts.localisation,
            missed=parts.missed,
            false=parts.false,
            coverage=self._coverage.share(truth),
        )
        self.scores.append(score)
        self.tracks.see(truth, counted, targets)
        self.on_scored(truth, targets)
        cells = {estimate.sender: estimate.cell for estimate in counted}
        cutoff = self._scenario.study.cutoff
        view = ScoredTick(truth.tick, truth.time, cells, truth.ids, truth.targets, targets, hole, overlap, cutoff)
        self._tell(self._chronicle.see(view))
        self.deaths.see(view, now)

    def finish(self, now: float, *, failed: bool = False) -> None:
        """The run is over: score the remaining ticks. An agent that leaves from now on is not lost.

        `failed`: an error has ended it, which a sensor of the user's may raise again here; the remaining ticks are not scored.
        """
        while self._truths and not self._finished and not failed:
            tick = min(self._truths)
            self._score(self._truths[tick], now)
            self._forget(tick)
        self._tell(self._chronicle.finish())
        self._finished = True
        self.on_finish()

    def _tell(self, sentences: list[EventReport]) -> None:
        for told in sentences:
            self._events.append(told)
            self.on_report(told)

    def note_fault(self, verb: str, text: str, who: str = "", now: float = 0.0, sides: int = 1) -> None:
        """Note an ordered fault that no message shows, such as a cut or a pause; `who` and `sides` as in `Fault`."""
        self.faults.append(Fault(self.truth.time if self.truth else 0.0, verb, text, who, sides))
        names = [name for name in who.split(",") if name]
        if verb == "pause":
            self._begin_pause(names)
        elif verb in ("resume", "kill", "restart"):
            self._end_pause(verb, names, now)
        elif verb in ("partition", "heal") and self.truth is not None:
            self._chronicle.cut(verb, self.truth.tick, sides)
        self.on_fault(self.faults[-1])

    def _begin_pause(self, names: list[str]) -> None:
        """These agents are paused; the others take their cells when they have been silent for some rounds."""
        for name in names:
            self.deaths.paused.add(name)
            self.tick_rate.excuse(name)
            if self._presence.live(name) is not None and self.truth is not None and not self._finished:
                self._chronicle.lose(name, "is paused", self.truth.tick, self.truth.time)

    def _end_pause(self, verb: str, names: list[str], now: float) -> None:
        """End the pauses of these agents. A killed one whose token is already lost counts as dead now."""
        for name in names:
            if verb == "resume":
                self.tick_rate.excuse(name)
                self._chronicle.resume(name)
            elif name in self.deaths.paused and self._presence.live(name) is None and self.truth is not None and not self._finished:
                self.deaths.lose(name, self.truth.tick, self.truth.time, now, self._last_cell(name))
            self.deaths.paused.discard(name)

    def is_up_to_date(self, *, whole: bool = False) -> bool:
        """Whether every truth that was heard has been scored; with `whole`, up to the last tick of the run."""
        return not self._truths and not (whole and self.truth is not None and self.truth.tick < self.last_tick)

    def alive(self) -> dict[str, int]:
        """Live agents and their incarnations, by their tokens, in team order."""
        return {name: live for name in self._names if (live := self._presence.live(name)) is not None}

    def status(self, now: float) -> Status:
        """The newest score and what is known of each agent at a time of the driver's clock, s."""
        last = self.scores[-1] if self.scores else NO_SCORE
        return Status(
            tick=last.tick,
            ticks=self._scenario.run.ticks,
            time=last.time,
            ospa=last.ospa,
            gospa=last.gospa,
            targets=last.targets,
            in_view=last.in_view,
            has_targets=has_targets(self._scenario),
            mass=last.mass,
            hole=last.hole,
            overlap=last.overlap,
            messages=self._tally.messages,
            tick_rate=self.tick_rate.at(now),
            agents=[self._agent_status(name) for name in self._names],
            arena=(self._scenario.arena.width, self._scenario.arena.height),
            places=_pairs([self.truth.targets] if self.truth else []),
            estimates=_pairs([self._latest[name].targets for name in self.alive() if name in self._latest]),
        )

    def _agent_status(self, name: str) -> AgentStatus:
        live = self._presence.live(name)
        status = AgentStatus(name=name, alive=live is not None, incarnation=live or 0)
        status.left_at = self._gone_at[name][0] if name in self._gone_at else None
        status.paused = name in self.deaths.paused
        status.differs = list(self._differing.get(name, ()))
        if self.truth is not None and name in self.truth.bodies:
            x, y, heading = self.truth.poses[self.truth.bodies.index(name)].tolist()
            status.pose = x, y, heading
        estimate = self._latest.get(name)
        if estimate is not None:
            status.tick, status.round_ms = estimate.tick, 1000.0 * estimate.round_seconds
            status.rounds, status.skipped = estimate.counters.get("rounds", 0), estimate.counters.get("skipped", 0)
            status.late, status.pace = estimate.counters.get("late", 0), estimate.pace
        if estimate is not None and status.alive:  # a dead agent owns nothing
            status.mass, status.targets = estimate.mass, len(estimate.targets)
            status.cell = polygon_area(estimate.cell) / self._area
        return status

    def result(self, wall_seconds: float | None, messages: int | None = None, payload_bytes: int | None = None) -> Result:
        """The record of the run; `messages` and `payload_bytes` where the driver has counted them better than this node can."""
        scenario = self._scenario
        return Result(
            scenario=scenario.run.scenario,
            seed=scenario.run.seed,
            partition=scenario.partition.kind,
            capacity=scenario.capacity.mode,
            control=scenario.control.mode,
            agents=len(scenario.members),
            missing=self.missing,
            dt=scenario.run.dt,
            wall_s=None if wall_seconds is None else round(wall_seconds, 3),
            mass_residual=self._tally.residual,
            messages=self._tally.messages if messages is None else messages,
            bytes=self._tally.bytes if payload_bytes is None else payload_bytes,
            rounds=self.tick_rate.rounds,
            kills=self.deaths.kills(),
            transcript=self._transcript.hexdigest(),
            events=tuple(self._events),
            **figures(self.scores, scenario),
            **self.tracks.figures(),
        )


def _pairs(parts: list[np.ndarray]) -> list[tuple[float, float]]:
    return [(round(x, 2), round(y, 2)) for part in parts for x, y in part.tolist()]
