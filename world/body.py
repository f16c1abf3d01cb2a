"""The Body node: the world's part for one agent. It keeps the pose, hands the agent its Observations and obeys its Commands.

A tick k: read the platform, publish Observation(k), then wait for the clock (real time) or for the agent's command (lockstep). Nobody
conducts: in real time a tick is a function of synchronised time (`world.clock`); in lockstep the agents' rounds hold the bodies together,
because a round closes with the gossips of all, and a gossip is sent when a body opens the tick.

The body stands still whenever its agent is not sure to be in charge: without a command for `bodies.hold` s, without the agent's token,
in a tick that was left out, while an operator's Halt holds, and at the end.
"""

import contextlib
import math

from protocol.fields import MAX_NAMES, pack
from protocol.keys import all_of, one_of
from protocol.measuring import to_measurements
from protocol.messages import BodyPose, Command, Gossip, Halt, Hello, Observation
from protocol.node import Alive, Batch, Effect, Event, Gone, Node, Received, Started, Stop, Subscribe, Timer, Unsubscribe
from protocol.observer_messages import Truth
from protocol.sensing import Pose, measurement_of
from protocol.session_watchdog import ListenerWatchdog
from protocol.settings import BadSetting, sensor_of
from world.bodies import check_given
from world.clock import AHEAD, TickClock, TickCount, neighbours
from world.commands import CommandBook
from world.config import WorldConfig
from world.halt import Hold
from world.platform import Physical, Platform, Simulated, build_platform, fenced
from world.presence import Presence
from world.proximity import around
from world.scene import Scene

LOOK_PERIOD = 0.25  # s between two looks at the start line
BACKLOG = 0.1  # s in which a body that was not served takes what has come meanwhile
EXIT_TWIN, EXIT_INCOMPLETE = 3, 4


