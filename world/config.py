"""What the world reads from a scenario: the common sections and those of targets, bodies and recorded worlds."""

from typing import Annotated, Any, Literal

import msgspec

from protocol.settings import CommonSettings, NotNegative, Positive, RunSettings, Section, Seed


class WorldRun(RunSettings, frozen=True, kw_only=True):
    """[run] with the seed from which target tracks, starts and detections follow; no agent reads it."""

    seed: Seed = 1
    derived: tuple[str, ...] = ()  # in a resolved scenario: settings that nobody said, which follow from others, and do so again


class TargetSettings(Section, frozen=True, kw_only=True):
    """[targets] how many there are and how they move (paper, section IV)."""

    count: Annotated[int, msgspec.Meta(ge=0, le=8000)] = 30  # at the start
    speed: NotNegative = 2.0  # m/s
    heading_noise: NotNegative = 0.2  # random walk of the heading, rad/sqrt(s); 0 = fixed heading
    border: Literal["reflect", "cross"] = "cross"  # IV-A stays inside; IV-B leaves and enters
    motion: str = "constant-speed"  # or module:Class


class BodySettings(Section, frozen=True, kw_only=True):
    """[bodies] where the sensors start: anywhere ("uniform"), or at the given poses x, y, heading; and who runs the bodies."""

    start: Literal["uniform", "given"] = "uniform"
    poses: dict[str, tuple[float, float, float]] = {}
    model: Literal["point", "mujoco"] = "point"  # mujoco: differential drives with mass, slip and contact (extra `mujoco`)
    position_error: NotNegative = 0.0  # standard deviation of a reported position on each axis, m; what agents believe is in [pose]
    heading_error: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.0  # standard deviation of a reported heading, rad
    time_error: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0  # standard deviation of the time at which a reported pose was true, s
    host: Literal["world", "own"] = "world"  # one world for all, or a process for every body; the rest is of such bodies
    epoch: Annotated[float, msgspec.Meta(ge=0.0, le=1.0e11)] = 0.0  # Unix time of tick 0, s; 0 = once all agents are there. realtime only
    platform: str = "simulated"  # or module:Class
    parameters: dict[str, Any] = {}  # of the user's own platform
    hold: Annotated[float, msgspec.Meta(ge=0.01, le=60.0)] = 0.5  # without a command for so long the body stands, s; at least two ticks
    fence: NotNegative | None = None  # no body is driven farther out of the arena than this, m


class RecordedSettings(Section, frozen=True, kw_only=True):
    """[recorded] a world from files of others: its targets, and with mrclam its bodies and scans as well."""

    kind: Literal["none", "pedestrians", "ships", "mrclam"] = "none"  # none: targets are simulated, as [targets] says
    data: str = ""  # the file, or the folder of mrclam; from the folder of the scenario
    start: NotNegative = 0.0  # s of the recording at which the run begins
    origin: tuple[float, float] = (0.0, 0.0)  # what becomes (0, 0) of the arena: x, y in m; for ships latitude, longitude in degrees
    longest_gap: Positive = 5.0  # s between two reports of a target; if it is silent for longer, it is away in between
    longest_hole: Positive = 5.0  # s in which the file may hold no line at all


class WorldConfig(CommonSettings, frozen=True, kw_only=True):
    """Everything the world process needs."""

    run: WorldRun = WorldRun()
    targets: TargetSettings = TargetSettings()
    bodies: BodySettings = BodySettings()
    recorded: RecordedSettings = RecordedSettings()

    @property
    def shared_seed(self) -> int:
        """The run's seed."""
        return self.run.seed
