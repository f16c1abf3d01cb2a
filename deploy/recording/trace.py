"""Traces: the time series behind the numbers of a result, one row for each tick, as .npz, .parquet or .csv.

The columns are those of `Score` and what had been sent and played when the tick opened; rounds of the dead still count.
The result and the settings travel along in .npz (the texts `result` and `scenario`) and .parquet (metadata).
"""

import csv
import json
from dataclasses import asdict
from pathlib import Path

import msgspec
import numpy as np

from deploy.installation import need_study_packages
from deploy.scoring.result import Result
from deploy.simulation import Simulation
from protocol.observer_messages import Truth
from protocol.settings import BadSetting
from protocol.whole_file import whole_file

KINDS = (".npz", ".parquet", ".csv")


def check_trace(path: Path) -> None:
    """Raise BadSetting unless a trace can be written there."""
    if path.suffix not in KINDS:
        raise BadSetting(f"--trace {path}: should end in {', '.join(KINDS)}")
    if path.suffix == ".parquet":
        need_study_packages(f"--trace {path}")
    if not path.absolute().parent.is_dir():
        raise BadSetting(f"--trace {path}: the folder {path.parent} does not exist")


class Trace:
    """Listens to a simulation and writes what it heard."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._sent: dict[int, dict[str, int]] = {}  # by tick

    def tell(self, truth: Truth) -> None:
        """A tick has opened."""
        bus, agents, rounds = self._simulation.bus, self._simulation.agents, self._simulation.scorer.tick_rate.rounds
        self._sent[truth.tick] = {"messages": bus.messages, "bytes": bus.bytes, "rounds": rounds, "agents": len(agents)}

    def columns(self) -> dict[str, list[float]]:
        """Every series by name."""
        nothing = {"messages": 0, "bytes": 0, "rounds": 0, "agents": 0}
        rows = [{**asdict(score), **self._sent.get(score.tick, nothing)} for score in self._simulation.scorer.scores]
        return {name: [row[name] for row in rows] for name in (rows[0] if rows else {})}

    def write(self, path: Path, result: Result) -> None:
        """Write everything; raises BadSetting naming the file when it cannot be written."""
        try:
            with whole_file(path) as new:
                self._write(new, result)
        except OSError as error:
            raise BadSetting(f"--trace {path}: {error.strerror or error}") from None

    def _write(self, path: Path, result: Result) -> None:
        texts = {"result": result.to_json(), "scenario": json.dumps(msgspec.to_builtins(self._simulation.scenario))}
        columns = self.columns()
        if path.suffix == ".npz":
            series = {name: np.array(values) for name, values in columns.items()}
            np.savez_compressed(path, allow_pickle=False, **series, **{name: np.array(text) for name, text in texts.items()})
        elif path.suffix == ".parquet":
            import pyarrow
            import pyarrow.parquet

            pyarrow.parquet.write_table(pyarrow.table(columns).replace_schema_metadata(texts), path)
        else:
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(columns)
                writer.writerows(zip(*columns.values()))
