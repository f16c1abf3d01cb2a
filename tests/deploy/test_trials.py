"""Trials: pairing, rows that repeat themselves, and keys that tell trials apart."""

import re
import shlex
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest

from agents.coverage.laws import control_law
from deploy.scenario import parse_set, resolve
from deploy.scoring.result import Result
from deploy.simulation import Simulation
from deploy.studies.bodies import BodyRun
from deploy.studies.own_code import own_code, own_files
from deploy.studies.robustness import Bout
from deploy.studies.trials import FLAGS, LEFT_OUT, METHODS, Trial, check_method, cost, fingerprint, flat_settings, run_trial
from protocol.observer_messages import Truth
from protocol.settings import BadSetting

SHORT = {"run.seconds": 5.0, "run.dt": 0.5}

SENSOR = """
import numpy as np
class Own:
    speed, reach, area = {}, 4.0, 16.0
    def probability(self, points, pose):
        return 0.9 * (np.abs(points - pose[:2]).max(axis=1) < 2.0)
    def footprint(self, pose):
        return np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]]) + pose[:2]
"""


def trial(method: str = "power", seed: int = 3, **options: object) -> Trial:
    """Six agents for 5 s."""
    return Trial(scenario="quick", seed=seed, team="A2,B4", targets=3, method=method, options={**SHORT, **options})


def tracks(which: Trial) -> list[bytes]:
    """The truth of every tick, and where the bodies start."""
    simulation = Simulation(which.resolve())
    found: list[bytes] = []

    def hear(truth: Truth) -> None:
        found.append(truth.targets_bytes if found else truth.targets_bytes + truth.poses_bytes)

    simulation.on_truth = hear
    simulation.run()
    return found


def test_trials_of_one_seed_share_targets_and_starts_whatever_the_method() -> None:
    assert len(tracks(trial("power"))) == 10
    assert tracks(trial("power")) == tracks(trial("voronoi")) == tracks(trial("static"))
    assert tracks(trial("power")) != tracks(trial("power", seed=4))


def test_a_trial_is_repeated_by_the_command_in_its_row() -> None:
    """The words of the command, read as `covey simulate` reads them, resolve to the same scenario."""
    one = trial("voronoi-cod", **{"team.triple": "ABC", "detection.clutter": 0.25, "filter.border": "reflect"})
    row = run_trial(one)
    words = shlex.split(row["command"])
    assert words[:3] == ["covey", "simulate", "quick"] and words[-1] == "--json"
    dotted = {flag: name for name, flag in FLAGS.items()}
    overrides = {}
    for flag, value in zip(words[3:-1:2], words[4:-1:2]):
        name, parsed = parse_set(value) if flag == "--set" else (dotted[flag], one.overrides()[dotted[flag]])
        overrides[name] = parsed
        assert flag == "--set" or value == str(parsed)
    overrides = {"run.clock": "lockstep", **overrides}
    assert msgspec.to_builtins(resolve("quick", overrides)) == msgspec.to_builtins(one.resolve())
    assert Simulation(resolve("quick", overrides)).run().transcript == row["transcript"]


def test_the_command_of_a_trial_says_tables_and_texts_as_toml() -> None:
    tables = {
        "sensors.X.model": "covey.examples.sensors:RangeFalling",
        "sensors.X.parameters": {"angle": 90.0, "radius": 9.0, "scale": 6.0},
    }
    one = trial("power", **tables, **{"network.seeds": ["tcp/127.0.0.1:7", 'a "b"'], "timing.estimate_every": 2, "birth.background": False})
    words = shlex.split(one.command())
    said = dict(parse_set(value) for flag, value in pairwise(words) if flag == "--set")
    assert said == {name: value for name, value in one.options.items() if name not in FLAGS}


def test_a_row_holds_the_result_and_every_setting() -> None:
    row = run_trial(trial())
    assert (row["method"], row["seed"], row["team"], row["start_targets"], row["ticks"]) == ("power", 3, "A2,B4", 3, 10)
    assert (row["filter.lifetime"], row["detection.noise"], row["partition.kind"], row["run.seed"]) == (1000.0, 0.25, "power", 3)
    assert (row["code"], row["own_code"]) == (fingerprint(), "")
    assert all(isinstance(value, str | int | float | None) for value in row.values())


def test_the_page_names_every_column_of_a_study_once() -> None:
    """But for settings, which have a page of their own, and for what the tables leave out; fields of a result stand in their section."""
    page = (Path(__file__).resolve().parents[2] / "docs/reference/results.md").read_text(encoding="utf-8")
    section = page.partition("## The columns of a study\n")[2].partition("\n## ")[0]
    firsts = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    named = [name for cell in firsts for name in re.findall(r"`(\w+)`", cell)]
    columns = {*run_trial(trial(**{"run.seconds": 1.0}))} - {*flat_settings(trial().resolve()), "wall_s", "key"}
    assert len(named) == len(set(named)) and columns == {*named} | {*Result.__struct_fields__} - {*LEFT_OUT}
    assert {*LEFT_OUT} < {*re.findall(r"`(\w+)`", section)}


def test_progress_is_told_tick_by_tick() -> None:
    told: list[float] = []
    run_trial(trial(), told.append)
    assert told == pytest.approx([tick / 10.0 for tick in range(1, 11)])


