"""The control laws by the name that a scenario gives in `control.mode`; a law of the user's own is named as `module:Class`.

A law of the user's own is a class without arguments, and every command of it is checked.
"""

import math

from agents.backend import PLAIN, Backend
from agents.config import AgentConfig
from agents.coverage.control import ControlInput, ControlLaw, Lloyd, RandomWalk, Situation, Static, UniformDensity
from agents.coverage.pursuit import Pursuit
from agents.coverage.search_and_track import SearchAndTrack
from agents.tracking.particles import Particles
from protocol.pose import clip_motion
from protocol.settings import BadSetting
from protocol.user_classes import as_bad_setting, build, is_number, shown

CONTROL_LAWS: dict[str, type[ControlLaw]] = {
    "lloyd": Lloyd,
    "uniform-density": UniformDensity,
    "static": Static,
    "random": RandomWalk,
    "pursuit": Pursuit,
    "search-and-track": SearchAndTrack,
}


def control_law(config: AgentConfig, backend: Backend = PLAIN) -> ControlLaw:
    """The control law that the scenario names; raises BadSetting for an unknown or faulty law."""
    mode = config.control.mode
    if mode in CONTROL_LAWS:
        return SearchAndTrack(config.search, backend) if CONTROL_LAWS[mode] is SearchAndTrack else CONTROL_LAWS[mode]()
    if ":" not in mode:
        raise BadSetting(f"control.mode = {mode!r}: known are {', '.join(CONTROL_LAWS)}, or your own as module:Class")
    try:
        return CheckedLaw(build(mode, "Class() with a method command(situation)", ("command",)), mode)
    except ValueError as error:
        raise BadSetting(f"control.mode = {mode!r}: {error}") from error.__cause__


class CheckedLaw(ControlLaw):
    """A control law of the user, within the limits of the body; an answer that is no command raises BadSetting with the class's name."""

    def __init__(self, law: ControlLaw, name: str) -> None:
        self._law, self._name = law, name
        self.uses_nearby_sensors = bool(getattr(law, "uses_nearby_sensors", False))

    def command(self, situation: Situation) -> ControlInput:
        """The command of the law, clipped to the limits; raises BadSetting if it is not ((vx, vy), turn rate) of finite numbers."""
        with as_bad_setting(f"{self._name}.command"):
            answer = self._law.command(_copied(situation))
        try:
            (vx, vy), turn_rate = answer
            numbers = tuple(float(value) if is_number(value) else math.nan for value in (vx, vy, turn_rate))
        except (TypeError, ValueError):
            numbers = (math.nan,)
        if not all(map(math.isfinite, numbers)):
            raise BadSetting(
                f"{self._name}.command returned {shown(answer)}: should be ((vx, vy), turn_rate), finite numbers in m/s and rad/s"
            )
        return clip_motion((numbers[0], numbers[1]), numbers[2], situation.limits)


def _copied(situation: Situation) -> Situation:
    """The situation with arrays of its own: a law that writes into them changes neither the filter nor what other agents read."""
    particles = Particles(*[column.copy() for column in situation.particles])
    return situation._replace(cell=situation.cell.copy(), particles=particles, generators=situation.generators.copy())