class Body(Node):
    """The body of the agent of the same name. `unix`: the Unix time when `now` was 0, s. `restored`: a Truth with its last pose."""

    role = "body"

    def __init__(self, config: WorldConfig, name: str, incarnation: int, unix: float = 0.0, restored: Truth | None = None) -> None:
        if name not in config.members:
            raise BadSetting(f"--body {name}: the scenario has no such agent; it has {', '.join(config.members)}")
        check_given(config)
        self.run, self.name, self.incarnation = config.run.name, name, incarnation
        self.tick = -1
        self.pose: Pose = (0.0, 0.0, 0.0)  # as the platform said in this tick
        self.hold = Hold()  # by an operator
        self.ticks_without_command = 0  # that ended before their command came
        self.ignored_commands = 0
        self.platform: Platform = build_platform(name, config)
        if restored is not None and name in restored.bodies and isinstance(self.platform, Simulated | Physical):
            x, y, heading = restored.poses[restored.bodies.index(name)].tolist()
            self.platform.put((x, y, heading))
        self._config, self._presence = config, Presence(config.members)
        self._scene = Scene(config)
        self._scene.sensors[name] = sensor_of(config, config.members[name])
        self._lockstep = config.run.clock == "lockstep"
        self._period = config.run.dt / config.run.rate
        max_rate = config.run.max_rate if self._lockstep else 0.0
        self._pause = config.run.dt / max_rate if max_rate else 0.0
        self._hold_seconds = max(config.bodies.hold, 2.0 * self._period, 2.0 * self._pause)
        epoch = config.bodies.epoch if not self._lockstep else 0.0
        self._clock = TickClock(self._period, epoch - unix if epoch else None)
        self._count = TickCount()
        self._watchdog = ListenerWatchdog(config.members, config.network.lease)
        self._body_tokens = Presence()
        self._alive: dict[str, set[str]] = {"agent": set(), "body": {name}}  # by role: names with a token
        self._others: dict[str, Pose] = {}  # where the other bodies said last that they are
        self._ring: tuple[str, ...] = ()  # the neighbours to whom the clock listens
        self._expected, self._patience, self._strict = tuple(config.members), config.run.start_timeout, config.run.strict
        self._changed = 0.0  # when an agent came, until the start
        self._commands = CommandBook(lockstep=self._lockstep)
        self._waiting = False  # the command of this tick is missing; in lockstep the tick waits for it
        self._not_before = 0.0  # lockstep: when the tick may end
        self._due: float | None = None
        self._deaf_until = -math.inf  # until then gossips may have waited, and say nothing of the time
        self._driven_until: float | None = None  # when the command that drives the platform ends; None: it stands

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to do; an error stops the platform before it ends the process."""
        try:
            effects = self._handle(event, now)
        except Exception:
            self.end()
            raise
        return [*effects, *self._watchdog.take(event, now)]

    def end(self) -> None:
        """Stop the platform for good; what it answers does not count."""
        with contextlib.suppress(Exception):
            self._stand()

    def counts(self) -> dict[str, int]:
        """What went wrong so far, for the log."""
        corrections = self._clock.corrections
        return {
            "ticks_without_command": self.ticks_without_command,
            "ignored_commands": self.ignored_commands,
            "clock_corrections": corrections,
        }

    def expect(self, names: tuple[str, ...]) -> None:
        """Wait for these agents before the first tick, however long they take: a parent that sees their processes asks for it."""
        self._expected, self._patience = names, math.inf

    def deadline(self) -> float | None:
        """When the next tick is due, or the body is to stand."""
        return min((time for time in (self._due, self._driven_until) if time is not None), default=None)

    def _handle(self, event: Event, now: float) -> list[Effect]:
        if self._due is not None and now > self._due + AHEAD:  # a platform that takes long, or a process that was stopped
            self._deaf_until = now + BACKLOG
        match event:
            case Started():
                return self._begin(now)
            case Timer():
                return self._on_time(now)
            case Received(batch=batch):
                return self._on_batch(batch, now)
            case Alive(role="body", name=self.name):
                twin = event.incarnation > self.incarnation
                return self._stop(EXIT_TWIN, f"a younger body {event.incarnation} of {self.name} is alive") if twin else []
            case Alive(role="agent" | "body"):
                return self._greet(event, now)
            case Gone(role="agent" | "body"):
                return self._bury(event, now)
        return []

    def _begin(self, now: float) -> list[Effect]:
        self._changed = now
        self._due = now + LOOK_PERIOD if self._clock.anchor is None else max(now, self._clock.due(0))
        return [
            Subscribe(all_of(self.run, "hello")),
            Subscribe(one_of(self.run, "command", self.name)),
            Subscribe(all_of(self.run, "halt")),
            *([Subscribe(all_of(self.run, "pose"))] if self._config.limits.radius else []),
        ]

    def _on_batch(self, batch: Batch, now: float) -> list[Effect]:
        effects: list[Effect] = []
        for message in batch.messages:
            if isinstance(message, Gossip):
                if message.tick >= self._config.run.ticks:
                    continue  # no clock can be right that is beyond the end
                if now >= self._deaf_until:
                    self._clock.hear(message.sender, message.tick, now)
                self._count.hear(message.sender, message.tick)
            elif isinstance(message, Command):
                effects += self._obey(message, now)
            elif isinstance(message, Hello):
                effects += self._hear(message, now)
            elif isinstance(message, Halt) and self.hold.take(message):
                self._stand()
            elif isinstance(message, BodyPose) and message.sender != self.name and self._may_stand_there(message.sender):
                self._others[message.sender] = message.pose
        return [*effects, *self._follow(now)] if batch.kind is Gossip else effects

    def _may_stand_there(self, name: str) -> bool:
        """Whether the pose of a body counts: there is a limit to guests, for anybody can make up names."""
        return name in self._config.members or name in self._others or len(self._others) < MAX_NAMES

    # ------------------------------------------------------------------ who is there

    def _hear(self, hello: Hello, now: float) -> list[Effect]:
        if hello.role != "agent":
            return []
        is_new = self._presence.hear(hello)
        if not self._presence.admits(hello.sender):
            return []
        if is_new:
            self._changed = now
        return self._try_start(now) or ([] if self._started else self._follow(now))

    def _greet(self, event: Alive, now: float) -> list[Effect]:
        self._alive[event.role].add(event.name)
        effects = self._listen_around()
        is_new = self._presence_of(event).appear(event.name, event.incarnation)
        if event.role == "body" or not is_new:
            return effects
        self._changed = now
        if event.name == self.name and self._started:
            effects += self._dismiss(now)
        return [*effects, *self._try_start(now)]

    def _bury(self, event: Gone, now: float) -> list[Effect]:
        """Somebody has gone; without its agent the body stands still at once and waits for no command."""
        presence = self._presence_of(event)
        if presence.vanish(event.name, event.incarnation):
            if presence.live(event.name) is None:
                self._alive[event.role].discard(event.name)
            if event.role == "agent" and event.name == self.name:
                return [*self._listen_around(), *self._dismiss(now)]
        return self._listen_around()

    def _dismiss(self, now: float) -> list[Effect]:
        """The agent is no longer there, or another incarnation of it has come: the body stands still, and waits for no command."""
        self._commands.drop(self.name)
        self._stand()
        return self._end_of_wait(now) if self._waiting else []

    def _presence_of(self, event: Alive | Gone) -> Presence:
        return self._body_tokens if event.role == "body" else self._presence

    def _listen_around(self) -> list[Effect]:
        """The effects that subscribe to the gossips of the neighbours in the ring of those who have agent and body."""
        before, self._ring = self._ring, neighbours(self.name, self._alive["agent"] & self._alive["body"])
        gone = [Unsubscribe(one_of(self.run, "gossip", name)) for name in before if name not in self._ring]
        return [*gone, *(Subscribe(one_of(self.run, "gossip", name)) for name in self._ring if name not in before)]

    # ------------------------------------------------------------------ ticks

    @property
    def _started(self) -> bool:
        return self.tick >= 0

    def _try_start(self, now: float) -> list[Effect]:
        """The first tick, once all expected agents are ready, or when long nobody has come; with an epoch the clock says when."""
        if self._started or self._due is None or self._clock.anchor is not None:
            return []
        complete = self._presence.is_complete(self._expected, "")
        if (not complete and now - self._changed < self._patience) or not self._alive["agent"]:
            return []
        if self._strict and not complete:
            return self._stop(EXIT_INCOMPLETE, "not all agents are ready, and the run is strict")
        self._clock.anchor = now
        return self._open(0, now)

    def _follow(self, now: float) -> list[Effect]:
        """Correct the clock to what the neighbours say; a body that comes late begins with their tick."""
        if self._due is None:
            return []
        if self._lockstep:
            if not self._started and self.name in self._alive["agent"] and not self._presence.speaks(self.name):
                return []  # its first tick would not wait for the command
            tick = self._count.majority(self._ring)
            late = tick - self.tick >= (2 if self._waiting else 1)  # an agent that answers may be one tick behind the fastest
            return self._open(tick, now) if late else []
        if not self._clock.listen(self._ring, now):
            return []
        tick = self._clock.tick(now)
        self._due = self._clock.due(max(self.tick, tick) + 1)
        return self._open(tick, now) if tick > self.tick else []

    def _on_time(self, now: float) -> list[Effect]:
        if self._driven_until is not None and now >= self._driven_until:
            self._stand()
        if self._due is None or now < self._due:
            return []
        if self._started or self._clock.anchor is not None:
            return self._open(self.tick + 1 if self._lockstep else max(0, self.tick + 1, self._clock.tick(now)), now)
        self._due = now + LOOK_PERIOD
        return self._try_start(now)

    def _open(self, tick: int, now: float) -> list[Effect]:
        """Go on to a tick: what the agent sees at it. A tick that was left out, or had no command in lockstep, moves nothing."""
        if self._waiting:
            self.ticks_without_command += 1
        if (self._waiting and self._lockstep) or tick > self.tick + 1:
            self._stand()
        if tick >= self._config.run.ticks:
            return self._stop(0, "done")
        self.tick, self._waiting = tick, self._presence.speaks(self.name)
        if self._lockstep:
            self._not_before = max(self._not_before, now - self._pause) + self._pause
            self._due = max(now + (self._config.run.patience if self._waiting else self._period), self._not_before)
        else:
            self._due = self._clock.due(tick + 1)
        self.pose, detections = self.platform.read(tick)
        self._scene.step_until(tick)
        if detections is None:
            [detections], _ = self._scene.scans({self.name: self.pose})
        elif detections is not False:
            detections = to_measurements(measurement_of(self._scene.sensors[self.name]), self.pose, detections)
        has_size = self._config.limits.radius > 0.0
        obstacles = around(self.pose, [(x, y) for x, y, _ in self._others.values()], self._config) if has_size else None
        seen = Observation(
            sender=self.name,
            incarnation=self.incarnation,
            recipient=self.name,
            tick=tick,
            time=tick * self._config.run.dt,
            pose=self.pose,
            detections_bytes=b"" if detections is False else pack(detections, "<f4"),
            obstacles_bytes=pack(obstacles, "<f8") if obstacles is not None else b"",
            scanned=detections is not False,
        )
        said = BodyPose(sender=self.name, incarnation=self.incarnation, tick=tick, pose=self.pose)
        return [said, seen] if has_size else [seen]

    # ------------------------------------------------------------------ motion

    def _obey(self, command: Command, now: float) -> list[Effect]:
        """Drive the platform; in lockstep the tick ends with its command."""
        if not self._started or not self._commands.keep(command, self.tick, self._presence.live(self.name)):
            self.ignored_commands += 1
            return []
        self._presence.note_spoken(command.sender, command.incarnation)
        end = self._end_of(command, now)
        if not self.hold.holds and end > now:
            self._drive(command)
            self._driven_until = end
        return self._end_of_wait(now) if self._waiting and command.tick == self.tick else []

    def _end_of(self, command: Command, now: float) -> float:
        """Until when a command drives the body: with a size two ticks after its own, for it knows no later places of others."""
        end = now + self._hold_seconds
        has_size = self._config.limits.radius > 0.0 and not self._lockstep
        return min(end, self._clock.due(command.tick + 2)) if has_size else end

    def _end_of_wait(self, now: float) -> list[Effect]:
        self._waiting = False
        if not self._lockstep:
            return []
        if now < self._not_before:
            self._due = self._not_before
            return []
        return self._open(self.tick + 1, now)

    def _drive(self, command: Command) -> None:
        fence, arena, velocity = self._config.bodies.fence, self._config.arena, command.velocity
        if fence is not None:
            seconds = self._hold_seconds * max(1.0, self._config.run.rate)  # of the world, where that is simulated
            velocity = fenced(velocity, self.pose, (-fence, -fence, arena.width + fence, arena.height + fence), seconds)
        self.platform.drive(velocity, command.turn_rate)

    def _stand(self) -> None:
        self._driven_until = None
        self.platform.stop()

    def _stop(self, code: int, reason: str) -> list[Effect]:
        self._stand()
        self._due, self._waiting = None, False
        return [Stop(code, reason)]


def check_epoch(config: WorldConfig, now: float) -> None:
    """Raise BadSetting for an epoch that a body should not wait for; `now` is the Unix time, s."""
    epoch, most = config.bodies.epoch, config.run.start_timeout
    if epoch and config.run.clock == "lockstep":
        raise BadSetting(f"bodies.epoch = {epoch:.3f}: lockstep has no clock; should be 0")
    if epoch > now + most:
        ahead = f"lies {epoch - now:.0f} s ahead of this machine's clock"
        raise BadSetting(f"bodies.epoch = {epoch:.3f}: {ahead}; should be at most {most:g} s (run.start_timeout): is the clock right?")
    lasts = config.run.ticks * config.run.dt / config.run.rate
    if epoch and epoch + lasts <= now:
        over = f"by this machine's clock the run of {lasts:g} s ended {now - epoch - lasts:.0f} s ago"
        raise BadSetting(f"bodies.epoch = {epoch:.3f}: {over}; should be 0, or more than {now - lasts:.0f}: is the clock right?")
