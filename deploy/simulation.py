"""The simulation: the nodes of a live run, in one process and in virtual time.

The world waits for every live agent (lockstep), messages travel at once as real bytes, and faults strike when the world's time has
come. Without faults the trajectory is that of a live lockstep run, to the last bit.
"""

import gc
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

import msgspec

from agents.agent import Agent
from agents.backend import Backend
from deploy.faults.faults import LINK_VERBS, REFUSED, Action, Schedule, check_faults
from deploy.faults.injector import Build, Injector
from deploy.faults.links import Links
from deploy.oracle import Oracle, without_oracle
from deploy.scenario import ORACLE, Scenario, bodies_of, check_oracle, unsimulated, world_config, world_names
from deploy.scoring.result import Result
from deploy.scoring.scorer import Scorer
from protocol.observer_messages import Truth
from protocol.settings import BadSetting
from protocol.virtual import Link, VirtualBus
from world.body import Body
from world.platform import refuse_robots
from world.targets import Targets
from world.world import World


@contextmanager
def rare_collections() -> Iterator[None]:
    """Search for reference cycles rarely, among new objects only: messages and beliefs hold none, and the search took 6 to 9 % of a run.

    With 5000 agents more than 50 000 objects are new within a tick, and each search among them took 0.25 s.
    """
    before = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(500_000, 20, 50)
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()


def compiled() -> Backend:
    """The compiled backend; the first call imports the compiler."""
    from agents.compiled.backend import FAST

    return FAST


def compile_once() -> None:
    """On the first start on a machine compile every loop, with a notice."""
    from agents.compiled.warmup import compiled_before, warm

    if not compiled_before():
        print("covey: compiling the particle loops, once on this machine; some 40 s", file=sys.stderr, flush=True)
        warm()


class Simulation:
    """One run in virtual time: `step` until `done`, then `result`.

    `clock` is that of the world: "lockstep" waits for every live agent; in "realtime" a late agent misses its round.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        link: Link | None = None,
        backend: Backend | None = None,
        clock: Literal["lockstep", "realtime"] = "lockstep",
        build: Build = Agent,
        scores: bool = True,
    ) -> None:
        check_faults(scenario.faults, list(scenario.members), world_names(scenario))
        if bodies_of(scenario):
            refuse_robots(scenario.bodies)
        for number, fault in enumerate(scenario.faults):
            for name in unsimulated(scenario).intersection(map(str.strip, fault.who.split(","))):
                raise BadSetting(f"faults[{number}].who = {name!r}: a simulation has no such process to strike; `covey up` has")
        self.scenario = msgspec.structs.replace(scenario, run=msgspec.structs.replace(scenario.run, clock=clock, max_rate=0.0))
        self.links = Links(scenario.run.seed, list(scenario.members))
        period = scenario.run.dt / scenario.run.rate if clock == "lockstep" else 0.0  # virtual time passes as fast as the world's
        self.bus = VirtualBus(link=link, command_delay=period)
        self.scorer = Scorer(self.scenario, scores=scores)
        self.scorer.deaths.in_world_time = True
        run = self.scenario.run  # the world waits longer for a command than a command takes
        patient = msgspec.structs.replace(self.scenario, run=msgspec.structs.replace(run, patience=max(run.patience, 2.0 * period)))
        self.world = World(world_config(patient), 1)
        given = self.scenario
        if scenario.control.mode == ORACLE:
            check_oracle(scenario)
            given, build = without_oracle(given), Oracle(scenario, self.world).build
        self.injector = Injector(self.bus, self.links, given, backend or compiled(), build)
        self.is_stopped = False  # where it is set, `run` ends before the next event
        self.on_truth: Callable[[Truth], None] = lambda truth: None  # called with every new tick, after the faults of the tick
        self.on_refused: Callable[[BadSetting], None] = _give_up  # called with a fault of the scenario that cannot be carried out
        self._schedule = Schedule(scenario.run.seed, scenario.faults)
        self._started = time.perf_counter()
        self.scorer.on_truth = self._tick
        self.bus.add(self.scorer)
        if bodies_of(scenario):
            for name, label in bodies_of(scenario).items():
                self.bus.add(Body(world_config(patient), name, 1), label)
        else:
            self.bus.add(self.world)
        for name in scenario.members:
            self.injector.start(name)

    @property
    def agents(self) -> dict[str, Agent]:
        """The living agents by name; the second of a name by its label, such as s3#2."""
        return self.injector.agents

    @property
    def done(self) -> bool:
        """Whether the world, or every body that is left, has ended the run."""
        if not self.bus.stopped:
            return False
        names = world_names(self.scenario)
        return not set(names).intersection(self.bus.nodes()) and any(name in self.bus.stopped for name in names)

    def move_target(self, number: int, place: tuple[float, float]) -> None:
        """Put a target somewhere else, m, at once; raises BadSetting where it cannot be. The run is no longer that of its seed alone."""
        targets = self.world.scene.targets
        if not isinstance(targets, Targets) or bodies_of(self.scenario):
            raise BadSetting("a target can be moved in a simulated world only, where one process moves all targets")
        targets.place(number, place)

    def run(self) -> Result:
        """Play the run to its end, or until it is stopped."""
        with rare_collections():
            while not self.is_stopped and not self.done and self.bus.step():
                pass
        return self.result()

    def result(self) -> Result:
        """The record of what has been played."""
        while self.bus.step(self.bus.now):
            pass
        return self.scored(failed=False)

    def scored(self, *, failed: bool = True) -> Result:
        """The record of what has been scored: of a simulation that an error has ended, which cannot go on."""
        self.scorer.finish(self.bus.now, failed=failed)
        return self.scorer.result(time.perf_counter() - self._started, self.bus.messages, self.bus.bytes)

    def _tick(self, truth: Truth) -> None:
        alive, dead = self.injector.alive(), self.injector.dead()
        for action in self._schedule.due(truth.time, alive, dead, [*alive, *dead, *world_names(self.scenario)]):
            try:
                self._carry_out(action, alive)
            except BadSetting as refused:
                self.on_refused(refused)
        self.on_truth(truth)

    def _carry_out(self, action: Action, alive: list[str]) -> None:
        if action.verb == REFUSED:
            raise BadSetting(action.options["why"])
        if action.verb in ("pause", "resume") or self.scorer.deaths.paused.intersection(action.names):
            self.scorer.note_fault(action.verb, f"{action.verb} {', '.join(action.names)}", ",".join(action.names), self.bus.now)
        self.injector.strike(action)
        if action.verb in LINK_VERBS:
            self.scorer.note_fault(action.verb, self.links.describe(action), sides=self.links.sides(alive))


def _give_up(refused: BadSetting) -> None:
    raise refused