def test_a_trial_is_played_in_lockstep_unless_its_settings_say_otherwise() -> None:
    assert run_trial(trial(**{"run.seconds": 1.0}))["run.clock"] == "lockstep"
    late = trial(**{"run.seconds": 1.0, "run.clock": "realtime"})
    assert run_trial(late)["run.clock"] == "realtime" and "--set 'run.clock=\"realtime\"'" in late.command()


def test_keys_differ_in_every_setting_and_in_nothing_else() -> None:
    others = [trial("voronoi"), trial(seed=4), trial(**{"run.dt": 0.25}), msgspec.structs.replace(trial(), team="A2,B3")]
    assert len({other.key() for other in [trial(), *others]}) == 5
    assert trial().key() == trial().key()


def keys_of_all_studies(options: dict[str, Any]) -> set[str]:
    """The keys of a trial, of a bout and of a run of the study of bodies with these settings."""
    bout = Bout(kind="none", level=0.0, seed=1, at=2.0, seconds=5.0, options=options)
    return {trial(**options).key(), bout.key(), BodyRun(model="points", seed=1, seconds=5.0, options=options).key()}


def test_a_class_of_the_users_own_that_has_changed_gives_the_runs_of_all_studies_other_keys(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The class stands in the named module, or comes from there."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "brought_by.py").write_text("from brought import Own\n")
    fields = ("targets.motion", "bodies.platform", "control.mode", "sensors.A.model")
    found: list[list[set[str]]] = []
    hashes = set()
    for speed in (0.0, 2.0):
        (tmp_path / "brought.py").write_text(SENSOR.format(speed))
        hashes.add(own_code(trial(**{"control.mode": "brought_by:Own"}).resolve()))
        found.append([keys_of_all_studies({field: f"{module}:Own"}) for field in fields for module in ("brought", "brought_by")])
    for before, after in zip(*found):
        assert len(before) == 3 and not before & after
    assert len(hashes) == 2


def test_all_files_of_the_users_that_a_class_imports_belong_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules and packages, relative imports, one inside of a function, a circle; no package that is installed, and none of Covey."""
    monkeypatch.syspath_prepend(tmp_path)
    imports = "import numpy\nimport covey\nimport helps_it\nfrom . import near\nfrom .deep.far import FAR\n"
    texts = {
        "laboratory/law.py": f"{imports}class Law:\n    def command(self, situation):\n        import comes_late\n",
        "laboratory/near.py": "import laboratory.law\n",
        "laboratory/deep/__init__.py": "",
        "laboratory/deep/far.py": "FAR = 1.0\n",
        "helps_it.py": "from helps_it_too import *\n",
        "helps_it_too.py": "",
        "comes_late.py": "",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    scenario = trial(**{"control.mode": "laboratory.law:Law"}).resolve()
    assert [file.relative_to(tmp_path).as_posix() for file in own_files(scenario)] == sorted(texts)
    hashes = {own_code(scenario)}
    for name in texts:
        (tmp_path / name).write_text(f"{texts[name]}# changed\n")
        hashes.add(own_code(scenario))
    assert len(hashes) == 1 + len(texts)


def test_a_file_that_a_sensor_is_given_belongs_to_its_code(tmp_path: Path) -> None:
    grid, keys, hashes = tmp_path / "antenna.csv", set(), set()
    for ahead in (0.5, 0.9):
        grid.write_text(f"0,{ahead},0\n0,0.9,0\n0,0,0\n")
        measured = {"model": "covey.examples.sensors:SampledGrid", "parameters": {"file": str(grid), "spacing": 4.0}}
        one = trial(**{"sensors.A": measured})
        keys.add(one.key())
        hashes.add(own_code(one.resolve()))
    assert len(keys) == len(hashes) == 2


@pytest.mark.parametrize("data", ["crowd", "crowd/one.txt"])
def test_recorded_data_that_have_changed_give_the_runs_of_all_studies_other_keys(data: str, tmp_path: Path) -> None:
    (tmp_path / "crowd").mkdir()
    found = []
    for place in (5.0, 6.0):
        (tmp_path / "crowd" / "one.txt").write_text(f"0 1 {place} 0 5 0 0 0\n")
        found.append(keys_of_all_studies({"recorded.kind": "pedestrians", "recorded.data": str(tmp_path / data)}))
    assert len(found[0]) == 3 and not found[0] & found[1]


def test_methods_are_partitions_and_control_laws_that_exist() -> None:
    for name, overrides in METHODS.items():
        scenario = resolve("quick", overrides)
        if name != "oracle":  # of simulations alone
            control_law(scenario)
    check_method("power")
    with pytest.raises(BadSetting, match="--methods voroni: should be one or more of power, power-extraction, voronoi"):
        check_method("voroni")


def test_cost_grows_with_ticks_and_faster_than_the_team() -> None:
    base = cost(resolve("quick", {"run.seconds": 10.0}))
    assert cost(resolve("quick", {"run.seconds": 20.0})) == pytest.approx(2.0 * base)
    assert cost(resolve("quick", {"run.seconds": 10.0, "team.composition": "A4,B8"})) > 2.0 * base
