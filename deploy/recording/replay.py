"""Replay of a recording on the page: play, pause, seek, at any speed; and publishing under the same keys.

The picture takes the recorded events. A second pass over the whole file, in small slices beside the first, finds the scores and the time
line, so that the curves are complete before they are played.
"""

import asyncio
import bisect
import math
import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from deploy.page.picture import KEPT_TICKS, TRAIL, Picture, paused_after
from deploy.page.source import number_of
from deploy.recording.recording import RecordedEntry, Recording, event_of
from deploy.recording.rescore import rescore_slowly
from deploy.scoring.scorer import Score, Scorer
from protocol.keys import parse_message_key
from protocol.message import Message
from protocol.node import Effect, Event, Node, Received, Started, Timer
from protocol.settings import BadSetting

FRAME_PERIOD = 1.0 / 15.0  # s; fast replays jump from frame to frame, so that ten a second would look rough
STEP = 0.5 * FRAME_PERIOD  # s between two looks at the clock
SCAN_SHARE = 0.6  # of the time between them that the second look may take
WARM_TICKS = 8  # before the moment jumped to, of which everything is read; of what is older the truth alone, for the trails
SPEEDS = (0.1, 100.0)


class ReplaySource:
    """A recording as a source of pictures."""

    def __init__(self, recording: Recording, speed: float = 1.0, playing: bool = True) -> None:
        self.picture = Picture(recording.scenario)
        self.jumps = 0  # grows when browsers must be greeted again
        self.period = FRAME_PERIOD
        self.clock = 0.0  # the world's time that is shown, s
        self.outbox: deque[Message] | None = None  # played messages that wait for publication
        self.playing, self.speed = playing, speed
        self._recording = recording
        self._scorer = Scorer(recording.scenario, recorded=True)
        self._historian = Picture(recording.scenario)
        self._scan: Iterator[float] | None = rescore_slowly(recording, self._scorer)
        self._scorer.on_event = self._historian.see
        self._scorer.on_report = lambda told: self._historian.note("told", told.who, told.text, told.time)
        self._faults = deque(recording.faults)  # that do not stand on the time line yet
        self.picture.take_happenings(self._historian)
        self._entries: Iterator[RecordedEntry] = recording.played()
        self._next: RecordedEntry | None = None

    @property
    def is_scanned(self) -> bool:
        """Whether the whole file has been scored."""
        return self._scan is None

    def scores(self) -> Sequence[Score]:
        return self._scorer.scores

    def score(self) -> Score | None:
        """That of the tick before the newest that has been played: of it everything has been heard."""
        truth, scores = self.picture.truth, self._scorer.scores
        if truth is None:
            return None
        at = bisect.bisect_left(scores, truth.tick - 1, key=lambda score: score.tick)
        return scores[at] if at < len(scores) and scores[at].tick <= truth.tick else None

    def beside(self) -> None:
        return None

    def about(self, may_act: bool) -> dict[str, Any]:
        return {"source": "replay", "verbs": []}

    def extra(self) -> dict[str, Any]:
        tick = math.floor(self.clock / self.picture.scenario.run.dt + 1e-9) * self.picture.scenario.run.dt  # a finer clock would be a frame
        return {"play": {"playing": self.playing, "speed": self.speed, "scanned": self.is_scanned, "clock": round(tick, 2)}}

    async def ask(self, request: dict[str, Any]) -> str:
        """{"play": true}, {"seek": 12.5} or {"speed": 10}."""
        if "play" in request:
            self.playing = bool(request["play"])
            if self.playing and self.clock >= self._recording.seconds:
                self.seek(0.0)
        elif "seek" in request:
            self.seek(number_of(request["seek"], 0.0, 1e12))
        elif "speed" in request:
            self.speed = number_of(request["speed"], *SPEEDS)
        else:
            raise BadSetting("a replay knows play, seek and speed")
        return ""

    async def run_while_shown(self) -> None:
        """Play, and look through the whole file between."""
        last = time.monotonic()
        while True:
            await asyncio.sleep(STEP if self.is_scanned else STEP * (1.0 - SCAN_SHARE))
            now = time.monotonic()
            self.advance(min(now - last, 0.5))
            last = now
            self.scan(STEP * SCAN_SHARE)

    def advance(self, seconds: float) -> None:
        """Play what is due after so many s of the wall clock."""
        if not self.playing:
            return
        self.clock = min(self.clock + seconds * self.speed, self._recording.seconds)
        self._feed(self.clock)
        if self.clock >= self._recording.seconds:
            self.playing = False

    def scan(self, seconds: float) -> None:
        """Go on with the look through the whole file, for so many s."""
        if self._scan is None:
            return
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            reached = next(self._scan, None)
            while self._faults and (reached is None or self._faults[0].time <= reached):
                self._historian.note_fault(self._faults.popleft())
            if reached is None:
                self._scan = None
                self.jumps += 1
                return

    def seek(self, to: float) -> None:
        """Show the moment `to`, s of the world."""
        self.clock = min(max(to, 0.0), self._recording.seconds)
        spans, scenario = self._recording.spans, self._recording.scenario
        first = max(0, bisect.bisect_right([span.start for span in spans], self.clock - max(TRAIL, KEPT_TICKS * scenario.run.dt)) - 1)
        self.picture.forget()
        self._entries, self._next = self._recording.played(first), None
        self._feed(self.clock, jumped_from=self.clock - WARM_TICKS * scenario.run.dt)
        self.jumps += 1

    def _feed(self, until: float, jumped_from: float | None = None) -> None:
        """Show the picture what was heard up to a time, and put the messages into the outbox.

        After a jump the outbox gets none of them, and of what is older than `jumped_from` the picture sees the truth and tokens alone.
        """
        self.picture.pause(paused_after(fault for fault in self._recording.faults if fault.time <= until))
        while True:
            entry = self._next or next(self._entries, None)
            self._next = None
            if entry is None:
                return
            if entry.time > until:
                self._next = entry
                return
            if jumped_from is None or entry.time >= jumped_from or not _is_talk(entry):
                event = event_of(entry)
                starts = jumped_from is not None and self.picture.truth is None
                self.picture.see(event, entry.time)
                if starts and self.picture.truth is not None:
                    self.picture.assume(self.picture.truth)
                if self.outbox is not None and jumped_from is None and isinstance(event, Received):
                    self.outbox.extend(event.batch.messages)


class ReplayNode(Node):
    """Says what is played once more, under the same keys; nobody's token is among it."""

    role = "monitor"
    incarnation = 1

    def __init__(self, run: str, outbox: deque[Message]) -> None:
        self.run, self.name = run, "replay"
        self._outbox = outbox
        self._due: float | None = None

    def deadline(self) -> float | None:
        """When the outbox is looked at next."""
        return self._due

    def handle(self, event: Event, now: float) -> list[Effect]:
        """Take one event and return what to say."""
        if not isinstance(event, Started | Timer):
            return []
        self._due = now + STEP
        said = list(self._outbox)
        self._outbox.clear()
        return [*said]


def _is_talk(entry: RecordedEntry) -> bool:
    """Whether it is a message of or to an agent: neither the truth nor a token."""
    parts = parse_message_key(entry.key)
    return parts is not None and parts.kind != "truth"
