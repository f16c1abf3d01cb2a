"""Runs of the swarm, recorded, for the tests to show to the oracle; the oracle itself never sees this file."""

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import msgspec

from deploy.recording.observers import Observers, open_recorder
from deploy.recording.recording import Recording
from deploy.scenario import resolve
from deploy.scoring.scores import Score
from deploy.simulation import Simulation
from tests.oracle.said import Tick, ticks_of


class Recorded(NamedTuple):
    """A run as its recording tells it."""

    settings: dict[str, Any]
    ticks: list[Tick]
    scores: list[Score]  # what the run itself said of its error


@lru_cache(maxsize=64)
def recorded(*options: tuple[str, Any]) -> Recorded:
    """The run of the scenario "efficacy" with dotted settings, recorded into a file and read back."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        simulation = Simulation(resolve("efficacy", dict(options)))
        Observers(simulation.scorer, open_recorder(path, simulation.scenario, virtual=True))
        simulation.run()
        recording = Recording(path)
        ticks = ticks_of([(entry.key, entry.payload) for entry in recording.entries()])
    return Recorded(msgspec.to_builtins(recording.scenario), ticks, simulation.scorer.scores)
