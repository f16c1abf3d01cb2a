"""The World node: moves the targets, owns the bodies, hands out detections and says the truth to watchers.

A tick k: publish Observation(k) to every agent that is alive, and Truth(k); then wait for the Commands (lockstep) or for the clock
(real time); then move bodies and targets to k + 1. Tick 0 is the state at the start, before anything has moved. With
`run.max_rate` lockstep waits for both: the Commands are those of the tick whatever the clock says, so it changes no bit of the run.
"""

import logging
import math
from collections.abc import Callable

import numpy as np

from protocol.fields import MAX_NAMES, pack
from protocol.keys import all_of, order
from protocol.message import Message
from protocol.messages import Command, Halt, Hello, Observation
from protocol.node import Alive, Effect, Event, Gone, Node, Received, Rejected, Reopen, Started, Stop, Subscribe, Timer
from protocol.observer_messages import Truth
from protocol.pose import from_other_frame
from protocol.sensing import Pose, SensorModel, measurement_of
from protocol.session_watchdog import SessionWatchdog
from protocol.settings import BadSetting, sensor_of
from protocol.settings_digest import common_sections, shared_settings
from world.bodies import check_given, free_pose, pose_with_error
from world.commands import CommandBook
from world.config import WorldConfig
from world.halt import Hold
from world.presence import Presence
from world.proximity import around
from world.scene import Scene

log = logging.getLogger(__name__)

HELLO_PERIOD = 0.25  # s, until the start
HOLD = 2.0  # a command drives a body for so long at most, s of world time, real time only
MOST_PERIODS_LATE = 5  # a world that is later than this gives up catching up, real time only
RESTORE_GAP = 2  # ticks from the last Truth that was kept to the first of a restarted world: agents may have seen one more
RESTORE_TIMEOUT = 1.0  # s, how long a restarted world waits for those who were alive before
MOST_GUESTS = 256  # that ever get a body, as many as are scored: anybody can make up names
MOST_WARNINGS, MOST_CHARACTERS = 64, 256  # of guests without a body, and of each of them: anybody can make up names and classes
EXIT_INCOMPLETE = 4  # of a strict world whose agents do not all come


