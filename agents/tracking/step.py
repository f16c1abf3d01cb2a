"""The context of a tick: its number and the settings, from which a step of prediction follows."""

from typing import NamedTuple

from agents.config import AgentConfig
from protocol.random_streams import NORMAL_BOUND


class Step(NamedTuple):
    """The context of `tick`; its prediction goes from the tick before to it."""

    config: AgentConfig
    tick: int

    @property
    def max_displacement(self) -> float:
        """An upper bound in m of the distance that a particle moves in one step."""
        return self.config.filter.speed * self.config.run.dt * 1.001 + 2.0 * NORMAL_BOUND * self.config.filter.position_noise
