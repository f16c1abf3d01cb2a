"""Classes of a user's own that answer wrongly: each is named in one line, with what it should have returned."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.coverage.control import approach
from deploy.scoring.scorer import Scorer
from deploy.storage.kept_runs import kept_runs
from protocol.observer_messages import Truth
from protocol.sensing import Pose
from tests.deploy.wrong_inputs import folder, typed

__all__ = ["folder"]  # a fixture
SQUARE = np.array([[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]])


class Camera:
    """A sensor model as it should be; each of the others has one fault."""

    reach = 8.0
    area = 78.5

    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        """What is near is seen."""
        return np.where(np.hypot(points[:, 0] - pose[0], points[:, 1] - pose[1]) < 5.0, 0.9, 0.0)

    def footprint(self, pose: Pose) -> Any:
        """A square."""
        turn = np.array([[np.cos(pose[2]), np.sin(pose[2])], [-np.sin(pose[2]), np.cos(pose[2])]])
        return SQUARE @ turn + np.array(pose[:2])


class Shape(Camera):
    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return np.zeros(7)


class Nothing(Camera):
    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return None


class Nan(Camera):
    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return np.full(len(points), np.nan)


class Complex(Camera):
    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return np.full(len(points), 1j)


class Above(Camera):
    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return np.full(len(points), 1.5)


class Raises(Camera):
    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return {}["nope"]


class AsyncCamera(Camera):
    async def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return np.zeros(len(points))


class Blind(Camera):
    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return np.zeros(len(points))


class Later(Camera):
    """Right while the scenario is checked, and wrong later."""

    calls = 0

    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        Later.calls += 1
        return super().probability(points, pose) if Later.calls < 60 else "much"


class Farther(Camera):
    reach = 4.0


class Larger(Camera):
    area = 785.0


class Backwards(Camera):
    def footprint(self, pose: Pose) -> Any:
        return SQUARE[::-1]


class Line(Camera):
    def footprint(self, pose: Pose) -> Any:
        return np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])


class Bow(Camera):
    def footprint(self, pose: Pose) -> Any:
        return SQUARE[[0, 2, 1, 3]]


class Text(Camera):
    def footprint(self, pose: Pose) -> Any:
        return "everywhere"


class TwoCorners(Camera):
    def footprint(self, pose: Pose) -> Any:
        return SQUARE[:2]


class NoReach(Camera):
    reach = -1.0


class Wordy(Camera):
    area = "large"  # type: ignore[assignment]


class Absolute(Camera):
    """It forgets the pose."""

    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return super().probability(points, (0.0, 0.0, 0.0))


class Degrees(Camera):
    """It takes the heading for degrees, which is right where the heading is 0."""

    area = 39.3

    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        bearings = np.degrees(np.arctan2(points[:, 1] - pose[1], points[:, 0] - pose[0])) - pose[2]
        return np.where(abs(bearings) <= 90.0, super().probability(points, pose), 0.0)


class Moody(Camera):
    """It keeps a state between two calls."""

    calls = 0

    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        self.calls += 1
        return super().probability(points, pose) / self.calls


class Writes(Camera):
    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        points -= np.array(pose[:2])
        return super().probability(points, (0.0, 0.0, 0.0))


class Fixed(Camera):
    def footprint(self, pose: Pose) -> Any:
        return SQUARE


class Outside(Camera):
    def footprint(self, pose: Pose) -> Any:
        return 3.0 * SQUARE + np.array(pose[:2])


class Behind(Camera):
    """It sees half a disc ahead, and its outline is behind."""

    area = 39.3

    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        ahead = (points[:, 0] - pose[0]) * np.cos(pose[2]) + (points[:, 1] - pose[1]) * np.sin(pose[2])
        return super().probability(points, pose) * (ahead > 0.0)

    def footprint(self, pose: Pose) -> Any:
        turn = np.array([[np.cos(pose[2]), np.sin(pose[2])], [-np.sin(pose[2]), np.cos(pose[2])]])
        return (SQUARE * [0.5, 1.0] - [2.5, 0.0]) @ turn + np.array(pose[:2])


class Everywhere(Camera):
    reach = 2000.0


class Yes(Camera):
    """A probability of truth values counts as 0 or 1."""

    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        return super().probability(points, pose) > 0.0


class NoCamera:
    """It cannot be built, whatever it is used as."""

    def __init__(self, *_: Any) -> None:
        raise KeyError("no camera")


class Leaves:
    """It ends the program, or would."""

    def __init__(self, *_: Any) -> None:
        sys.exit(0)


class LaterLeaves:
    def command(self, situation: Any) -> Any:
        if situation.tick == 2:
            sys.exit(3)
        return (0.0, 0.0), 0.0


class Says:
    def command(self, situation: Any) -> Any:
        return "forward"


class NanLaw:
    def command(self, situation: Any) -> Any:
        return (float("nan"), 0.0), 0.0


class Flat:
    def command(self, situation: Any) -> Any:
        return 1.0, 0.0, 0.5


class Async:
    async def command(self, situation: Any) -> Any:
        return (0.0, 0.0), 0.0


class Words:
    def command(self, situation: Any) -> Any:
        return ("1", "2"), "3"


class Truths:
    def command(self, situation: Any) -> Any:
        return (True, False), True


class Nowhere:
    def command(self, situation: Any) -> Any:
        return approach(situation, None)  # type: ignore[arg-type]


class Gain:
    def __init__(self, gain: float) -> None: ...

    def command(self, situation: Any) -> Any: ...


def forward(situation: Any) -> Any:
    """A function in place of a class."""
    return (1.0, 0.0), 0.0


an_object = Camera()


class Breaks:
    def command(self, situation: Any) -> Any:
        return situation.no_such_thing


class LaterLaw:
    def command(self, situation: Any) -> Any:
        return "left" if situation.tick == 2 else ((0.0, 0.0), 0.0)


class Still:
    def __init__(self, *_: Any) -> None: ...

    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> Any:
        return positions


class Drifts(Still):
    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> Any:
        return positions + np.random.normal(size=positions.shape), headings


class Remembers:
    """It counts the commands of all agents."""

    calls = 0

    def command(self, situation: Any) -> Any:
        Remembers.calls += 1
        return (0.1 * Remembers.calls, 0.0), 0.0


class Counts:
    """It counts its own commands, as it may."""

    calls = 0

    def command(self, situation: Any) -> Any:
        self.calls += 1
        return (0.1 * self.calls, 0.0), 0.0


class Lost(Still):
    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> Any:
        return positions[:-1], headings


class Crash(Still):
    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> Any:
        raise ZeroDivisionError("boom")


def line_of(part: str) -> int:
    """The first line of this file that holds a text."""
    return next(number for number, line in enumerate(Path(__file__).read_text().splitlines(), start=1) if part in line)


NOWHERE, NO_CAMERA = line_of("approach(situation, None)"), line_of('KeyError("no camera")')
PLUGGED = [
    ("sensor", "Shape", "Shape.probability of 3 points returned an array of shape (7,)"),
    ("sensor", "Nothing", "Nothing.probability of 3 points returned None"),
    ("sensor", "Nan", "Nan.probability of 3 points returned an array with nan in it"),
    ("sensor", "Complex", "type complex128: should be an array of shape (3,) of finite real numbers"),
    ("sensor", "Above", "returned an array with 1.5 in it: should be from 0 to 1"),
    ("sensor", "Raises", "Raises.probability of 3 points raised KeyError: 'nope'"),
    ("sensor", "AsyncCamera", "AsyncCamera.probability is async: should be a method without async"),
    ("sensor", "Blind", "Blind: the detection probability is 0 everywhere"),
    ("sensor", "Later", "returned 'much': should be an array"),
    ("sensor", "Farther", "Farther.probability is 0.9 at 5 m: should be 0 beyond reach = 4"),
    ("sensor", "Larger", "Larger.area = 785: should be 78."),
    ("sensor", "Backwards", "Backwards.footprint returned corners that run clockwise: should be counter-clockwise"),
    ("sensor", "Caamera", "has no Caamera; did you mean Camera?"),
    ("sensor", "Line", "Line.footprint returned no polygon"),
    ("sensor", "Bow", "Bow.footprint returned no polygon"),
    ("sensor", "Text", "Text.footprint returned 'everywhere': should be an array of shape (N, 2)"),
    ("sensor", "TwoCorners", "TwoCorners.footprint returned 2 corners: a polygon has at least 3"),
    ("sensor", "Absolute", "Absolute.probability at the pose (13.7, -8.2, 2.3) differs in 100 % of the places in view"),
    ("sensor", "Degrees", "should depend on places relative to the pose alone (x m, y m, heading rad)"),
    ("sensor", "Moody", "differs in 100 % of the places in view from that at (0.0, 0.0, 0.0)"),
    ("sensor", "Writes", "Writes.probability changed the points that it was given: should leave them as they are"),
    ("sensor", "Fixed", "Fixed.footprint at the pose (13.7, -8.2, 2.3) is not that at (0.0, 0.0, 0.0), moved and turned"),
    ("sensor", "Outside", "Outside.footprint returned a corner at 21.2 m: should lie within reach = 8"),
    ("sensor", "Behind", "Behind.footprint is not where its probability is above 0: 0 % of the places in view lie within it"),
    ("sensor", "Everywhere", " of 1024 x 1024 places within its reach of 2000 m are seen, the farthest at "),
    ("sensor", "NoReach", "NoReach.reach = -1.0: should be a number > 0"),
    ("sensor", "Wordy", "Wordy.area = 'large': should be a number > 0"),
    ("sensor", "NoCamera", f"NoCamera raised KeyError: 'no camera' (test_faulty_classes.py, line {NO_CAMERA})"),
    ("sensor", "Says", "Says lacks reach, area, probability, footprint"),
    ("sensor", "Missing", "has no Missing"),
    ("sensor", "Leaves", "Leaves raised SystemExit: 0"),
    ("control", "Leaves", "raised SystemExit: 0"),
    ("motion", "Leaves", "raised SystemExit: 0"),
    ("control", "LaterLeaves", "LaterLeaves.command raised SystemExit: 3"),
    ("control", "Says", "Says.command returned 'forward': should be ((vx, vy), turn_rate)"),
    ("control", "NanLaw", "NanLaw.command returned ((nan, 0.0), 0.0)"),
    ("control", "Flat", "Flat.command returned (1.0, 0.0, 0.5)"),
    ("control", "Async", "Async.command is async: should be a method without async"),
    ("control", "Words", "Words.command returned (('1', '2'), '3'): should be ((vx, vy), turn_rate)"),
    ("control", "Truths", "Truths.command returned ((True, False), True): should be ((vx, vy), turn_rate)"),
    (
        "control",
        "Nowhere",
        f"Nowhere.command raised TypeError: 'NoneType' object is not subscriptable (test_faulty_classes.py, line {NOWHERE})",
    ),
    ("control", "Gain", "Gain: missing a required argument: 'gain'; it takes gain, and is built as Class() with a method command"),
    ("control", "forward", "forward: missing a required argument: 'situation'; it takes situation, and is built as Class()"),
    ("control", "an_object", "an_object is an object of the class Camera: should be a class"),
    ("sensor", "an_object", "an_object is an object of the class Camera: should be a class"),
    ("sensor", "np", "np is a module: should be a class"),
    ("control", "Remembers", "Remembers.command gives two answers to the same question, of tick 0: should follow from what `situation`"),
    (
        "motion",
        "Drifts",
        "Drifts.move gives two answers to the same question, of tick 0: should follow from the seed, the ids and the tick",
    ),
    ("control", "Breaks", "Breaks.command raised AttributeError"),
    ("control", "LaterLaw", "LaterLaw.command returned 'left'"),
    ("control", "Camera", "the class has no method command"),
    ("control", "NoCamera", "raised KeyError: 'no camera'"),
    ("motion", "Still", "Still.move of 2 targets returned array("),
    ("motion", "Lost", "Lost.move of 2 targets, positions: returned an array of shape (1, 2)"),
    ("motion", "Crash", "Crash.move of 2 targets raised ZeroDivisionError: boom"),
    ("motion", "Says", "targets.motion = "),
    ("motion", "NoCamera", "raised KeyError: 'no camera'"),
]


@pytest.mark.parametrize(("kind", "name", "part"), PLUGGED, ids=[f"{row[0]}-{row[1]}" for row in PLUGGED])
def test_a_class_of_the_users_own_that_answers_wrongly_is_named_in_one_line(
    kind: str, name: str, part: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setting = {"sensor": "sensors.X.model", "control": "control.mode", "motion": "targets.motion"}[kind]
    words = ["simulate", "quick", "--seconds", "3", "--set", f"{setting}={__name__}:{name}"]
    found, complaints = typed([*words, *(["--team", "2X"] if kind == "sensor" else [])], capsys)
    complaints = [line for line in complaints if line.startswith("covey: ")]
    assert len(complaints) == 1 and part in complaints[0] and name in complaints[0], complaints
    assert found == 2


def test_a_simulation_that_a_law_has_ended_keeps_what_was_scored_and_is_listed_as_failed(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(folder / "runs"))
    words = ["simulate", "quick", "--seconds", "3", "--run", "one", "--set", f"control.mode={__name__}:LaterLaw"]
    assert typed(words, capsys)[0] == 2
    [kept] = kept_runs()
    result = json.loads((folder / "runs" / "one" / "result.json").read_text())
    assert (kept.state, result["exit_code"]) == ("failed", 2) and 1 <= result["ticks"] <= 3


def test_a_simulation_that_an_error_of_our_own_has_ended_is_listed_as_failed(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(scorer: Scorer, truth: Truth, now: float) -> None:
        raise ZeroDivisionError("boom")

    monkeypatch.setattr(Scorer, "_score", fail)
    assert typed(["simulate", "quick", "--seconds", "1", "--run", "one"], capsys)[0] == 1
    assert [kept.state for kept in kept_runs()] == ["failed"]


@pytest.mark.parametrize("setting", ["sensors.X.model", "control.mode", "targets.motion"])
def test_a_module_that_ends_the_program_while_it_is_imported_is_one_line(
    setting: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "leaving.py").write_text("import sys\nsys.exit(0)\n")
    team = ["--team", "2X"] if "X" in setting else []
    found, complaints = typed(["simulate", "quick", "--seconds", "3", *team, "--set", f"{setting}=leaving:Any"], capsys)
    assert found == 2
    assert len(complaints) == 1 and "module leaving cannot be imported: SystemExit: 0" in complaints[0], complaints


def test_the_classes_that_have_no_fault_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("Camera", "Yes"):
        words = ["--seconds", "2", "--team", "2X", "--set", f"sensors.X.model={__name__}:{name}"]
        assert typed(["simulate", "quick", *words], capsys)[0] == 0
    assert typed(["check", "quick", "--set", f"control.mode={__name__}:Counts"], capsys)[0] == 0


def test_there_are_thirty_faults_and_more() -> None:
    assert len(PLUGGED) >= 30
