"""The study of bodies: which runs it plays, what it reads from them, and that it goes on where it was."""

import json
import math
import shlex
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.cli.bodies import QUICK, run_body_study
from deploy.scenario import parse_set
from deploy.studies.bodies import MODELS, BodyRun, Gaps, plan, play, summary
from deploy.studies.trials import Row
from protocol.observer_messages import Truth
from protocol.settings import BadSetting

SMALL = {"arena.width": 12.0, "arena.height": 12.0, "targets.count": 3}


def row(model: str, seed: int, ospa: float, least: float = 1.0, touches: int = 0) -> Row:
    found = {"method": model, "seed": seed, "seconds": 60.0, "wrecks": 2, "touches": touches}
    return {**found, "least_distance": least, "steady_ospa": ospa}


def test_all_models_of_a_seed_share_tracks_and_deaths() -> None:
    runs = plan(2, 5, 40.0, tuple(MODELS), {})
    assert [(run.seed, run.model) for run in runs] == [(seed, model) for seed in (5, 6) for model in MODELS]
    assert all(run.resolve().faults == runs[0].resolve().faults for run in runs[:3])
    assert runs[0].resolve().faults != runs[3].resolve().faults
    assert [fault.at for fault in runs[0].resolve().faults] == [10.0, 20.0]
    assert len({run.key() for run in runs}) == 6


def test_a_model_that_does_not_exist_is_refused() -> None:
    with pytest.raises(BadSetting, match="--methods cubes: should be one or more of points, radius, mujoco"):
        plan(1, 1, 40.0, ("cubes",), {})


def test_a_study_without_targets_is_refused() -> None:
    with pytest.raises(BadSetting, match=r"targets\.count = 0: there are no scores without targets"):
        plan(1, 1, 40.0, ("points",), {"targets.count": 0})


def test_the_least_distance_is_that_of_ways_not_of_ends_alone() -> None:
    gaps = Gaps()
    for tick, (one, other) in enumerate([((0.0, 0.0), (4.0, 0.3)), ((4.0, 0.0), (0.0, 0.3))]):
        poses = np.array([[*one, 0.0], [*other, 0.0]])
        gaps.take(Truth(sender="world", incarnation=1, tick=tick, time=0.0, bodies=("s1", "s2"), poses_bytes=poses.tobytes()))
    assert gaps.least == pytest.approx(0.3) and gaps.touches == 1


def test_the_summary_compares_with_points_of_the_same_seeds() -> None:
    rows = [row("points", 1, 2.0), row("points", 2, 4.0), row("mujoco", 1, 3.0, 0.6), row("mujoco", 2, 4.0, 0.5, 3), row("mujoco", 3, 9.0)]
    points, robots = summary(rows)
    assert (points["ratio"], robots["ratio"], robots["ratio_of_means"], robots["pairs"]) == (1.0, 1.25, 7.0 / 6.0, 2)
    assert (robots["runs"], robots["touches"], robots["runs_with_touches"], robots["least_distance"]) == (3, 3, 1, 0.5)
    [alone] = summary(rows[2:])
    assert alone["ratio"] is None and alone["pairs"] == 0
    _, beside = summary([row("points", 1, 0.0), row("points", 2, 4.0), row("mujoco", 1, 3.0), row("mujoco", 2, 4.0)])
    assert (beside["ratio"], beside["pairs"]) == (1.0, 1), "to points without an error there is no ratio"


@pytest.mark.parametrize(
    ("setting", "right"),
    [("run.seed", "given as seed"), ("limits.radius", "given as methods"), ("bodies.model", "given as methods"), ("run.clock", "left out")],
)
def test_a_setting_that_the_study_itself_sets_is_refused(setting: str, right: str) -> None:
    with pytest.raises(BadSetting, match=rf"^{setting} = 3: the study itself sets it; should be {right}$"):
        plan(1, 1, 40.0, ("points",), {setting: 3})


def test_the_command_of_a_run_says_its_settings_as_a_shell_and_covey_read_them() -> None:
    options = {"network.seeds": ["tcp/127.0.0.1:7", "a b"], "arena.width": 30.0}
    words = shlex.split(BodyRun(model="points", seed=1, seconds=20.0, options=options).command())
    assert dict(parse_set(value) for flag, value in pairwise(words) if flag == "--set") == options


def test_points_meet_and_bodies_with_a_radius_do_not() -> None:
    said: list[float] = []
    points, radius = (play(BodyRun(model=model, seed=1, seconds=20.0, options=SMALL), said.append) for model in ("points", "radius"))
    assert points["touches"] > 0 and radius["touches"] == 0 and radius["least_distance"] >= 0.5
    assert (points["wrecks"], radius["wrecks"]) == (2, 2) and said[79] == said[-1] == 1.0
    assert math.isfinite(radius["steady_ospa"])


@pytest.mark.slow
@pytest.mark.nightly
def test_a_study_that_was_stopped_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(QUICK, "seconds", 12.0)
    fields = {"trials": 2, "first_seed": 3, "methods": ("points", "mujoco"), "teams": ("A2+B1",)}
    assert run_body_study(True, fields, SMALL, tmp_path, 2, None, True) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (found["study"], found["runs"], [line["runs"] for line in found["lines"]]) == ("bodies", 4, [2, 2])
    first = (tmp_path / "results.csv").read_bytes()
    kept = (tmp_path / "trials.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "trials.jsonl").write_bytes(b"".join(kept[:2]) + kept[2][:50])  # as if killed in the middle of a line
    assert run_body_study(True, fields, SMALL, tmp_path, 1, None, False) == 0
    assert "2 of them done already" in capsys.readouterr().out
    assert (tmp_path / "results.csv").read_bytes() == first


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"targets": (2, 4)}, "--targets 2,4: should be one number"),
        ({"teams": ("1", "2")}, "--teams 1,2: should be one team"),
        ({"teams": ("A2",)}, "team A2: should be of 3 sensors or more, for 2 of them die"),
    ],
)
def test_what_the_study_has_but_once_is_refused_twice_and_a_team_that_dies_out_as_well(
    fields: dict[str, Any], complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(BadSetting, match=complaint):
        run_body_study(True, {"methods": ("points",), **fields}, {}, tmp_path, None, None, False)
