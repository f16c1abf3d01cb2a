"""The body of one agent, as docs/reference/protocol.md asks (*A body of your own*): ticks, what the agent is told, and when it stands.

It holds no socket and reads no clock: `now` is given, s. Whoever drives it hands in what was heard and asks what is due.
"""

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

from deploy.bridge.client import Fields, Heard
from deploy.bridge.frames import Placement, Planar, clipped, fenced

AHEAD = 0.5  # s that a clock may be ahead of the others
RECENT = 2.0  # s for which the word of a neighbour counts, or four periods
NEIGHBOURS = 5  # to whom the clock listens: two of them may be wrong
GATHERED = 1.0  # s for which nobody new came, until a run of which nobody speaks begins
MOST_PLACES = 8192  # detections of a scan, and other bodies, as on the wire
LARGEST = 1e6  # m, as on the wire: some drivers say larger numbers for nothing
STALE = 0.5  # s after which odometry or a scan is too old, or two periods; of a slower detector two of its own
SLOWEST = 2.0  # s between two scans of the slowest detector
STANDING = (0.0, 0.0), 0.0


class Rules(NamedTuple):
    """What a body must know of its run."""

    agent: str
    expected: tuple[str, ...]
    dt: float  # s of world time between two ticks
    period: float  # s of real time
    anchor: float | None  # when tick 0 began, s; None: as soon as all are there
    patience: float  # s for which no agent has come, after which the run begins without those who are missing
    strict: bool  # then it ends instead
    hold: float  # s without a command after which it stands
    speed: float  # m/s
    turn_rate: float  # rad/s
    box: tuple[float, float, float, float] | None = None  # that it never leaves, m
    sight: float = 0.0  # m within which it tells its agent of other bodies; 0: bodies are points
    ticks: int = 1 << 53  # of the run
    reach: float = math.inf  # m of its sensor; infinite where the run does not say it


