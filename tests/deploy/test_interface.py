"""`import covey`: what it gives is what the command gives, and what is wrong is said in one line."""

import copy
import inspect
import json
import math
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest

import covey
from covey import plugged
from covey.arguments import checked
from deploy.cli.commands.run import simulate as simulate_command
from deploy.cli.options import RunOptions
from deploy.faults.faults import check_faults
from deploy.scenario import resolve
from deploy.simulation import Simulation

ROOT = Path(__file__).resolve().parents[2]


class Stay:
    """A control law that others can import."""

    def command(self, situation: covey.Situation) -> covey.ControlInput:
        return covey.STAND


class Ring:
    """A sensor that sees all around, with a radius of its own."""

    def __init__(self, radius: float = 5.0) -> None:
        self.reach, self.area = radius, np.pi * radius**2

    def probability(self, points: np.ndarray, pose: covey.Pose) -> np.ndarray:
        return np.where(np.hypot(points[:, 0] - pose[0], points[:, 1] - pose[1]) <= self.reach, 0.9, 0.0)

    def footprint(self, pose: covey.Pose) -> np.ndarray:
        turns = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
        return np.column_stack([pose[0] + self.reach * np.cos(turns), pose[1] + self.reach * np.sin(turns)])


PROCESSES_ONLY = {
    "run",
    "bodies",
    "lockstep",
    "spawn",
    "strict",
    "insecure",
    "keys",
    "json",
}  # options of runs with processes, and of the printed result


def test_the_options_of_the_interface_are_those_of_the_command_line() -> None:
    scenario, simulate_ = (inspect.signature(function).parameters for function in (covey.scenario, covey.simulate))
    assert {**simulate_} == {**scenario, "progress": simulate_["progress"]}
    assert scenario.keys() - {"name", "sensors"} == {option.name for option in fields(RunOptions)} - PROCESSES_ONLY
    hints = get_type_hints(RunOptions)
    assert hints["partition"] == scenario["partition"].annotation and hints["capacity"] == scenario["capacity"].annotation


@pytest.fixture(scope="module")
def run() -> Iterator[covey.Run]:
    """Ten seconds of the scenario quick."""
    yield covey.simulate("quick", seconds=10, seed=3)


def test_a_run_is_that_of_the_simulation_and_its_arrays_are_the_series_behind_the_result(run: covey.Run) -> None:
    result = Simulation(resolve("quick", {"run.seconds": 10.0, "run.seed": 3, "run.clock": "lockstep"})).run()
    assert run.result.transcript == result.transcript
    assert len(run) == len(run.ospa) == result.ticks == 40
    assert run.ospa.mean() == pytest.approx(result.mean_ospa, rel=1e-12)
    assert run.gospa[-1] == result.final_gospa
    assert np.allclose(np.diff(run.time), 0.25)
    assert run.poses.shape == (40, len(run.agents), 3)
    assert [len(targets) for targets in run.true_targets] == run.targets.tolist()
    columns = run.columns()
    assert np.allclose(columns["localisation"] + columns["missed"] + columns["false"], run.gospa)
    assert repr(run) == (
        f"<Run of quick, seed 3: 6 agents, 40 ticks of 0.25 s; OSPA {result.mean_ospa:.2f} m mean, "
        f"{result.steady_ospa:.2f} m steady, {result.final_ospa:.2f} m at the end>"
    )


def test_a_run_without_true_targets_shows_no_error() -> None:
    assert repr(covey.simulate("quick", seconds=1, targets=0)) == "<Run of quick, seed 1: 6 agents, 4 ticks of 0.25 s; OSPA ->"


def test_bodies_stand_where_the_arrays_say(run: covey.Run) -> None:
    from deploy.simulation import Simulation

    simulation = Simulation(run.scenario)
    seen = {}
    simulation.on_truth = lambda truth: seen.update({truth.tick: dict(zip(truth.bodies, truth.poses.tolist()))})
    simulation.run()
    for row, tick in enumerate(run.tick.tolist()):
        assert [seen[tick][name] for name in run.agents] == run.poses[row].tolist()


