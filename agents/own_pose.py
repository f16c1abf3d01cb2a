"""The pose that an agent states of its own body, and how exactly it knows that pose.

Data types: `OwnPose` holds what one agent has averaged; an `AveragingWeight` is the weight and the variance of one mean.

Rules. A report errs by `pose.position_noise` and `pose.heading_noise`, and by the motion of `pose.time_noise` seconds. With `pose.memory`
the agent moves its last pose on as it has commanded and averages it with the report. Weights are inverse variances, and fade by 1/e in
`memory` seconds. A report that contradicts the mean starts it anew: the body did not obey, or was carried away.
"""

import math
from dataclasses import dataclass

import msgspec

from agents.config import AgentConfig
from agents.coverage.control import STAND, ControlInput
from protocol.fields import pack
from protocol.geometry import wrap_angle
from protocol.message import Vector
from protocol.messages import Observation
from protocol.pose import clip_motion, from_other_frame, integrate
from protocol.sensing import SensorModel, measurement_of

SURPRISE = 4.0  # standard deviations between a report and the mean
LEAST_VARIANCE = 1.0e-8  # m^2 or rad^2: no report weighs more than one of this variance


@dataclass
class AveragingWeight:
    """A mean of reports: the sum of their weights, and its own variance if their errors are independent."""

    weight: float = 0.0
    variance: float = 0.0

    def add(self, variance: float, kept: float) -> float:
        """The share of a new report of this variance in the mean; earlier ones have kept this share of their weights."""
        new = 1.0 / max(variance, LEAST_VARIANCE)
        self.weight = kept * self.weight + new
        share = new / self.weight
        self.variance = (1.0 - share) * (1.0 - share) * self.variance + share * share * variance
        return share

    def contradicts(self, error: float, variance: float) -> bool:
        """Whether a report of this variance is too far away from the mean."""
        return error * error > SURPRISE * SURPRISE * (self.variance + max(variance, LEAST_VARIANCE))


class OwnPose:
    """The pose of one agent.

    `noise` are the standard deviations of the pose last stated, m and rad; None: it is exact. `command` moves the body, and `steered` is
    its tick.
    """

    def __init__(self, config: AgentConfig, sensor: SensorModel) -> None:
        self.noise: Vector | None = None
        self._config, self._sees_places = config, measurement_of(sensor) is None
        self.command: ControlInput = STAND
        self.steered = -1
        self._last: Observation | None = None  # from the pose that was stated
        self._place, self._turn = AveragingWeight(), AveragingWeight()

    def note_command(self, command: ControlInput, tick: int) -> None:
        """Take the command that moves the body until the next one."""
        self.command, self.steered = command, tick

    def correct(self, observation: Observation) -> Observation:
        """The observation, which is taken in, from the pose that the agent believes in; detections and obstacles move with it."""
        if self._config.pose.is_exact:
            return observation
        place, turn = self._variances()
        if self._config.pose.memory > 0.0:
            observation = self._last = self._averaged(observation, place, turn)
            place, turn = self._place.variance, self._turn.variance
        self.noise = math.sqrt(place), min(math.sqrt(turn), math.pi)
        return observation

    def _variances(self) -> tuple[float, float]:
        """The variances of a report: of its place on each axis, m^2, and of its heading, rad^2.

        A body that moves at v m/s errs by v times `time_noise` along its way, which is half of that variance on each axis.
        """
        settings, ((x, y), turn_rate) = self._config.pose, clip_motion(*self.command, self._config.limits)
        turn = turn_rate * settings.time_noise
        place = settings.position_noise * settings.position_noise + 0.5 * settings.time_noise * settings.time_noise * (x * x + y * y)
        return place, settings.heading_noise * settings.heading_noise + turn * turn

    def _averaged(self, observation: Observation, place: float, turn: float) -> Observation:
        """The observation from the mean of the report, of these variances, and of the earlier ones."""
        last, reported = self._last or observation, observation.pose
        seconds = (observation.tick - last.tick) * self._config.run.dt
        moved = integrate(last.pose, *self.command, seconds, self._config.limits)
        x, y, heading = reported[0] - moved[0], reported[1] - moved[1], wrap_angle(reported[2] - moved[2])
        if self._place.contradicts(math.hypot(x, y), place) or self._turn.contradicts(heading, turn):
            self._place, self._turn = AveragingWeight(), AveragingWeight()
        kept = math.exp(-seconds / self._config.pose.memory)
        share, turned = self._place.add(place, kept), self._turn.add(turn, kept)
        pose = moved[0] + share * x, moved[1] + share * y, wrap_angle(moved[2] + turned * heading)
        obstacles = from_other_frame(observation.obstacles, reported, pose)
        detections = observation.detections_bytes
        if self._sees_places:
            detections = pack(from_other_frame(observation.detections, reported, pose), "<f4")
        return msgspec.structs.replace(observation, pose=pose, detections_bytes=detections, obstacles_bytes=pack(obstacles, "<f8"))
