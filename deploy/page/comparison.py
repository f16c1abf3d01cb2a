"""Two simulations of one scenario and seed in step, as one source of a page: they differ in the diagram alone.

Both run in this process and in virtual time. The left one is the page's picture, and the right one goes beside it in every frame. What is
clicked happens to both, so the two remain comparable.
"""

import asyncio
import time
from collections.abc import Sequence
from typing import Any

import msgspec

from deploy.faults.faults import Action
from deploy.page.frames import curves
from deploy.page.picture import Picture
from deploy.page.source import number_of
from deploy.scenario import Scenario
from deploy.scoring.result import EventReport
from deploy.scoring.scorer import Score
from deploy.simulation import Simulation
from protocol.settings import BadSetting

FRAME_PERIOD = 0.1  # s
SPEEDS = (0.1, 100.0)
BUTTONS = ("kill", "restart")


class Side:
    """One of the two simulations, and its picture."""

    def __init__(self, scenario: Scenario, kind: str) -> None:
        partition = msgspec.structs.replace(scenario.partition, kind=kind)
        self.kind = kind
        self.simulation = Simulation(msgspec.structs.replace(scenario, partition=partition))
        self.picture = Picture(self.simulation.scenario)
        self.simulation.scorer.on_event = self.picture.see

    @property
    def scores(self) -> Sequence[Score]:
        """All so far, oldest first."""
        return self.simulation.scorer.scores

    def score(self) -> Score | None:
        """The last but one: of its tick everything has been heard."""
        return self.scores[-2] if len(self.scores) > 1 else None

    def play(self, tick: int) -> None:
        """Go on until the world has come to a tick."""
        while (truth := self.simulation.scorer.truth) is None or truth.tick < tick:
            if not self.simulation.bus.step():
                return


class ComparisonSource:
    """One scenario under two kinds of diagram; `speed` in world seconds per second."""

    def __init__(self, scenario: Scenario, kinds: tuple[str, str], speed: float = 2.0) -> None:
        self.sides = tuple(Side(scenario, kind) for kind in kinds)
        self.picture = self.sides[0].picture
        self.jumps = 0
        self.period = FRAME_PERIOD
        self.playing, self.speed = True, speed
        self._last_tick = scenario.run.ticks - 1
        self._dt = scenario.run.dt
        self._clock = 0.0  # s of the world
        for side in self.sides:
            side.simulation.scorer.on_report = lambda told, kind=side.kind: self._tell(kind, told)  # type: ignore[misc]

    @property
    def tick(self) -> int:
        """The newest tick, of both."""
        return self.picture.truth.tick if self.picture.truth else -1

    def scores(self) -> Sequence[Score]:
        return self.sides[0].scores

    def score(self) -> Score | None:
        return self.sides[0].score()

    def beside(self) -> tuple[Picture, Score | None]:
        return self.sides[1].picture, self.sides[1].score()

    def about(self, may_act: bool) -> dict[str, Any]:
        beside = {"partition": self.sides[1].kind, "ospa": curves(self.sides[1].scores)["ospa"]}
        return {"source": "comparison", "verbs": list(BUTTONS) if may_act else [], "drags": may_act, "beside": beside}

    def extra(self) -> dict[str, Any]:
        over = {"over": True} if self.tick >= self._last_tick else {}
        return {"play": {"playing": self.playing, "speed": self.speed}, **over}

    async def ask(self, request: dict[str, Any]) -> str:
        """{"play": true}, {"speed": 5}, {"verb": "kill", "who": "s5"}, or {"drag": 3, "to": [12, 7]}, a target and its new place."""
        if "play" in request:
            self.playing = bool(request["play"])
            return ""
        if "speed" in request:
            self.speed = number_of(request["speed"], *SPEEDS)
            return ""
        return self._drag(request) if "drag" in request else self._strike(str(request.get("verb")), str(request.get("who")))

    def _drag(self, request: dict[str, Any]) -> str:
        to, arena = request.get("to"), self.picture.scenario.arena
        if not isinstance(to, list) or len(to) != 2 or not isinstance(request["drag"], int):
            raise BadSetting('drag: should be {"drag": number of a target, "to": [x, y]}')
        place = number_of(to[0], 0.0, arena.width), number_of(to[1], 0.0, arena.height)
        for side in self.sides:
            side.simulation.move_target(request["drag"], place)
        return ""

    def _strike(self, verb: str, who: str) -> str:
        if verb not in BUTTONS:
            raise BadSetting(f"{verb!r}: should be one of {', '.join(BUTTONS)}")
        if who not in self.picture.agents:
            raise BadSetting(f"{who!r}: there is no such agent")
        for side in self.sides:
            side.simulation.injector.strike(Action(verb, [who]))
        text = f"{who} is {'killed' if verb == 'kill' else 'started again'} on both sides"
        self.picture.note("asked", who, text)
        return text

    async def chores(self) -> None:
        """Play both, tick by tick, as fast as asked."""
        last = time.monotonic()
        while self.tick < self._last_tick:
            now = time.monotonic()
            if self.playing:
                self._clock += min(now - last, FRAME_PERIOD) * self.speed
            last = now
            if self.playing and (self.tick + 1) * self._dt <= self._clock:
                self.play(self.tick + 1)
            await asyncio.sleep(0.01)

    def play(self, tick: int) -> None:
        """Bring both sides to a tick at once, so that no frame is drawn while one of them is ahead."""
        for side in self.sides:
            side.play(tick)

    def _tell(self, kind: str, told: EventReport) -> None:
        self.picture.note("told", told.who, f"{kind}: {told.text}", told.time)