def test_a_run_is_equal_to_itself_alone_and_can_be_a_key(run: covey.Run) -> None:
    """Its arrays have no one truth value."""
    again = copy.deepcopy(run)
    assert run == run and run != again and len({run, again}) == 2


def test_an_agent_that_is_killed_keeps_its_column_and_the_kill_is_in_the_result() -> None:
    run = covey.simulate("quick", seconds=4, kill="s2@2")
    assert [kill.name for kill in run.result.kills] == ["s2"]
    assert run.poses.shape[1] == 6


def test_a_scenario_can_be_laid_over_again_and_its_team_changed() -> None:
    first = covey.scenario("quick", seed=5, settings={"detection.clutter": 0.5, "network.seeds": ["tcp/127.0.0.1:7"]})
    assert (first.run.seed, first.detection.clutter, first.network.seeds) == (5, 0.5, ("tcp/127.0.0.1:7",))
    again = covey.scenario(first, seconds=3, kill=["1@1"])
    assert again.detection.clutter == 0.5 and again.members == first.members and again.run.scenario == "quick"
    check_faults(again.faults, list(again.members))
    other = covey.scenario(first, team="2A+1B")
    assert list(other.members.values()) == ["A", "A", "B"]
    assert covey.scenario(first) == first


def test_a_triple_is_refused_where_no_team_has_one() -> None:
    by_name = covey.scenario("quick", settings={"team.composition": "", "members.s1": "A"})
    for base, team in ((by_name, "agents by name"), ("quick", r"team A2,B4"), (covey.scenario("quick"), r"team A2,B4")):
        with pytest.raises(covey.BadSetting, match=rf"^triple = 'ABC': should be left out with {team}: teams 2, 3, 4, 5 alone have it$"):
            covey.scenario(base, triple="ABC")


def test_what_is_laid_over_a_scenario_gives_what_it_gives_over_its_name() -> None:
    for first in ("lloyd", "search-and-track"):
        base = covey.scenario("efficacy", control=first, rate=2.0)
        for law in ("lloyd", "search-and-track"):
            assert covey.scenario(base, control=law) == covey.scenario("efficacy", control=law, rate=2.0)
        assert covey.scenario(base, triple="ABC") == covey.scenario("efficacy", triple="ABC", control=first, rate=2.0)