class World(Node):
    """The true state of a run, and its clock. `restored` is the last Truth of an earlier incarnation."""

    role = "world"
    coalesced_keys = "/command/"  # one command is no reason to wake up
    name = "world"

    def __init__(self, config: WorldConfig, incarnation: int, restored: Truth | None = None) -> None:
        if self.name in config.members:
            raise BadSetting(f"members.{self.name}: this name belongs to the world; call the agent otherwise")
        check_given(config)
        self.run, self.incarnation = config.run.name, incarnation
        self.tick = 0
        self.started = False
        self.ticks_without_command = 0  # that ended before their command came, each agent by itself
        self.ignored_commands = 0  # stale, of an old incarnation, or of nobody with a body
        self.rejected_messages = 0
        self.re_anchored = 0  # real time: how often the world was too late to catch up
        self._config, self._presence = config, Presence(config.members)
        self._watchdog = SessionWatchdog(self.name, config.members, config.network.lease)
        self._lockstep = config.run.clock == "lockstep"
        self._period = config.run.dt / config.run.rate
        max_rate = config.run.max_rate if self._lockstep else 0.0
        self._pause = config.run.dt / max_rate if max_rate else 0.0  # s between two ticks, at least
        self._not_before = 0.0  # lockstep: when the tick may end
        self._warnings = 0
        self._refused: dict[str, int] = {}  # guests without room for a body, and their incarnations
        self._poses_before: dict[str, Pose] = {}  # of the bodies, one tick ago
        self._expected, self._patience, self._strict = tuple(config.members), config.run.start_timeout, config.run.strict
        self.scene = Scene(config)
        self.bodies = self.scene.bodies
        if restored is not None:
            self._restore(restored)
        for name, sensor_class in config.members.items():
            self._embody(name, sensor_of(config, sensor_class))
        self._settings = shared_settings(common_sections(config))
        self._commands = CommandBook(lockstep=self._lockstep)
        self.hold = Hold()  # by an operator: no command moves a body
        self.on_truth: Callable[[Truth], object] = lambda truth: None  # called with every Truth before it is published
        self._waiting: set[str] = set()  # whose command of this tick is still missing; in lockstep the tick waits for it
        self._due: float | None = None
        self._changed = 0.0  # when an agent came, or one heard of more than before; until the start
        self._anchor = 0.0  # real time: when tick 0 would have been

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to do, in order."""
        match event:
            case Started():
                return self._begin(now)
            case Timer():
                return self._on_time(now)
            case Received(batch=batch):
                return [effect for message in batch.messages for effect in self._take(message, now)]
            case Alive(role="agent"):
                return self._greet(event.name, event.incarnation, now)
            case Gone(role="agent"):
                return self._bury(event.name, event.incarnation, now)
            case Alive(role=self.role, name=self.name) if event.incarnation > self.incarnation:
                return self._stop(3, "a younger world has taken over")
            case Rejected():
                self.rejected_messages += 1
        return []

    def _take(self, message: Message, now: float) -> list[Effect]:
        if isinstance(message, Command):
            return self._obey(message, now)
        if isinstance(message, Halt):
            self.hold.take(message)
        return self._hear(message, now) if isinstance(message, Hello) and message.role == "agent" else []

    @property
    def wake_up_count(self) -> int:
        """How many commands the tick waits for; in real time it waits for the clock."""
        return len(self._waiting) if self._lockstep or not self.started else 1 << 30

    def expect(self, names: tuple[str, ...]) -> None:
        """Wait for these agents before the first tick, however long they take: a parent that sees their processes asks for it."""
        self._expected, self._patience = names, math.inf

    def counts(self) -> dict[str, int]:
        """What went wrong so far, for the log."""
        wrong = {"ticks_without_command": self.ticks_without_command, "ignored_commands": self.ignored_commands}
        return {**wrong, "rejected_messages": self.rejected_messages, "re_anchored": self.re_anchored}

    def deadline(self) -> float | None:
        """When the next Hello or tick is due, in the time of `now`."""
        return self._due

    def _begin(self, now: float) -> list[Effect]:
        self._changed, self._due = now, now + HELLO_PERIOD
        return [*(Subscribe(all_of(self.run, kind)) for kind in ("hello", "command", "halt")), self._hello()]

    def _on_time(self, now: float) -> list[Effect]:
        if self._due is None or now < self._due:
            return []
        if self.started:
            return self._finish_tick(now)
        self._due = now + HELLO_PERIOD
        return [self._hello(), *self._try_start(now)]

    def _hear(self, hello: Hello, now: float) -> list[Effect]:
        """Take a Hello; whoever speaks for the first time after the start is answered."""
        known = self._presence.hellos.get(hello.sender)
        is_new = self._presence.hear(hello)
        if not self._presence.admits(hello.sender):
            return []
        if known is None or len(hello.heard) > len(known.heard):
            self._changed = now
        if not hello.neighbours_only:
            self._watchdog.note_hello(hello.sender, now)
        reason = "" if hello.neighbours_only else self._watchdog.reason_to_reopen(hello, now)  # it hears nobody else's Hello
        if reason:
            return [Reopen(reason)]
        self._embody_guest(hello.sender)
        if self.started:
            return [self._hello()] if is_new else []
        return self._try_start(now)

    def _greet(self, name: str, incarnation: int, now: float) -> list[Effect]:
        """An agent has appeared; what an older incarnation of it was asked or told is void."""
        is_new = self._presence.appear(name, incarnation)
        self._watchdog.token_appeared(name, incarnation)
        self._embody_guest(name)
        if not self.started:
            self._changed = now if is_new else self._changed
            return self._try_start(now)
        if not is_new:
            return []
        self._commands.drop(name)
        return [self._hello(), *self._no_longer_wait(name, now)]

    def _bury(self, name: str, incarnation: int, now: float) -> list[Effect]:
        """An agent has gone; its body stands still at once and nobody waits for it."""
        self._watchdog.token_vanished(name, incarnation)
        if not self._presence.vanish(name, incarnation):
            return []
        self._commands.drop(name)
        self._refused.pop(name, None)
        return self._no_longer_wait(name, now)

    def _obey(self, command: Command, now: float) -> list[Effect]:
        """Keep a command until the tick ends."""
        self._watchdog.note_messages((command.sender,), now)
        moves = self.started and command.sender in self.scene.sensors
        if not moves or not self._commands.keep(command, self.tick, self._presence.live(command.sender)):
            self.ignored_commands += 1
            return []
        self._presence.note_spoken(command.sender, command.incarnation)
        return self._no_longer_wait(command.sender, now) if command.tick == self.tick else []

    def _no_longer_wait(self, name: str, now: float) -> list[Effect]:
        """In lockstep the tick ends with the last answer that it waited for."""
        if name not in self._waiting:
            return []
        self._waiting.discard(name)
        if self._waiting or not self._lockstep:
            return []
        if now < self._not_before:
            self._due = self._not_before
            return []
        return self._finish_tick(now)

    def _try_start(self, now: float) -> list[Effect]:
        """The first tick, once everybody expected is ready; without those who are missing when long nothing has changed.

        The time before the first agent does not count, however long agents take to start. A strict world stops instead.
        """
        complete = self._presence.is_complete(self._expected, self.name)
        if self._due is None or (not complete and now - self._changed < self._patience) or not self.present():
            return []
        if self._strict and not complete:
            return self._stop(EXIT_INCOMPLETE, "not all agents are ready, and the run is strict")
        self.started, self._not_before = True, now
        self._anchor = now - self.tick * self._period
        return [self._hello(), *self._open_tick(now)]

    def _open_tick(self, now: float) -> list[Effect]:
        """What everybody sees at this tick."""
        present = self.present()
        scans, in_view = self.scene.scans({name: self.bodies.poses[name] for name in present})
        self._waiting = {name for name in present if self._presence.speaks(name)}
        if self._lockstep:
            self._not_before = max(self._not_before, now - self._pause) + self._pause  # late by less than a pause is made up for
            self._due = max(now + (self._config.run.patience if self._waiting else self._period), self._not_before)
        else:
            self._due = self._anchor + (self.tick + 1) * self._period
        truth = self.scene.truth(self.bodies.poses, in_view, present, self.name, self.incarnation)
        self.on_truth(truth)
        return [*map(self._observation, present, scans), truth]

    def _finish_tick(self, now: float) -> list[Effect]:
        """Move bodies and targets on and open the next tick."""
        self.ticks_without_command += len(self._waiting)
        self._waiting = set()
        commands = self._commands_in_force()
        self.tick += 1
        self.scene.step_until(self.tick)
        self._poses_before = dict(self.bodies.poses)
        self.bodies.move(commands)
        if self.tick >= self._config.run.ticks:
            return self._stop(0, "done")
        if not self._lockstep and now - (self._anchor + self.tick * self._period) > MOST_PERIODS_LATE * self._period:
            self._anchor = now - self.tick * self._period
            self.re_anchored += 1
        return self._open_tick(now)

    def _commands_in_force(self) -> dict[str, Command]:
        """The commands that move bodies in this tick: its own in lockstep; in real time the newest, as long as they hold."""
        if self.hold.holds:
            return {}
        if self._lockstep:
            return {name: command for name, command in self._commands.newest.items() if command.tick == self.tick}
        dt = self._config.run.dt
        # two ticks in any case; for no longer a command keeps its body apart from others
        hold = max(HOLD, 2.0 * dt) if self._config.limits.radius == 0.0 else 2.0 * dt
        return {name: command for name, command in self._commands.newest.items() if (self.tick - command.tick) * dt < hold}

    def _stop(self, code: int, reason: str) -> list[Effect]:
        self._due, self._waiting, self.started = None, set(), False
        return [Stop(code, reason)]

    def present(self) -> list[str]:
        """Names of the live agents that have a body and a sensor that is known, in team order."""
        return [name for name in self.bodies.poses if name in self.scene.sensors and self._presence.live(name) is not None]

    def _embody_guest(self, name: str) -> None:
        """Give a body to a live agent that is no member but has said what its sensor is: its numbers, or a class that is known here."""
        hello = self._presence.hellos.get(name)
        if name in self.scene.sensors or hello is None or self._presence.live(name) != hello.incarnation:
            return
        if hello.sensor is None and not hello.sensor_class:
            return
        if self._refused.get(name) == hello.incarnation or len({*self.bodies.poses, name}) > MAX_NAMES:
            return
        try:
            if name not in self.bodies.poses and len(self.bodies.poses.keys() - self._config.members.keys()) >= MOST_GUESTS:
                raise BadSetting(f"{MOST_GUESTS} guests have one already; agents that belong to the run should stand in [members]")
            self._embody(name, hello.sensor or sensor_of(self._config, hello.sensor_class))
        except BadSetting as error:
            self._refused[name] = hello.incarnation
            self._warnings += 1
            if self._warnings <= MOST_WARNINGS:
                log.warning("%s gets no body: %s", name, str(error)[:MOST_CHARACTERS])

    def _embody(self, name: str, sensor: SensorModel) -> None:
        """Give a sensor a body, the one that its name had in a restored run; raises BadSetting where there is no room for a new one."""
        if name not in self.bodies.poses:
            self.bodies.place(name, free_pose(name, self._config, self.bodies.poses.values()))
        self.scene.sensors[name] = sensor

    def _restore(self, truth: Truth) -> None:
        """Go on where an earlier incarnation stopped; raises BadSetting when that was another run."""
        self.scene.step_until(min(truth.tick, self._config.run.ticks - 1))
        mine = self.scene.targets
        if not np.array_equal(mine.ids, truth.ids) or not np.allclose(mine.positions, truth.targets, rtol=0.0, atol=1e-6):
            raise BadSetting(f"restore: tick {truth.tick} that was kept does not come from this scenario and seed {self._config.run.seed}")
        self.scene.step_until(min(truth.tick + RESTORE_GAP, self._config.run.ticks - 1))
        self.tick = self.scene.targets.tick
        for name, (x, y, heading) in zip(truth.bodies, truth.poses.tolist()):
            self.bodies.place(name, (x, y, heading))  # of dead guests, too: it stands there still
        self._expected, self._patience, self._strict = truth.alive, min(self._patience, RESTORE_TIMEOUT), False

    def _hello(self) -> Hello:
        self._watchdog.keep(self._presence.names())
        heard = tuple(sorted(self._watchdog.heard(), key=order))
        return Hello(sender=self.name, incarnation=self.incarnation, role=self.role, heard=heard, settings=self._settings)

    def _observation(self, name: str, detections: np.ndarray) -> Observation:
        true = self.bodies.poses[name]
        reported = pose_with_error(true, self._poses_before.get(name, true), self._config, name, self.tick)
        if reported != true and measurement_of(self.scene.sensors[name]) is None:
            # a position is stated in the frame that the agent believes in
            detections = from_other_frame(detections, true, reported)
        return Observation(
            sender=self.name,
            incarnation=self.incarnation,
            recipient=name,
            tick=self.tick,
            time=self.tick * self._config.run.dt,
            pose=reported,
            detections_bytes=pack(detections, "<f4"),
            obstacles_bytes=self._obstacles(name, reported),
        )

    def _obstacles(self, name: str, reported: Pose) -> bytes:
        """What stands or moves close to a body, where its agent places it."""
        if not self._config.limits.radius:
            return b""
        true = self.bodies.poses[name]
        found = around(true, [pose[:2] for other, pose in self.bodies.poses.items() if other != name], self._config)
        return pack(found if reported == true else from_other_frame(found, true, reported), "<f8")
