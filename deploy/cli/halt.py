"""`halt` and `release`: an operator's order to all bodies, said until it is obeyed."""

import math
import os
import time

from deploy.cli.listener import swarm_to_watch
from protocol import live
from protocol.access import OPERATOR
from protocol.keys import all_of, order
from protocol.messages import Halt, Observation
from protocol.node import Alive, Effect, Event, Gone, Node, Started, Stop, Subscribe, Timer, messages_of
from protocol.sensing import Pose
from world.bodies import ERRORS

REPEAT = 0.1  # s between two copies of the order
SETTLE = 1.0  # s at least, so that every body is found
MOST = 5.0  # s after which those that still move are reported; at least four ticks
STILL = 0.05  # m/s and rad/s; a pose that is measured is never quite still


class Operator(Node):
    """Says the order, and watches the poses of all bodies until they stand."""

    role = OPERATOR

    def __init__(self, run: str, incarnation: int, *, held: bool, period: float, judges: bool = True) -> None:
        """`period`: s between two ticks. `judges`: whether the poses can tell who stands; else the order is only said, as a release is."""
        self.run, self.name, self.incarnation = run, f"{OPERATOR}-{os.getpid()}", incarnation
        self.bodies: set[str] = set()  # with a token of their own, or observed by a world
        self.standing: set[str] = set()
        self.seconds = 0.0  # until all stood
        self._halt = Halt(sender=self.name, incarnation=incarnation, held=held)
        self._poses: dict[str, tuple[float, Pose]] = {}  # name -> world time and pose
        self._begun = self._due = 0.0
        self.most = max(MOST, 4.0 * period)  # s for which the order is said
        self._judges = held and judges
        self._least = SETTLE if self._judges else max(SETTLE, 2.0 * period)  # s; two poses of each body take as long
        self._stood_at: float | None = None

    def deadline(self) -> float | None:
        """When the order is said again."""
        return self._due

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to do."""
        match event:
            case Started():
                self._begun = self._due = now
                return [Subscribe(all_of(self.run, "observation"))]
            case Alive(role="body"):
                self.bodies.add(event.name)
            case Gone(role="body"):
                self.bodies.discard(event.name)
            case Timer() if now >= self._due:
                self._due = now + REPEAT
                return [self._halt, *self._conclude(now)]
        for message in messages_of(event):
            if isinstance(message, Observation):
                self._look(message)
        return []

    def _look(self, seen: Observation) -> None:
        """Note whether a body has moved since its observation before."""
        before = self._poses.get(seen.recipient)
        self._poses[seen.recipient] = seen.time, seen.pose
        self.bodies.add(seen.recipient)
        if before is None or seen.time <= before[0]:
            return
        (x, y, heading), (x0, y0, heading0) = seen.pose, before[1]
        turned = abs(math.remainder(heading - heading0, 2.0 * math.pi))
        still = max(math.hypot(x - x0, y - y0), turned) <= STILL * (seen.time - before[0])
        (self.standing.add if still else self.standing.discard)(seen.recipient)

    def _conclude(self, now: float) -> list[Effect]:
        """End when all bodies that are known obey, or when the order has been said for long enough; 1 when no body is known."""
        done = bool(self.bodies) and (not self._judges or self.bodies <= self.standing)
        self._stood_at = (self._stood_at or now) if done else None
        self.seconds = (self._stood_at or now) - self._begun
        if now - self._begun < (self._least if done else self.most):
            return []
        return [Stop(0 if done else 1, "the order has been said")]


def say(run: str | None, *, held: bool) -> int:
    """Halt or release all bodies of a run and tell what came of it."""
    _, scenario = swarm_to_watch(run, supervised=True)
    run_settings, wrong = scenario.run, [f"bodies.{field}" for field in ERRORS if getattr(scenario.bodies, field)]
    speed = run_settings.rate if run_settings.clock == "realtime" else run_settings.max_rate
    period = run_settings.dt / speed if speed else 0.0
    node = Operator(run_settings.name, time.time_ns() // 1_000_000, held=held, period=period, judges=not wrong)
    code = live.run(node, scenario.network)
    print(outcome(node, held=held, wrong=wrong[0] if wrong else ""))
    return code


def outcome(node: Operator, *, held: bool, wrong: str) -> str:
    """What came of an order, in words; `wrong`: a setting that hides who stands, or empty."""
    number, moving = len(node.bodies), sorted(node.bodies - node.standing, key=order)
    if not number:
        unknown = "stand" if held else "be released"
        return f"no body of run {node.run} has answered within {node.most:g} s: nothing is known to {unknown}"
    if not held:
        doubt = "" if moving or wrong else "; none moves yet: a halt counts on if it came from a machine whose clock is ahead of this one"
        return f"released {number} bodies{doubt}"
    if wrong:
        return f"{number} bodies have been told to stand; {wrong} hides whether they do. `covey release` lets them go on"
    if not moving:
        return f"{number} bodies stand; `covey release` lets them go on"
    return f"{len(node.standing)} bodies stand, not {', '.join(moving)}"