def test_a_clock_in_settings_is_that_of_a_simulation_in_python_and_on_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Messages come 0.4 s late: in lockstep the world waits for them."""
    found = []
    for clock in ("lockstep", "realtime"):
        run = covey.simulate("quick", seconds=3, delay=0.4, settings={"run.clock": clock})
        found.append(run.result.transcript)
        assert simulate_command("quick", options=RunOptions(seconds=3.0, delay=0.4, settings=[f"run.clock={clock}"], json=True)) == 0
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["transcript"] == found[-1]
        assert covey.simulate(run.scenario).result.transcript == found[-1]
    assert found[0] != found[1]


def test_a_delay_that_changes_nothing_is_named_as_on_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    for rate in (None, 1.0):
        covey.simulate("quick", seconds=1, delay=0.4, rate=rate)
        assert ("so these may change nothing: delay\n" in capsys.readouterr().err) == (rate is None)


def test_own_classes_and_objects_do_what_their_names_do() -> None:
    class Local(Stay):
        """A law that no import finds."""

    runs = [covey.simulate("quick", seconds=2, control=law) for law in ("static", Stay, Stay(), Local)]
    assert len({run.result.transcript for run in runs}) == 1
    assert runs[1].scenario.control.mode == f"{__name__}:Stay"
    wide = covey.simulate("quick", seconds=2, sensors={"ring": Ring(8.0)}, team="3ring")
    settings = {"sensors.ring.model": plugged.name_of(Ring), "sensors.ring.parameters": {"radius": 8.0}}
    named = covey.simulate("quick", seconds=2, team="3ring", settings=settings)
    assert wide.result.transcript == named.result.transcript
    assert covey.simulate("quick", seconds=2, sensors={"ring": Ring}, team="3ring").result.transcript != wide.result.transcript


class Remembering(Stay):
    """A law that answers by how often it was asked."""

    def __init__(self, asked: int = 0, kept: object = None) -> None:
        self.asked, self.kept = asked, kept

    def command(self, situation: object) -> tuple[tuple[float, float], float]:
        self.asked += 1
        return (0.1 * self.asked, 0.0), 0.0


def test_each_agent_gets_a_copy_of_a_law_that_is_given_as_an_object_as_it_was_given() -> None:
    law = Remembering()
    scenario = covey.scenario("quick", seconds=2, control=law)
    law.asked = 5
    runs = [covey.simulate(scenario), covey.simulate(scenario), covey.simulate("quick", seconds=2, control=Remembering)]
    assert law.asked == 5 and len({run.result.transcript for run in runs}) == 1
    assert covey.simulate("quick", seconds=2, control=law).result.transcript != runs[0].result.transcript


def test_a_law_that_cannot_be_copied_is_refused() -> None:
    with pytest.raises(covey.BadSetting, match=r"^control = <.*Remembering.*: each agent gets a copy, .* \(TypeError: .*lock"):
        covey.scenario("quick", control=Remembering(kept=threading.Lock()))


class Chance(Stay):
    """A law of which no run can be repeated."""

    def command(self, situation: object) -> tuple[tuple[float, float], float]:
        return (float(np.random.random()), 0.0), 0.0


def test_an_object_that_answers_by_chance_is_refused_as_its_class_is() -> None:
    for law in (Chance(), Chance):
        with pytest.raises(covey.BadSetting, match="gives two answers to the same question, of tick 0"):
            covey.scenario("quick", control=law)


def test_what_was_passed_in_another_process_is_told_apart_from_what_never_was() -> None:
    with pytest.raises(covey.BadSetting, match=r"module covey\.plugged has no Ring_999"):
        covey.simulate("quick", control="covey.plugged:Ring_999")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"name": "nowhere"}, "scenario 'nowhere' does not exist"),
        ({"seconds": -1.0}, r"run\.seconds = -1\.0"),
        ({"settings": {"run.sede": 1}}, r"run\.sede: there is no such field; did you mean seed\?"),
        ({"kill": "half"}, "^kill = 'half': should read who@when"),
        ({"loss": 2}, r"^loss = 2: should be a share"),
        ({"seed": "1"}, "^seed = '1': should be a whole number$"),
        ({"seed": True}, "^seed = True: should be a whole number$"),
        ({"name": 3}, "^name = 3: should be a text or a path or a Scenario$"),
        ({"partition": "hexagon"}, "^partition = 'hexagon': should be one of power, voronoi, voronoi-cod$"),
        ({"sensors": [Ring]}, r"^sensors = \[<class .*: should be a dict with texts as keys$"),
        ({"settings": ["detection.clutter=0.5"]}, r"^settings = \['detection.clutter=0.5'\]: should be a dict with texts as keys$"),
        ({"settings": {"detection": {"clutter": 0.5}}}, r"^detection: should be the name of a setting with its section"),
        ({"settings": {"detection.clutter": object()}}, r"detection\.clutter = <object"),
        ({"team": "3nothing"}, "sensor class 'nothing' does not exist"),
        ({"control": object()}, r"the class has no method command"),
        ({"sensors": {"x": object()}, "team": "1x"}, "lacks reach, area, probability, footprint"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(options: dict[str, object], says: str) -> None:
    with pytest.raises(covey.BadSetting, match=says) as caught:
        covey.scenario(**options) if "control" not in options else covey.simulate(**options)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_an_argument_that_no_function_has_is_told_as_python_tells_it() -> None:
    with pytest.raises(TypeError, match=r"^simulate\(\) got an unexpected keyword argument 'sed'$"):
        covey.simulate("quick", sed=3)  # type: ignore[call-arg]


@pytest.mark.parametrize("options", [{"loss": 2.0}, {"delay": -1.0}, {"kill": "half"}], ids=lambda options: next(iter(options)))
def test_a_wrong_argument_is_told_alike_over_a_name_and_over_a_scenario(options: dict[str, Any]) -> None:
    lines = []
    for over in ("quick", covey.scenario("quick")):
        with pytest.raises(covey.BadSetting) as caught:
            covey.scenario(over, **options)
        lines.append(str(caught.value))
    assert lines[0] == lines[1] and lines[0].startswith(f"{next(iter(options))} = ")


def test_a_wrong_option_over_a_scenario_names_no_file_that_the_user_never_saw() -> None:
    with pytest.raises(covey.BadSetting, match=r"^scenario quick with options: run\.dt"):
        covey.scenario(covey.scenario("quick"), dt=99.0)


@pytest.mark.slow
def test_a_recording_gives_back_the_run_that_it_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("simulate", "quick", "--seconds", "5", "--record", "--run", "kept", "--json")
    program = "import sys; from deploy.__main__ import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, *words], env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True
    )
    loaded = covey.load("kept")
    assert loaded.result.transcript == json.loads(done.stdout.splitlines()[-1])["transcript"]
    again = covey.simulate(covey.scenario("quick", seconds=5))
    assert np.array_equal(loaded.ospa, again.ospa) and np.array_equal(loaded.poses, again.poses)
    with pytest.raises(covey.BadSetting, match="no such file, and no run of this name"):
        covey.load("lost")


@pytest.mark.slow
def test_a_study_gives_its_rows_and_goes_on_where_it_was(tmp_path: Path) -> None:
    options = {"trials": 1, "methods": [Stay, "static", "power"], "seconds": 2.0, "workers": 1, "into": tmp_path / "study"}
    with ThreadPoolExecutor(1) as threads:  # as in a program with a window
        study, law = threads.submit(covey.study, "convergence", **options).result(), f"{__name__}:Stay"
    assert len(study) == 3
    assert repr(study) == f"<Study in {tmp_path / 'study'}: 3 trials of {law}, static, power>"
    assert [one.method for one in study.summary()] == [law, "static", "power"]
    assert study.columns()["steady_ospa"].shape == (3,) and len(set(study.columns()["transcript"])) == 2
    (pair,) = study.paired(Stay, "power")
    assert (pair.method, pair.other, pair.seeds) == (law, "power", (100,))
    assert pair.differences == (study.rows[2]["steady_ospa"] - study.rows[0]["steady_ospa"],)
    with pytest.raises(covey.BadSetting, match=f"^other = 'voronoi': should be one of {law}, static, power$"):
        study.paired("power", "voronoi")
    began = (tmp_path / "study" / "trials.jsonl").stat().st_mtime_ns
    assert covey.study("convergence", **options).rows == study.rows
    assert (tmp_path / "study" / "trials.jsonl").stat().st_mtime_ns == began
    assert covey.load_study(tmp_path / "study").columns()["seed"].tolist() == [100, 100, 100]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"workers": 0}, "^workers = 0: should be 1 or more$"),
        ({"workers": "two"}, "^workers = 'two': should be a whole number$"),
        ({"trials": 0}, "^trials = 0: should be at least 1$"),
        ({"methods": "p"}, "^methods = 'p': should be one or more of power"),
        ({"methods": ["power", 3]}, r"^methods = \['power', 3\]: should be a text or a class or a list of texts or classes$"),
        ({"methods": [Stay()]}, r"^methods = .*Stay.*: should be a text or a class or a list of texts or classes$"),
        ({"methods": type("Law", (Stay,), {"__module__": "__main__"})}, "^methods = '__main__:Law': trials run in processes of their own"),
        ({"methods": "power,my_laws:Corners"}, "^methods = 'my_laws:Corners': No module named 'my_laws': it should lie in"),
        ({"methods": ["power", Chance], "seconds": 1.0, "trials": 1, "workers": 1}, "Chance.command gives two answers"),
        ({"targets": 3.5}, "^targets = 3.5: should be a whole number or a list of whole numbers$"),
        ({"name": "robustness"}, "^name = 'robustness': should be one of convergence, efficacy, heterogeneity, ablation$"),
        ({"teams": "A2", "methods": "power", "targets": 3, "settings": {"run.sede": 1}}, "run.sede: there is no such field"),
    ],
)
def test_what_is_wrong_of_a_study_is_said_in_one_line_before_its_folder_is_made(options: dict[str, Any], says: str, tmp_path: Path) -> None:
    with pytest.raises(covey.BadSetting, match=says):
        covey.study(**{"name": "convergence", "into": tmp_path / "study", **options})
    assert not (tmp_path / "study").exists()


def test_numbers_of_numpy_are_taken_wherever_numbers_are() -> None:
    plain = covey.scenario("quick", seed=1, seconds=3.0, targets=2, settings={"arena.width": 20.0, "network.seeds": ["tcp/127.0.0.1:7"]})
    numpy = {"arena.width": np.float32(20.0), "network.seeds": np.array(["tcp/127.0.0.1:7"])}
    assert covey.scenario("quick", seed=np.arange(2)[1], seconds=np.float32(3), targets=np.int64(2), settings=numpy) == plain  # type: ignore[arg-type]


def test_any_sequence_is_taken_and_an_object_stays_itself_whatever_else_it_is() -> None:
    class Table(dict[str, int]):
        """A law or sensor may be a dict as well."""

    @checked
    def taken(numbers: Sequence[int], thing: object, things: Mapping[str, object]) -> tuple[object, ...]:
        return numbers, thing, things["one"]

    table = Table()
    for numbers in (range(30, 60, 10), (1, 2), deque([3])):
        found = taken(numbers, table, {"one": table})
        assert found[0] == numbers and found[1] is found[2] is table
    for wrong in ("12", b"12", range, {1: 2}, [1.5]):
        with pytest.raises(covey.BadSetting, match=r"^numbers = .*: should be a list of whole numbers$"):
            taken(wrong, table, {"one": table})  # type: ignore[arg-type]


def test_elementwise_takes_what_numpy_makes_an_array_of() -> None:
    assert covey.elementwise(math.exp, [0.0, 1.0]).tolist() == [1.0, math.e]
    assert covey.elementwise(math.atan2, np.zeros((1, 2)), [[1.0, 2.0]]).tolist() == [[0.0, 0.0]]


def test_tables_need_their_packages_and_say_so(run: covey.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    for ask, package in ((run.to_pandas, "pandas"), (run.to_arrow, "pyarrow")):
        with pytest.raises(ImportError, match=f"pip install {package}"):
            ask()


def test_a_table_has_the_columns(run: covey.Run) -> None:
    table = run.to_arrow()
    assert table.column_names == list(run.columns())
    assert table["ospa"].to_pylist() == run.ospa.tolist()


def test_import_covey_loads_nothing_heavy_and_every_public_name_is_there() -> None:
    program = "import sys, covey; print(*sys.modules); [getattr(covey, name) for name in covey.__all__]; assert len(dir(covey)) > 9"
    path = os.pathsep.join([str(ROOT), str(ROOT / "deploy" / "interface")])
    done = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=True
    )
    assert not {"numpy", "numba", "agents", "deploy", "rich"} & set(done.stdout.split())
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        covey.nothing  # noqa: B018
