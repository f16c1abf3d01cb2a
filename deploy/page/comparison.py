"""Two simulations of one scenario and seed in step, as one source of a page: what is compared is all that differs.

Both run in this process and in virtual time. The left one is the page's picture, and the right one goes beside it in every frame. What is
clicked happens to both, so the two remain comparable.
"""

import asyncio
import time
from collections.abc import Sequence
from typing import Any

from deploy.page.picture import Picture
from deploy.page.simulated_swarm import DONE_TO_BOTH, SimulatedSwarm, about_two
from deploy.page.source import number_of
from deploy.scoring.result import EventReport
from deploy.scoring.scorer import Score
from protocol.settings import BadSetting

FRAME_PERIOD = 0.1  # s
SPEEDS = (0.1, 100.0)


class ComparisonSource:
    """Two variants of one scenario; `speed` in world seconds per second."""

    def __init__(self, sides: tuple[SimulatedSwarm, SimulatedSwarm], speed: float = 2.0) -> None:
        self.sides = sides
        self.picture = self.sides[0].picture
        self.jumps = 0
        self.period = FRAME_PERIOD
        self.playing, self.speed = True, speed
        self._last_tick = self.picture.scenario.run.ticks - 1
        self._dt = self.picture.scenario.run.dt
        self._clock = 0.0  # s of the world
        for side in self.sides:
            side.simulation.scorer.on_report = lambda told, name=side.name: self._tell(name, told)  # type: ignore[misc]

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
        beside = about_two(self.sides[0].name, self.scores(), self.sides[1])
        return {"source": "comparison", "verbs": list(DONE_TO_BOTH) if may_act else [], "drags": may_act, "beside": beside}

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
        if verb not in DONE_TO_BOTH:
            raise BadSetting(f"{verb!r}: should be one of {', '.join(DONE_TO_BOTH)}")
        if who not in self.picture.agents:
            raise BadSetting(f"{who!r}: there is no such agent; known are {', '.join(self.picture.agents)}")
        for side in self.sides:
            side.strike(verb, who)
        text = f"{who} is {'killed' if verb == 'kill' else 'started again'} on both sides"
        self.picture.note("asked", who, text)
        return text

    async def run_while_shown(self) -> None:
        """Play both, tick by tick, as fast as asked."""
        last = time.monotonic()
        while self.tick < self._last_tick:
            now = time.monotonic()
            if self.playing:
                self._pass(now - last)
            last = now
            if self.playing and (self.tick + 1) * self._dt <= self._clock:
                self.play(self.tick + 1)
            await asyncio.sleep(0.01)

    def _pass(self, seconds: float) -> None:
        """Let the world's time pass for some seconds on the wall. What could not be played is not made up for: a frame's time at most."""
        ahead = max(self._dt, FRAME_PERIOD * self.speed)
        self._clock = min(self._clock + min(seconds, FRAME_PERIOD) * self.speed, (self.tick + 1) * self._dt + ahead)

    def play(self, tick: int) -> None:
        """Bring both sides to a tick at once, so that no frame is drawn while one is ahead; raises BadSetting when one has failed."""
        for side in self.sides:
            side.play(tick)
            if side.failure is not None:
                self.picture.note("told", "", f"{side.name}: {side.failure}")
                raise side.failure

    def _tell(self, name: str, told: EventReport) -> None:
        self.picture.note("told", told.who, f"{name}: {told.text}", told.time)
