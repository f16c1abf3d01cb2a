"""A step of prediction: to which tick, and under which settings."""

from typing import NamedTuple

from agents.config import AgentConfig
from protocol.streams import NORMAL_BOUND


class Step(NamedTuple):
    """The step of prediction to a tick."""

    config: AgentConfig
    tick: int

    @property
    def reach(self) -> float:
        """No particle moves farther than this in one step, m."""
        return self.config.filter.speed * self.config.run.dt * 1.001 + 2.0 * NORMAL_BOUND * self.config.filter.position_noise
