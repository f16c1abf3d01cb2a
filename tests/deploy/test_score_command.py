"""`covey score` prints what the recording says, not what the run wrote beside it."""

import json
from pathlib import Path

import msgspec
import pytest

from deploy.cli.recordings import score
from deploy.recording.observers import Observers, open_recorder
from deploy.recording.recording import Recording
from deploy.recording.rescore import rescore
from deploy.scenario import FaultSettings, resolve
from deploy.simulation import Simulation


def test_the_score_of_a_recording_is_worked_out_anew_and_not_read_from_the_result_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulation = Simulation(resolve("quick", {"run.seconds": 4.0}))
    Observers(simulation.scorer, open_recorder(tmp_path / "a.mcap", simulation.scenario, virtual=True))
    true = simulation.run()
    forged = msgspec.structs.replace(true, steady_ospa=true.steady_ospa + 1.25, mean_gospa=true.mean_gospa - 3.0)
    (tmp_path / "result.json").write_text(forged.to_json(), encoding="utf-8")
    assert score(str(tmp_path / "a.mcap"), None, True) == 0
    out, err = capsys.readouterr()
    printed = json.loads(out.splitlines()[-1])
    assert (printed["steady_ospa"], printed["mean_gospa"]) == (true.steady_ospa, true.mean_gospa)
    assert "largest difference to the figures of the run itself: 3" in err
    assert printed["wall_s"] is None  # a simulation publishes at the world's time


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_in_a_simulation_a_hole_is_closed_in_the_worlds_time_whoever_is_waited_for_meanwhile(tmp_path: Path, rate: float) -> None:
    faults = (FaultSettings(at=1.0, verb="kill", who="s1"), FaultSettings(at=1.0, verb="pause", who="s2"))
    scenario = msgspec.structs.replace(resolve("quick", {"run.seconds": 3.0, "run.rate": rate}), faults=faults)
    simulation = Simulation(scenario)
    Observers(simulation.scorer, open_recorder(tmp_path / "a.mcap", simulation.scenario, virtual=True))
    (kill,) = simulation.run().kills
    assert (kill.closed_seconds, kill.closed_ticks) == (0.25, 1)
    assert simulation.bus.now > 3.0 / rate + 1.0, "the tick that closes the hole waits for the paused agent"
    assert rescore(Recording(tmp_path / "a.mcap")).result(None).kills == (kill,)


def test_a_recording_without_an_end_is_said_to_have_none_whether_its_recorder_died_or_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulation = Simulation(resolve("quick", {"run.seconds": 2.0}))
    recorder = open_recorder(tmp_path / "a.mcap", simulation.scenario)
    simulation.scorer.on_event = recorder.see
    simulation.run()
    recorder.flush()
    assert score(str(tmp_path / "a.mcap"), None, False) == 0
    assert (Recording(tmp_path / "a.mcap").wall_seconds or 0.0) > 0.0  # this one was told the clock
    recorder.close()
    assert "it has no end: its recorder was killed or still writes; what it had written counts" in " ".join(capsys.readouterr().err.split())
