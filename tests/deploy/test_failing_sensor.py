"""A sensor of the user's that fails within a run, and would fail again when the scorer asks it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.scoring.result import Result
from deploy.simulation import Simulation
from protocol.sensing import Pose
from tests.deploy.test_faulty_classes import Camera
from tests.deploy.wrong_inputs import folder, typed

__all__ = ["folder"]  # a fixture


class Failing(Camera):
    """Right while the scenario is checked, and wrong in the run."""

    fails = False

    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return {}["nope"] if Failing.fails else super().probability(points, pose)


def test_a_simulation_that_a_sensor_has_ended_leaves_a_result_though_the_scorer_asks_the_same_sensor(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    play = Simulation.run

    def failing(simulation: Simulation) -> Result:
        monkeypatch.setattr(Failing, "fails", True)
        return play(simulation)

    monkeypatch.setattr(Simulation, "run", failing)
    monkeypatch.setenv("COVEY_RUNS", str(folder / "runs"))
    words = ["simulate", "quick", "--seconds", "3", "--run", "one", "--team", "2X", "--set", f"sensors.X.model={__name__}:Failing"]
    assert typed(words, capsys)[0] == 2
    assert json.loads((folder / "runs" / "one" / "result.json").read_text())["exit_code"] == 2
