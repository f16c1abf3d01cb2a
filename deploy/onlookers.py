"""The recorder and the page of a run: they hear what its scorer hears, in its process, and nothing of what they do reaches the swarm."""

import asyncio
import contextlib
import logging
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from deploy.monitor.server import PageServer
from deploy.monitor_node import Scorer
from deploy.records.recorder import FLUSH_SECONDS, Recorder
from deploy.records.recording import NAME
from deploy.scenario import Scenario
from protocol.node import Event
from protocol.settings import BadSetting

log = logging.getLogger(__name__)


def recording_path(record: bool | Path, folder: Path) -> Path | None:
    """Where to record: into the run directory unless a file is named; None when nothing is to be recorded."""
    if isinstance(record, bool):
        return folder / NAME if record else None
    if record.suffix != ".mcap":
        raise BadSetting(f"--record {record}: should be a file that ends in .mcap")
    return record


def open_recorder(path: Path, scenario: Scenario, *, virtual: bool = False) -> Recorder:
    """A recorder; raises BadSetting naming the file when it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return Recorder(path, scenario, None) if virtual else Recorder(path, scenario)
    except OSError as error:
        raise BadSetting(f"--record {path}: {error.strerror}") from None


class Onlookers:
    """What listens to one scorer; a context in the event loop of the run. One that fails is left out from then on, the run goes on."""

    def __init__(self, scorer: Scorer, recorder: Recorder | None, page: PageServer | None = None) -> None:
        self._recorder = recorder
        self._page = page
        self._listeners: list[Callable[[Event, float], None]] = [recorder.see] if recorder else []
        if page is not None:
            self._listeners.append(page.source.picture.see)
        self._chores: asyncio.Task[None] | None = None
        scorer.on_event = self._see
        scorer.on_finish = self._finish
        scorer.on_fault = recorder.note_fault if recorder else scorer.on_fault

    async def __aenter__(self) -> "Onlookers":
        if self._recorder is not None:
            self._chores = asyncio.create_task(self._flush())
        if self._page is not None:
            await self._page.open()
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._chores is not None:
            self._chores.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._chores
        self._finish()
        if self._page is not None:
            await self._page.close()

    def _see(self, event: Event, now: float) -> None:
        for listener in list(self._listeners):
            try:
                listener(event, now)
            except Exception:
                log.exception("an onlooker failed and is left out from here on")
                self._listeners.remove(listener)

    def _finish(self) -> None:
        if self._recorder is not None:
            self._recorder.close()

    async def _flush(self) -> None:
        """What was heard reaches the file within a second, also when nothing more is heard."""
        assert self._recorder is not None
        while True:
            await asyncio.sleep(1.0 - FLUSH_SECONDS)
            self._recorder.flush(FLUSH_SECONDS)
