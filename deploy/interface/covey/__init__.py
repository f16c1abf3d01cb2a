"""Covey in Python: simulate a swarm, run a study, load a recording, and plug in sensors and controllers of your own.

    import covey

    run = covey.simulate("quick", seed=3, seconds=20)
    run.ospa.mean()          # numpy arrays, one value for each tick
    run.to_pandas()          # the same as a table, where pandas is installed

What is simulated is what the command `covey simulate` simulates: the same scenario and seed give the same run. A setting that is wrong
raises `BadSetting`, a ValueError of one line. Every name is imported when it is first used, so `import covey` costs nothing.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agents.coverage.control import STAND, ControlInput, ControlLaw, Situation, approach
    from covey.runs import Run, load, scenario, simulate
    from covey.studies import Study, load_study, study
    from deploy.installation import VERSION as __version__
    from deploy.scenario import Scenario
    from protocol.arithmetic import elementwise
    from protocol.sensing import Pose, SensorModel, WedgeSensor
    from protocol.settings import BadSetting

__all__ = [
    "STAND",
    "BadSetting",
    "ControlInput",
    "ControlLaw",
    "Pose",
    "Run",
    "Scenario",
    "SensorModel",
    "Situation",
    "Study",
    "WedgeSensor",
    "__version__",
    "approach",
    "elementwise",
    "load",
    "load_study",
    "scenario",
    "simulate",
    "study",
]
_SENSING = ("Pose", "SensorModel", "WedgeSensor")
_CONTROL = ("STAND", "ControlInput", "ControlLaw", "Situation", "approach")
_STUDIES = ("Study", "load_study", "study")


def __getattr__(name: str) -> Any:
    """A public name, on its first use: agent and world processes that import a user's class from here load little."""
    found: Any
    if name not in __all__:
        raise AttributeError(f"module 'covey' has no attribute {name!r}")
    if name == "__version__":
        from deploy.installation import VERSION

        found = VERSION
    elif name in _SENSING:
        from protocol import sensing

        found = getattr(sensing, name)
    elif name in _CONTROL:
        from agents.coverage import control

        found = getattr(control, name)
    elif name == "elementwise":
        from protocol import arithmetic

        found = arithmetic.elementwise
    elif name == "BadSetting":
        from protocol import settings

        found = settings.BadSetting
    elif name in _STUDIES:
        from covey import studies

        found = getattr(studies, name)
    else:
        from covey import runs

        found = getattr(runs, name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
