"""Traces: the series are those of the scorer, and the result can be worked out from them."""

import csv
import json
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet
import pytest

from deploy.recording.trace import Trace, check_trace
from deploy.scenario import FaultSettings, resolve
from deploy.scoring.result import Result
from deploy.simulation import Simulation
from protocol.settings import BadSetting


@pytest.fixture(scope="module")
def played() -> tuple[Trace, Result]:
    """Six agents for 10 s, one of them killed half-way."""
    scenario = resolve("quick", {"run.dt": 0.5, "run.seconds": 10.0})
    simulation = Simulation(msgspec.structs.replace(scenario, faults=(FaultSettings(at=5.0, verb="kill", who="s3"),)))
    trace = Trace(simulation)
    simulation.on_truth = trace.tell
    return trace, simulation.run()


def test_the_result_follows_from_the_series(played: tuple[Trace, Result], tmp_path: Path) -> None:
    trace, result = played
    trace.write(tmp_path / "run.npz", result)
    with np.load(tmp_path / "run.npz") as data:
        assert data["tick"].tolist() == list(range(20))
        assert data["ospa"].mean() == pytest.approx(result.mean_ospa) and data["gospa"][4:].mean() == pytest.approx(result.steady_gospa)
        assert data["localisation"] + data["missed"] + data["false"] == pytest.approx(data["gospa"])
        assert data["hole"].max() == result.hole_area and data["coverage"][4:].mean() == pytest.approx(result.steady_coverage)
        assert (np.diff(data["messages"]) > 0).all() and data["messages"][-1] <= result.messages
        assert data["agents"].tolist() == [6] * 10 + [5] * 10
        assert data["rounds"].tolist() == [6 * tick for tick in range(10)] + [60 + 5 * tick for tick in range(10)]
        assert data["rounds"][-1] + 5 == result.rounds
        assert json.loads(str(data["result"]))["transcript"] == result.transcript
        assert json.loads(str(data["scenario"]))["run"]["seed"] == result.seed


def test_all_kinds_of_files_hold_the_same(played: tuple[Trace, Result], tmp_path: Path) -> None:
    trace, result = played
    for kind in ("npz", "parquet", "csv"):
        trace.write(tmp_path / f"run.{kind}", result)
    table = pyarrow.parquet.read_table(tmp_path / "run.parquet")
    with (tmp_path / "run.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    with np.load(tmp_path / "run.npz") as data:
        for name in table.column_names:
            assert data[name].tolist() == table[name].to_pylist() == [float(row[name]) for row in rows]
    assert json.loads(table.schema.metadata[b"result"])["transcript"] == result.transcript


def test_a_trace_that_cannot_be_written_is_refused_before_the_run(tmp_path: Path) -> None:
    check_trace(tmp_path / "run.npz")
    with pytest.raises(BadSetting, match=r"run\.txt: should end in \.npz, \.parquet, \.csv"):
        check_trace(tmp_path / "run.txt")
    with pytest.raises(BadSetting, match=r"the folder .*nowhere does not exist"):
        check_trace(tmp_path / "nowhere" / "run.npz")
