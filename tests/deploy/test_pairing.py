"""What makes trials comparable: methods differ in what they say they do, nothing outweighs it, and rows are of one program."""

from pathlib import Path

import msgspec
import pytest

from agents.config import ExtractionSettings
from agents.coverage.control import STAND, ControlInput, Situation
from deploy.scenario import resolve
from deploy.studies import trials
from deploy.studies.design import Design, plan
from deploy.studies.trials import ABLATIONS, METHODS, Trial, methods_of, run_trial
from protocol.settings import BadSetting


def trial(method: str, **options: object) -> Trial:
    return Trial(scenario="efficacy", seed=100, team="2", targets=30, method=method, options=dict(options))


@pytest.mark.parametrize("kind", ["power", "voronoi", "voronoi-cod"])
def test_a_partition_is_compared_under_its_own_name(kind: str) -> None:
    scenario = trial(kind).resolve()
    assert (scenario.partition.kind, scenario.control.mode) == (kind, "lloyd")


@pytest.mark.parametrize("mode", ["pursuit", "search-and-track", "oracle", "uniform-density", "random", "static"])
def test_a_control_law_is_compared_on_power_cells(mode: str) -> None:
    scenario, paper = trial(mode).resolve(), trial("power").resolve()
    assert (scenario.partition.kind, scenario.control.mode) == ("power", mode)
    if mode != "search-and-track":  # which brings its extraction
        assert msgspec.structs.replace(scenario, control=paper.control) == paper


class Stay:
    """A control law of the user's own."""

    def command(self, situation: Situation) -> ControlInput:
        return STAND


def test_a_law_of_the_users_own_is_a_method_and_its_rows_bear_its_name() -> None:
    law = f"{__name__}:Stay"
    found = plan(Design(scenario="quick", teams=("2A",), targets=(3,), methods=(law, "power"), trials=1, options={"run.seconds": 1.0}))
    scenarios = [one.resolve() for one in found]
    assert [(one.partition.kind, one.control.mode) for one in scenarios] == [("power", law), ("power", "lloyd")]
    assert msgspec.structs.replace(scenarios[0], control=scenarios[1].control) == scenarios[1]
    assert methods_of([run_trial(one) for one in found]) == [law, "power"] and f"--control {law}" in found[0].command()


@pytest.mark.parametrize(
    ("law", "says"),
    [
        (f"{__name__}:Sty", f"module {__name__} has no Sty; did you mean Stay[?]"),
        (f"{__name__}:trial", "trial: missing a required argument: 'method'; .*: should be a class"),
        ("__main__:Stay", "trials run in processes of their own, which lack this class; should be at the top of a file"),
    ],
)
def test_a_law_that_cannot_be_imported_is_refused_before_a_trial(law: str, says: str) -> None:
    with pytest.raises(BadSetting, match=f"^--methods {law}: .*{says}"):
        plan(Design(scenario="quick", teams=("2A",), targets=(3,), methods=("power", law)))


def test_options_of_a_study_do_not_outweigh_the_method_the_seed_or_the_team() -> None:
    options = {"partition.kind": "voronoi", "run.seed": 7, "team.composition": "5", "targets.count": 3, "run.dt": 0.5}
    scenario = trial("power", **options).resolve()
    assert (scenario.partition.kind, scenario.run.seed, len(scenario.members), scenario.targets.count) == ("power", 100, 24, 30)
    assert scenario.run.dt == 0.5


def test_rows_of_another_program_have_another_key(monkeypatch: pytest.MonkeyPatch) -> None:
    before = trial("power").key()
    assert trial("power").key() == before
    monkeypatch.setattr(trials, "fingerprint", lambda: "another program")
    assert trial("power").key() != before


def test_rows_of_a_scenario_file_that_has_changed_have_another_key(tmp_path: Path) -> None:
    file, keys = tmp_path / "mine.toml", []
    for noise in (0.2, 0.5):
        file.write_text(f"[targets]\nheading_noise = {noise}\n")
        keys.append(Trial(scenario=str(file), seed=100, team="2", targets=30, method="power").key())
    assert keys[0] != keys[1]


def test_every_method_is_compared_here() -> None:
    assert set(METHODS) - set(ABLATIONS) == {
        "power",
        "power-extraction",
        "voronoi",
        "voronoi-cod",
        "pursuit",
        "search-and-track",
        "oracle",
        "uniform-density",
        "random",
        "static",
    }


@pytest.mark.parametrize("method", ABLATIONS)
def test_an_ablation_is_search_and_track_but_for_its_ingredient(method: str) -> None:
    whole, without = METHODS["search-and-track"], METHODS[method]
    changed = {name for name in without if without[name] != whole.get(name)}
    assert changed == set(ABLATIONS[method])
    assert trial(method).resolve().control.mode == "search-and-track"


def test_search_and_track_brings_its_extraction_unless_the_scenario_says_another() -> None:
    names = ("bin", "threshold", "beside")
    found = {mode: resolve("efficacy", {"control.mode": mode}).extraction for mode in ("search-and-track", "lloyd")}
    assert [getattr(found["search-and-track"], name) for name in names] == [0.7, 0.3, 0.7]
    assert found["lloyd"] == resolve("efficacy").extraction == ExtractionSettings()
    told = resolve("efficacy", {"control.mode": "search-and-track", "extraction.bin": 1.2}).extraction
    assert [getattr(told, name) for name in names] == [1.2, 0.3, 0.7]
    assert trial("power-extraction").resolve().extraction == found["search-and-track"]
    assert trial("paper-extraction").resolve().extraction == found["lloyd"]