class RobotBody:
    """One body. `say` publishes a message, `appear` declares its token or takes it back."""

    def __init__(self, rules: Rules, incarnation: int, say: Callable[[str, Fields], None], appear: Callable[[bool], None]) -> None:
        self.tick, self.held, self.replaced, self.over, self.incomplete = -1, False, False, False, False
        self._rules, self._incarnation, self._say, self._appear = rules, incarnation, say, appear
        self._anchor = rules.anchor
        self._words: dict[str, tuple[float, float]] = {}  # of a neighbour: when its tick 0 was by its newest gossip, and when that came
        self._others: dict[str, Planar] = {}  # name -> where that body said last that it is
        self._alive: dict[tuple[str, str], set[int]] = {}  # role and name -> incarnations
        self._changed = 0.0
        self._pose: tuple[Placement, float] | None = None
        self._scan: tuple[list[Planar], float] | None = None
        self._gap = 0.0  # s between the newest two scans
        self._is_told = False  # whether the agent has been told of the newest scan
        self._halt = -1  # incarnation of the newest order
        self._command: tuple[int, Planar, float, float] | None = None  # tick, velocity, turn rate, when it came

    @property
    def halt(self) -> tuple[int, bool]:
        """The newest order that counts: its incarnation, and whether the body is held."""
        return self._halt, self.held

    @property
    def pose(self) -> Placement | None:
        """Where the body was when it said so last."""
        return self._pose[0] if self._pose else None

    def at(self, pose: Placement, now: float) -> None:
        """Take an odometry, in the arena's frame."""
        if is_place(*pose):
            self._pose = pose, now

    def sees(self, detections: list[Planar], now: float) -> None:
        """Take a scan, in the arena's frame; places that are none are left out."""
        self._gap = min(now - self._scan[1], SLOWEST) if self._scan else 0.0
        self._is_told = False
        self._scan = [place for place in detections if is_place(*place)][:MOST_PLACES], now

    def hear(self, heard: Heard, now: float) -> None:
        """Take a message or a token."""
        if heard.kind in ("agent", "body"):
            self._on_token(heard, now)
        elif heard.kind == "gossip" and heard.name != self._rules.agent:
            tick = heard.fields["tick"]
            if type(tick) is int and 0 <= tick < self._rules.ticks and ("agent", heard.name) in self._alive:
                self._words[heard.name] = now - tick * self._rules.period, now
        elif heard.kind == "pose" and heard.name != self._rules.agent:
            x, y, heading = heard.fields["pose"]
            if is_place(x, y, heading) and (heard.name in self._others or len(self._others) < MOST_PLACES):
                self._others[heard.name] = x, y
        elif heard.kind == "command":
            self._obey(heard, now)
        elif heard.kind == "halt" and heard.incarnation > self._halt and isinstance(heard.fields["held"], bool):
            self._halt, self.held = heard.incarnation, heard.fields["held"]

    def _on_token(self, heard: Heard, now: float) -> None:
        before = self._newest_agent()
        self._note_token((heard.kind, heard.name), heard.incarnation, heard.up)
        if heard.up:
            self._changed = now
        if self._newest_agent() != before:
            self._command = None
        if heard.kind == "body" and heard.name == self._rules.agent:
            self.replaced = self.replaced or (heard.up and heard.incarnation > self._incarnation)

    def _note_token(self, token: tuple[str, str], incarnation: int, up: bool) -> None:
        incarnations = self._alive.setdefault(token, set())
        (incarnations.add if up else incarnations.discard)(incarnation)
        if not incarnations:
            del self._alive[token]
            if token[0] == "agent":
                self._words.pop(token[1], None)

    def _newest_agent(self) -> int:
        """The newest live incarnation of the own agent; -1: it is not there."""
        return max(self._alive.get(("agent", self._rules.agent), {-1}))

    def _obey(self, heard: Heard, now: float) -> None:
        """A command counts if it is the newest, of the newest live incarnation, and not of a tick to come."""
        tick, (x, y), turn = heard.fields["tick"], heard.fields["velocity"], heard.fields["turn_rate"]
        known = self._command[0] if self._command else -1
        if heard.incarnation == self._newest_agent() and known <= tick <= self.tick and all(map(math.isfinite, (x, y, turn))):
            self._command = tick, (x, y), turn, now

    def motion(self, now: float) -> tuple[Planar, float]:
        """The velocity m/s in the arena's frame and the turn rate rad/s for now; a body that is not sure stands."""
        rules = self._rules
        hold = max(rules.hold, 2.0 * rules.period)
        if self.held or self.over or self._command is None or not self._is_sound(now) or now > self._until(self._command, hold):
            return STANDING
        velocity, turn = clipped(self._command[1], rules.speed), max(-rules.turn_rate, min(rules.turn_rate, self._command[2]))
        assert self._pose is not None
        return (fenced(velocity, self._pose[0], rules.box, hold) if rules.box else velocity), turn

    def _until(self, command: tuple[int, Planar, float, float], hold: float) -> float:
        """When a command ends, s; among bodies with a size two ticks after its own in any case, for it knows the others' places of then."""
        end = command[3] + hold
        if not self._rules.sight or self._anchor is None:
            return end
        return min(end, self._anchor + (command[0] + 2) * self._rules.period)

    def silent(self, now: float) -> tuple[str, ...]:
        """The topics of which nothing fresh is there: odom, detections."""
        fresh = max(STALE, 2.0 * self._rules.period)
        since = {"odom": (self._pose, now - fresh), "detections": (self._scan, now - max(fresh, 2.0 * self._gap))}
        return tuple(topic for topic, (said, oldest) in since.items() if said is None or said[1] < oldest)

    def _is_sound(self, now: float) -> bool:
        """Whether odometry and scans are fresh; a body that does not know where it is, or sees nothing, is as good as dead."""
        return not self.silent(now)

    def step(self, now: float) -> None:
        """Go on to the tick that it is, if it is a new one: tell the agent where it is and what it sees."""
        sound = self._is_sound(now)
        self._appear(sound)
        if not sound or not self._follow(now) or self._anchor is None:
            return
        tick = math.floor((now - self._anchor) / self._rules.period)
        if tick <= self.tick:
            return
        self.over = tick >= self._rules.ticks
        if self.over:
            return
        if tick > self.tick + 1:
            self._command = None
        self.tick = tick
        assert self._pose is not None and self._scan is not None
        scanned, self._is_told = not self._is_told, True
        seen = b"".join(struct.pack("<2f", *place) for place in self._scan[0]) if scanned else b""
        place = {"tick": tick, "pose": self._pose[0]}
        if self._rules.sight:
            self._say("pose", place)
        told = {"recipient": self._rules.agent, "time": tick * self._rules.dt, "detections": seen, "obstacles": self._obstacles()}
        self._say("observation", {**place, **told, "scanned": scanned})

    def _obstacles(self) -> bytes:
        """The middles of the bodies close by, where they said last that they are."""
        assert self._pose is not None
        (here_x, here_y, _), sight = self._pose[0], self._rules.sight
        return b"".join(struct.pack("<2d", x, y) for x, y in self._others.values() if math.hypot(x - here_x, y - here_y) <= sight)

    def _follow(self, now: float) -> bool:
        """Correct the clock to the majority of the neighbours, if more than half of them speak; whether the run has begun."""
        since, period = now - max(RECENT, 4.0 * self._rules.period), self._rules.period
        neighbours = self._neighbours()
        words = sorted(self._words[name][0] for name in neighbours if name in self._words and self._words[name][1] >= since)
        if 2 * len(words) > len(neighbours):
            theirs = sorted(words if self._anchor is None else [*words, self._anchor])
            middle = theirs[(len(theirs) - 1) // 2]
            if self._anchor is None or not -max(period, AHEAD) <= self._anchor - middle <= 0.5 * period:
                self._anchor = middle
        elif self._anchor is None and self._may_begin(now):
            self._anchor = now
        return self._anchor is not None and now >= self._anchor

    def _neighbours(self) -> list[str]:
        """The next ones in the ring of the sorted names of those that have an agent and a body."""
        mine = self._rules.agent
        whole = [name for role, name in self._alive if role == "body" and ("agent", name) in self._alive]
        return sorted({*whole} - {mine}, key=lambda name: (name < mine, name))[:NEIGHBOURS]

    def _may_begin(self, now: float) -> bool:
        """Whether all expected agents and the bodies of all others are alive, and nobody new has come for a moment.

        After the patience of the run those who are there are enough; a strict run ends instead.
        """
        mine, waited = self._rules.agent, now - self._changed
        wanted = [(role, name) for name in self._rules.expected for role in ("agent", "body") if (role, name) != ("body", mine)]
        if all(token in self._alive for token in wanted):
            return waited >= GATHERED
        is_over = waited >= self._rules.patience and any(role == "agent" for role, _ in self._alive)
        self.incomplete = self.incomplete or (is_over and self._rules.strict)
        return is_over and not self._rules.strict


def is_place(*numbers: float) -> bool:
    """Whether these are finite numbers of a size that the wire takes."""
    return all(abs(number) <= LARGEST for number in numbers)
