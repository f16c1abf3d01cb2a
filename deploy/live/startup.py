"""The start of a run: starts every process, and reports what the first tick waits for and which agents miss it."""

import asyncio
import os
import time
from collections.abc import Callable
from pathlib import Path

from agents.compiled.cache import compiled_before, loops_on_disk, number_of_loops
from deploy.live.processes import Child
from deploy.live.zygote import Zygote
from deploy.scenario import Scenario, bodies_of
from deploy.scoring.scorer import Scorer
from protocol.endpoints import check_files
from protocol.observer_messages import Truth
from protocol.settings import BadSetting

HOLD = 20.0  # s at most for which the last agent is held back without a new process heard by the monitor
LOOK = 0.05  # s between two looks at the zygote while it prepares
MOST_NAMED = 5  # missing agents that are named; more are counted


def check_certificates(scenario: Scenario) -> None:
    """Raise BadSetting where a process of a run with certificates on this machine has none that the others accept."""
    if not scenario.network.encrypted:
        return
    from deploy.live.certificates import wrong_with_certificate  # which loads cryptography

    for name in ("monitor", *(() if bodies_of(scenario) else ("world",)), *scenario.members):
        check_files(scenario.network, name)
        for wrong in wrong_with_certificate(scenario.network, name):
            raise BadSetting(wrong)


class Startup:
    """Used once by a supervisor, in its event loop. Nothing here blocks: a run can be ended while it starts."""

    def __init__(self, members: list[str], children: list[Child], scorer: Scorer, zygote: Zygote | None, log: Path) -> None:
        """`members` are the agents that the scenario has, `log` is that of the zygote."""
        self._members, self._children, self._scorer, self._zygote, self._log = members, children, scorer, zygote, log
        self._begun = self._prepared = time.monotonic()  # when the start began, and when agents could be forked
        self._is_told = False  # the early end of the zygote has been reported

    async def start_all(self, tell: Callable[[str], None]) -> None:
        """Start all processes, the last agent once the monitor hears all others. The world waits for it, so no tick is missed.

        Raises BadSetting when the machine does not let it.
        """
        *first, last = self._children
        for child in first:
            if child.zygote is not None:
                await self._prepare(child.zygote, tell)
            _start(child)
            if child.package == "world":
                self.expect()
        heard, end = 0, time.monotonic() + HOLD
        while time.monotonic() < end and not self._are_heard(first):
            if len(self._scorer.greeted) > heard:
                heard, end = len(self._scorer.greeted), time.monotonic() + HOLD
            await asyncio.sleep(0.02)
        if last.zygote is not None:
            await self._prepare(last.zygote, tell)
        _start(last)

    async def _prepare(self, zygote: Zygote, tell: Callable[[str], None]) -> None:
        """Return when the zygote can fork or has ended. There is no time limit: the very first start compiles."""
        while not zygote.is_ready and not zygote.is_gone:
            await asyncio.sleep(LOOK)
            zygote.collect()
            self._prepared = time.monotonic()
        if not zygote.is_ready and not self._is_told:
            self._is_told = True
            log = os.path.relpath(self._log)
            tell(f"the process that prepares agents has ended, see {log}; each agent starts by itself, and works slower")

    def expect(self) -> None:
        """Tell the world, or every body, to wait for all agents whose processes have not ended; so it needs no time limit."""
        if self._scorer.truth is None:
            ended = {child.name for child in self._children if child.returncode is not None}
            for child in self._children:
                if child.package == "world":
                    child.tell(" ".join(name for name in self._members if name not in ended))

    def _are_heard(self, children: list[Child]) -> bool:
        """Whether the monitor has heard all of these that run."""
        return all(child.name in self._scorer.greeted or not child.is_running for child in children)

    def waiting(self) -> str:
        """What the first tick waits for, in words; empty from then on."""
        if self._scorer.truth is not None:
            return ""
        if self._zygote is None or self._zygote.is_ready or self._zygote.is_gone:
            alive = self._scorer.alive()
            present = self._who([name for name in self._members if name not in alive])
            if not alive and time.monotonic() - self._prepared > HOLD:
                return f"there are {present}; none is heard, and the logs may say why: {os.path.relpath(self._log.parent)}"
            return f"there are {present}"
        if compiled_before():
            return "loading the compiled loops"
        number, seconds = number_of_loops(), time.monotonic() - self._begun
        return f"compiling loop {min(loops_on_disk() + 1, number)} of {number}, once on this machine ({seconds:.0f} s so far)"

    def check(self, truth: Truth) -> str:
        """A complaint when members are missing at the first tick, which also stands in the result and on the page; else empty."""
        missing = [name for name in self._members if name not in truth.alive]
        if not missing:
            return ""
        complaint = f"the run starts with {self._who(missing)}"
        self._scorer.missing = tuple(missing)
        self._scorer.note_fault("start", complaint)
        return complaint

    def _who(self, missing: list[str]) -> str:
        """The number of present agents, and the names of missing ones."""
        number = f"{len(self._members) - len(missing)} of {len(self._members)} agents"
        more = f" and {len(missing) - MOST_NAMED} more" if len(missing) > MOST_NAMED else ""
        return f"{number} (without {', '.join(missing[:MOST_NAMED])}{more})" if missing else number


def _start(child: Child) -> None:
    try:
        child.start()
    except OSError as error:
        raise BadSetting(f"{child.name} could not be started: {error.strerror or error}") from None
