"""Search and track: a control law beyond the paper that divides what is worth seeing among the sensors around.

Data types: a `SearchAndTrack` remembers when the bins of the arena and the particles around its cell were last in view.

Rules. An agent announces where it goes and how much it has to watch there. What partners with a shorter way look after is worth less to
it. `search_plan` holds the arithmetic. An agent that announces nothing counts as one that stays where it is.
"""

import math

from agents.backend import PLAIN, Backend
from agents.config import SearchSettings
from agents.coverage.capacity import sensor_facts
from agents.coverage.control import STAND, ControlInput, ControlLaw, Situation
from agents.coverage.search_plan import Memory, PlanInput, Task, no_memory


class SearchAndTrack(ControlLaw):
    """The search-and-track law."""

    uses_surroundings = True

    def __init__(self, settings: SearchSettings = SearchSettings(), backend: Backend = PLAIN) -> None:
        self._settings, self._backend = settings, backend
        self._memory: Memory | None = None

    def command(self, situation: Situation) -> ControlInput:
        """Velocity and turn rate until the next command; stands without the surroundings that only a round knows."""
        surroundings, sensor, limits = situation.surroundings, situation.sensor, situation.limits
        if surroundings is None:
            return STAND
        angle = min(2.0 * math.pi, 2.0 * sensor.area / (sensor.reach * sensor.reach))  # of view, rad
        shape = sensor.reach, angle, math.hypot(*sensor_facts(sensor).cod_offset)
        (x, y, heading), (width, height) = situation.pose, situation.arena
        now, cos, sin = situation.tick * situation.dt, math.cos(heading), math.sin(heading)
        bounds = width, height, limits.speed, limits.turn_rate
        numbers = PlanInput(
            now, situation.dt * situation.ticks, x, y, cos, sin, *shape, *bounds, float(surroundings.is_open), *surroundings.goal
        )
        task, memory = (
            Task(numbers, self._settings, sensor, heading, surroundings),
            self._memory or no_memory(width, height, self._settings.bin),
        )
        velocity, turn_rate, self.intent, self._memory = self._backend.decide(task, memory)
        return velocity, turn_rate
