"""What a page shows and whom its clicks reach: what every source has, and the source of a running swarm."""

import asyncio
import contextlib
import time
from collections.abc import Sequence
from typing import Any, Protocol

import msgspec

from deploy.faults.faults import LINK_VERBS
from deploy.live.control import ask
from deploy.page.picture import Picture
from deploy.page.simulated_swarm import DONE_TO_BOTH, SimulatedSwarm, about_two
from deploy.scoring.result import Fault
from deploy.scoring.scorer import Score, Scorer
from deploy.scoring.status import TickRate
from deploy.storage.run_directory import RunDirectory
from protocol.settings import BadSetting

FRAME_PERIOD = 0.1  # s
PLAY_PERIOD = 0.01  # s between two ticks of a swarm beside, at least
RECENT_SCORES = 20  # among which two swarms have one of the same tick
STATE_PERIOD = 1.0  # s between two status requests
BUTTONS = ("kill", "pause", "resume", "restart", "partition", "heal")


def number_of(value: object, least: float, most: float) -> float:
    """A number that a browser sends; raises BadSetting unless it is one between the bounds."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise BadSetting(f"{value!r}: should be a number from {least:g} to {most:g}")
    return float(value)


class Source(Protocol):
    """What the server needs of a source."""

    picture: Picture
    jumps: int  # grows when browsers must be greeted again
    period: float  # s between two frames of different ticks, at least

    def scores(self) -> Sequence[Score]:
        """All scores that are known, oldest first."""

    def score(self) -> Score | None:
        """The score of the moment that the picture shows."""

    def beside(self) -> tuple[Picture, Score | None] | None:
        """A second swarm in the same arena, and its score of the tick of `score`; None: there is none. Without scores it may be behind."""

    def about(self, may_act: bool) -> dict[str, Any]:
        """What a newcomer must know: the kind of source, and what may be clicked."""

    def extra(self) -> dict[str, Any]:
        """What frames say beside the picture."""

    async def ask(self, request: dict[str, Any]) -> str:
        """Carry out a click and say what was done; raises BadSetting."""

    async def run_while_shown(self) -> None:
        """What the source does while it is shown."""


class LiveSource:
    """A running swarm. The driver of the scorer feeds the picture; the supervisor, if it can be reached, carries out clicks.

    A simulated swarm can go beside it, tick by tick. Who is killed or restarted on the page is so in both.
    """

    def __init__(
        self,
        scorer: Scorer,
        picture: Picture,
        directory: RunDirectory | None,
        tour: bool = False,
        name: str = "",
        other: SimulatedSwarm | None = None,
    ) -> None:
        """`tour`: newcomers are offered the guided tour. `other`: the swarm beside this one, and `name` what this one is then called."""
        self.picture = picture
        self.jumps = 0
        self.period = FRAME_PERIOD
        self._scorer = scorer
        self._directory = directory
        self._tour = tour
        self._name, self._other = name, other
        self._look_again = asyncio.Event()
        self._faults = 0  # of the supervisor's list that stand on the time line
        self._waiting = ""  # what the first tick waits for
        self._tick_rate: TickRate | None = None  # as the supervisor counts it, which has heard agents that died before this page began
        self._shown = -1  # the newest tick of which both swarms have been shown, or the live one alone

    def scores(self) -> Sequence[Score]:
        return self._scorer.scores

    def score(self) -> Score | None:
        """The last but one: when a tick has been scored, all has been heard of the one before, its particles included."""
        if self._other:
            return self._of_one_tick(self._other)[0]
        return self._scorer.scores[-2] if len(self._scorer.scores) > 1 else None

    def beside(self) -> tuple[Picture, Score | None] | None:
        return (self._other.picture, self._of_one_tick(self._other)[1]) if self._other else None

    def _of_one_tick(self, other: SimulatedSwarm) -> tuple[Score | None, Score | None]:
        """The scores of the newest tick of which everything has been heard in both swarms, unless a later one has been shown.

        Where the other one lags so far behind they are those of the live one, until it has caught up.
        """
        mine, theirs = ({score.tick: score for score in scores[-RECENT_SCORES:-1]} for scores in (self._scorer.scores, other.scores))
        of_both = [tick for tick in mine.keys() & theirs.keys() if tick >= self._shown]
        self._shown = max(of_both, default=max(mine, default=-1))
        return mine.get(self._shown), theirs.get(self._shown)

    def about(self, may_act: bool) -> dict[str, Any]:
        possible = [verb for verb in BUTTONS if verb not in LINK_VERBS or self.picture.scenario.network.link_faults]
        beside = {"beside": about_two(self._name, self.scores(), self._other)} if self._other else {}
        return {"source": "live", "verbs": possible if may_act and self._directory else [], "tour": self._tour, **beside}

    def extra(self) -> dict[str, Any]:
        if self._waiting and self.picture.truth is None:
            return {"waiting": self._waiting}
        tick_rate = self._tick_rate or self._scorer.tick_rate.at(time.monotonic())
        speeds = [None if speed is None else round(speed, 1) for speed in (tick_rate.ticks_per_s, tick_rate.asked_per_s)]
        return {"tick_rate": [*speeds, tick_rate.skipped, tick_rate.late], "advice": tick_rate.advice}

    async def ask(self, request: dict[str, Any]) -> str:
        verb, who = str(request.get("verb", "")), str(request.get("who", ""))
        if verb not in BUTTONS:
            raise BadSetting(f"{verb!r}: should be one of {', '.join(BUTTONS)}")
        answer = await self._control(verb, who)
        if self._other and verb in DONE_TO_BOTH:
            self._other.strike(verb, who)
        text = str(answer.get("ok", ""))
        self.picture.note("asked", who, f"from the page: {text}")
        self._look_again.set()
        return text

    async def run_while_shown(self) -> None:
        """Poll the supervisor, and play the other swarm."""
        await asyncio.gather(self._poll(), self._play())

    async def _play(self) -> None:
        """Play the other swarm to the newest tick of this one, a tick at a time: the loop has more to do."""
        while self._other:
            if self.picture.truth and self._other.tick < self.picture.truth.tick:
                self._other.play(self._other.tick + 1)
            await asyncio.sleep(PLAY_PERIOD)

    async def _poll(self) -> None:
        """Poll the supervisor for what no message shows: the state of the start, the tick rate, paused agents, cut links."""
        while True:
            with contextlib.suppress(BadSetting, OSError, KeyError, TypeError, msgspec.ValidationError):
                status = (await self._control("status", ""))["data"]
                self._waiting = status["swarm"]["waiting"]
                self._tick_rate = msgspec.convert(status["swarm"]["tick_rate"], TickRate)
                self.picture.pause(frozenset(row["name"] for row in status["processes"] if row["state"] == "paused"))
                known = max(self._faults, len(self._scorer.faults))  # those of its own scorer the picture is told at once
                for fault in status["faults"][known:]:
                    self.picture.note_fault(Fault(*fault))
                self._faults = len(status["faults"])
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._look_again.wait(), STATE_PERIOD)
            self._look_again.clear()

    async def _control(self, verb: str, who: str) -> dict[str, Any]:
        """The supervisor's answer; raises BadSetting with its complaint."""
        if self._directory is None:
            raise BadSetting("this page only watches; use `covey kill` and the like, or the page of `covey up --page`")
        return await ask(self._directory, verb, who)
