"""What the world reads from a scenario: the common sections and those of targets and bodies."""

from typing import Annotated, Literal

import msgspec

from protocol.settings import Common, NotNegative, RunSettings, Section, Seed


class WorldRun(RunSettings, frozen=True, kw_only=True):
    """[run] with the seed from which target tracks, starts and detections follow; no agent reads it."""

    seed: Seed = 1


class TargetSettings(Section, frozen=True, kw_only=True):
    """[targets] how many there are and how they move (paper, section IV)."""

    count: Annotated[int, msgspec.Meta(ge=0, le=8000)] = 30  # at the start
    speed: NotNegative = 2.0  # m/s
    heading_noise: NotNegative = 0.2  # random walk of the heading, rad/sqrt(s); 0 = fixed heading
    border: Literal["reflect", "cross"] = "cross"  # IV-A stays inside; IV-B leaves and enters
    motion: str = "constant-speed"  # or module:Class


class BodySettings(Section, frozen=True, kw_only=True):
    """[bodies] where the sensors start: anywhere ("uniform"), or at the given poses x, y, heading."""

    start: Literal["uniform", "given"] = "uniform"
    poses: dict[str, tuple[float, float, float]] = {}


class WorldConfig(Common, frozen=True, kw_only=True):
    """Everything the world process needs."""

    run: WorldRun = WorldRun()
    targets: TargetSettings = TargetSettings()
    bodies: BodySettings = BodySettings()

    @property
    def dice(self) -> int:
        """The run's seed."""
        return self.run.seed
