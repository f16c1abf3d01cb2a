"""The actions of operators, and of the faults of a scenario, on the processes and the links of a run."""

import asyncio
import logging
import signal
from collections.abc import Callable
from typing import Any

import numpy as np

from deploy.faults.faults import LINK_VERBS, REFUSED, Action, Schedule, check_fault, choose, plain_verb
from deploy.faults.links import Links
from deploy.live.processes import Child, State
from deploy.live.startup import Startup
from deploy.scenario import FaultSettings, Scenario, world_names
from deploy.scoring.scorer import Scorer
from deploy.storage.run_directory import RunDirectory
from protocol.codec import encode
from protocol.link_faults import as_line
from protocol.settings import BadSetting
from protocol.whole_file import write_whole

REQUIRED_STATE: dict[str, State] = {"kill": "running", "pause": "awake", "resume": "paused", "restart": "dead"}  # of a process, for a verb

log = logging.getLogger(__name__)


class Operations:
    """Kills, pauses, resumes and restarts the children of a supervisor, and changes their links."""

    def __init__(
        self,
        scenario: Scenario,
        children: dict[str, Child],
        scorer: Scorer,
        directory: RunDirectory,
        start: Startup,
        tell: Callable[[str], None],
        on_death: Callable[[Child], None],
    ) -> None:
        """`tell`: a line for people; `on_death`: for a child that was to be replaced, and could only be ended."""
        self._scenario, self._children, self._scorer, self._directory, self._start = scenario, children, scorer, directory, start
        self._tell, self._on_death = tell, on_death
        self._schedule = Schedule(scenario.run.seed, scenario.faults)
        self._links = Links(scenario.run.seed, list(scenario.members))
        self._rng = np.random.default_rng()  # of commands by hand only; those of the scenario are drawn from its seed

    def run_due_faults(self, time: float) -> None:
        """The world's time, s, has moved on: carry out the faults of the scenario that are due."""
        for action in self._schedule.due(time, self._agents("running"), self._agents("dead"), list(self._children)):
            try:
                if action.verb == REFUSED:
                    raise BadSetting(action.options["why"])
                if state := REQUIRED_STATE.get(action.verb):  # processes that have died or gone on since are left out, as in a simulation
                    action = action._replace(names=[name for name in action.names if self._children[name].is_in(state)])
                self.act(action)
            except BadSetting as error:
                self._tell(f"a fault of the scenario could not be carried out: {error}")

    def run_request(self, request: dict[str, Any]) -> str:
        """Carry out a request of the control socket; a line that says what was done."""
        verb, who, scenario = str(request.get("verb", "")), str(request.get("who", "")), self._scenario
        fault = FaultSettings(at=0.0, verb=verb, who=who, value=request.get("value"), options=request.get("options") or {})
        members = [*scenario.members]
        check_fault(fault, "", members, [*members, *world_names(scenario)], live=True, link_faults=scenario.network.link_faults)
        self.take_signals_from_outside()
        candidates = self._agents(REQUIRED_STATE.get(verb, "running"))
        names = choose(who, candidates, list(self._children), self._rng) if who else candidates
        return self.act(Action(plain_verb(verb), names, fault.value, fault.options))

    def act(self, action: Action) -> str:
        """Carry out an action; a line that says what was done."""
        verb, names = action.verb, action.names
        if verb in LINK_VERBS:
            return self._change_links(action)
        for name in names:  # before anything is done; a restart may still fail at one of several
            if not self._children[name].has_started:
                raise BadSetting(f"{name} has not been started yet: the run still starts; try again in a second")
            if verb != "restart" and not self._children[name].is_running:
                raise BadSetting(f"{name} is not running; `covey restart {name}` brings it back")
            if verb in ("pause", "resume") and not self._children[name].is_in(REQUIRED_STATE[verb]):
                raise BadSetting(f"{name} is {'not paused' if verb == 'resume' else 'paused already'}")
        self.tell_scorer(verb, [name for name in names if self._children[name].is_running])
        for name in names:
            child = self._children[name]
            if verb == "restart":
                self._restart(child)
            else:
                child.send({"kill": signal.SIGKILL, "pause": signal.SIGSTOP, "resume": signal.SIGCONT}[verb])
        past = {"kill": "killed", "pause": "paused", "resume": "resumed", "restart": "restarted"}[verb]
        text = f"{past} {', '.join(names)}" if names else f"nobody to {verb}"
        log.info(text)
        self._tell(text)
        return text

    def tell_scorer(self, verb: str, names: list[str]) -> None:
        """Tell the scorer which agents are paused on request: a paused agent whose token is lost has not died."""
        if verb in ("pause", "resume") or self._scorer.deaths.paused.intersection(names):
            self._scorer.note_fault(verb, f"{verb} {', '.join(names)}", ",".join(names), asyncio.get_running_loop().time())

    def _change_links(self, action: Action) -> str:
        """Change the links between agents: every agent receives its new reception."""
        self._links.act(action, self._agents("awake"))
        for name in self._scenario.members:
            self._tell_links(name)
        text = self._links.describe(action)
        self._scorer.note_fault(action.verb, text, sides=self._links.sides(self._agents("running")))
        log.info(text)
        self._tell(text)
        return text

    def _tell_links(self, name: str) -> None:
        if self._scenario.network.link_faults and name in self._scenario.members:
            self._children[name].tell(as_line(self._links.reception(name)))

    def _restart(self, child: Child) -> None:
        """Bring a process back under its name, with the next incarnation of all that had it; a restarted world goes on from the last truth.

        Raises BadSetting when the machine does not let it: a disk is full, or there are too many processes.
        """
        was_running = child.is_running
        try:
            self._replace(child)
        except OSError as error:
            if was_running and not child.is_running:
                self._on_death(child)
            raise BadSetting(f"{child.name} could not be restarted: {error.strerror or error}") from None

    def _replace(self, child: Child) -> None:
        """End a process if it runs, and start its next incarnation; raises OSError."""
        truth = self._scorer.truth if child.package == "world" else None
        if truth is not None:
            write_whole(self._directory.truth, encode(truth))
        if child.process is not None:
            child.process.kill()
            child.process.wait()
            child.poll()
        newest = self._scorer.newest.get(child.token, 0)  # of a process that was started by hand, or of a bridge
        if truth is not None:
            child.start("--restore", str(self._directory.truth), newest=newest)
        else:
            child.start(newest=newest)
            self._start.expect()
            self._tell_links(child.name)

    def _agents(self, state: State) -> list[str]:
        """Names of the agents in a state."""
        return [name for name in self._scenario.members if self._children[name].is_in(state)]

    def take_signals_from_outside(self) -> None:
        """Note and tell which processes a signal from outside has stopped, and which it has let go on."""
        for child in self._children.values():
            if verb := child.look():
                self.tell_scorer(verb, [child.name])
                text = f"has been stopped from outside; `covey resume {child.name}` lets it go on"
                self._tell(f"{child.name} {text if verb == 'pause' else 'goes on, told from outside'}")
