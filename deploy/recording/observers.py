"""The observers of a run, recorder and page: they receive the events of its scorer, in its process, and send nothing to the swarm."""

import asyncio
import contextlib
import itertools
import logging
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from deploy.recording.recorder import FLUSH_SECONDS, Recorder
from deploy.recording.recording import NAME
from deploy.scenario import Scenario
from deploy.scoring.result import EventReport, Fault
from deploy.scoring.scorer import Scorer
from protocol.node import Event, Gone
from protocol.settings import BadSetting

if TYPE_CHECKING:
    from deploy.page.server import PageServer

log = logging.getLogger(__name__)


def recording_path(record: bool | Path, folder: Path) -> Path | None:
    """Where to record: into the run directory, beside other recordings of the run, unless a file is named; None: nowhere."""
    if isinstance(record, bool):
        return _taken(folder / NAME) if record else None
    if record.suffix != ".mcap":
        raise BadSetting(f"--record {record}: should be a file that ends in .mcap")
    return record


def _taken(path: Path) -> Path:
    """The path, or the first with a number that did not exist: recording-2.mcap. It does now, so that no other recorder takes it."""
    for number in itertools.count(1):
        one = path.with_stem(f"{path.stem}-{number}") if number > 1 else path
        try:
            one.open("xb").close()
            return one
        except FileExistsError:
            continue
        except OSError as error:
            raise BadSetting(f"--record {one}: {error.strerror}") from None
    raise AssertionError("names do not end")


def open_recorder(path: Path, scenario: Scenario, *, virtual: bool = False) -> Recorder:
    """A recorder; raises BadSetting naming the file when it cannot be written, or holds something already."""
    try:
        if path.exists() and path.stat().st_size:
            raise BadSetting(f"--record {path}: holds something already; should be a new file")
        path.parent.mkdir(parents=True, exist_ok=True)
        return Recorder(path, scenario, None) if virtual else Recorder(path, scenario)
    except OSError as error:
        raise BadSetting(f"--record {path}: {error.strerror}") from None


class Observers:
    """The observers of one scorer, as a context in the event loop of the run. A failing observer is removed; the run continues."""

    def __init__(
        self, scorer: Scorer, recorder: Recorder | None, page: "PageServer | None" = None, has_ended: Callable[[], bool] = lambda: False
    ) -> None:
        """`has_ended`: whether the run has been ended, as seen from outside; agents that leave from then on are dismissed."""
        self._scorer = scorer
        self._has_ended = has_ended
        self._recorder = recorder
        self._page = page
        self._listeners: list[Callable[[Event, float], None]] = [recorder.see] if recorder else []
        if page is not None:
            self._listeners.append(page.source.picture.see)
        self._flushing: asyncio.Task[None] | None = None
        scorer.on_event = self._see
        scorer.on_finish = self._finish
        scorer.on_fault = self._note_fault
        self._told, scorer.on_report = scorer.on_report, self._tell

    async def __aenter__(self) -> "Observers":
        if self._recorder is not None:
            self._flushing = asyncio.create_task(self._flush())
        if self._page is not None:
            await self._page.open()
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._flushing is not None:
            self._flushing.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._flushing
        self._finish()
        if self._page is not None:
            await self._page.close()

    def _note_fault(self, fault: Fault) -> None:
        if self._recorder is not None:
            self._recorder.note_fault(fault)
        if self._page is not None:
            self._page.source.picture.note_fault(fault)

    def _tell(self, told: EventReport) -> None:
        self._told(told)
        if self._page is not None:
            self._page.source.picture.note("told", told.who, told.text, told.time)

    def _see(self, event: Event, now: float) -> None:
        if isinstance(event, Gone) and event.role == "agent" and (self._scorer.is_over or self._has_ended()):
            self._freeze()
        for listener in list(self._listeners):
            try:
                listener(event, now)
            except Exception:
                log.exception("an onlooker failed and is left out from here on")
                self._listeners.remove(listener)

    def _freeze(self) -> None:
        """The page keeps what it shows, and says that the run is over."""
        if self._page is not None:
            self._page.freeze()
            self._listeners = [listener for listener in self._listeners if listener != self._page.source.picture.see]

    def _finish(self) -> None:
        self._freeze()
        if self._recorder is not None:
            self._recorder.close()

    async def _flush(self) -> None:
        """Write received messages to the file within a second, even when no more arrive."""
        assert self._recorder is not None
        while True:
            await asyncio.sleep(1.0 - FLUSH_SECONDS)
            self._recorder.flush(FLUSH_SECONDS)
