"""Perfect knowledge as a yardstick: sensors that are sent to the true targets by a central assignment, in a simulation only.

Data types: an `Oracle` knows the world of a simulation; an `OracleLaw` is the control law of one of its agents.

Rules. Only the bodies profit: filter, cells and estimates are those of any other agent. The assignment minimises the sum of the
distances from the CODs to the targets, and remembers nothing. It is no bound: a swarm that remembers tracks may do better.
"""

import msgspec
import numpy as np

from agents.agent import Agent
from agents.backend import Backend
from agents.config import AgentConfig, ControlSettings
from agents.coverage.capacity import centroid_of_detection
from agents.coverage.control import STAND, ControlInput, ControlLaw, Situation, approach
from deploy.scenario import Scenario
from protocol.settings import sensor_of
from world.assignment import linear_sum_assignment
from world.world import World


class Oracle:
    """Assigns the bodies of a simulation to its targets."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        self._world, self._tick, self._goals = world, -1, dict[str, tuple[float, float]]()
        self._sensors = {name: sensor_of(scenario, kind) for name, kind in scenario.members.items()}

    def goal(self, name: str) -> tuple[float, float] | None:
        """The target that a body is sent to in this tick, m; None when there are fewer targets than bodies."""
        if self._tick != self._world.tick:
            self._tick, self._goals = self._world.tick, self._assigned()
        return self._goals.get(name)

    def _assigned(self) -> dict[str, tuple[float, float]]:
        """The targets of all bodies that have one; a body whose agent has died has none."""
        names, targets = [name for name in self._world.present() if name in self._sensors], self._world.scene.targets.positions
        places = np.array([centroid_of_detection(self._sensors[name], self._world.bodies.poses[name]) for name in names]).reshape(-1, 2)
        apart = np.hypot(places[:, 0, None] - targets[:, 0], places[:, 1, None] - targets[:, 1])
        rows, columns = linear_sum_assignment(apart)
        return {names[row]: (float(targets[column, 0]), float(targets[column, 1])) for row, column in zip(rows, columns)}

    def build(self, config: AgentConfig, name: str, incarnation: int, backend: Backend, sensor_class: str) -> Agent:
        """An agent whose body the oracle drives (`injector.Build`)."""
        agent = Agent(config, name, incarnation, backend, sensor_class)
        agent.context = agent.context._replace(law=OracleLaw(self))
        return agent


class OracleLaw(ControlLaw):
    """Drives the COD onto the assigned target and faces it; stands without one."""

    def __init__(self, oracle: Oracle) -> None:
        self._oracle = oracle

    def command(self, situation: Situation) -> ControlInput:
        """Velocity and turn rate until the next tick."""
        goal = self._oracle.goal(situation.name)
        return STAND if goal is None else approach(situation, goal)


def without_oracle(scenario: Scenario) -> Scenario:
    """The scenario that agents are given: they know no oracle."""
    return msgspec.structs.replace(scenario, control=ControlSettings(mode="static"))
