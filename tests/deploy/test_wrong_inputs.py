"""Whatever is wrong with what is typed, with a file, a class or a machine: one line on standard error, the exit code, no traceback."""

import os
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.__main__ import app
from deploy.cli.errors import guarded
from deploy.cli.options import RunOptions
from protocol.sensing import Pose

ROOT = Path(__file__).parents[2]
SQUARE = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 5.0], [0.0, 5.0]])


class Camera:
    """A sensor model as it should be; each of the others has one fault."""

    reach = 8.0
    area = 78.5

    def probability(self, points: np.ndarray, pose: Pose) -> Any:
        """What is near is seen."""
        return np.where(np.hypot(points[:, 0] - pose[0], points[:, 1] - pose[1]) < 5.0, 0.9, 0.0)

    def footprint(self, pose: Pose) -> Any:
        """A square."""
        return SQUARE + np.array(pose[:2])


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


class Lost(Still):
    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> Any:
        return positions[:-1], headings


class Crash(Still):
    def move(self, positions: np.ndarray, headings: np.ndarray, ids: np.ndarray, tick: int) -> Any:
        raise ZeroDivisionError("boom")


TYPED = [
    ("nosuch", 2, 'Unknown command "nosuch"'),
    ("kil s1", 2, 'Did you mean "kill"'),
    ("help kil", 2, 'Did you mean "kill"'),
    ("up --nope", 2, "Unknown option: --nope"),
    ("simulate quick too many", 2, "too"),
    ("simulate quick --dt", 2, "--dt requires an argument"),
    ("simulate quick --seed 1.5", 2, "--seed: 1.5 is no whole number"),
    ("simulate quick --seed -1", 2, "run.seed = -1: should be a whole number >= 0"),
    ("simulate quick --seed 9223372036854775808", 2, "run.seed = 9223372036854775808"),
    ("simulate quick --targets 7.6", 2, "--targets: 7.6 is no whole number"),
    ("simulate quick --targets -3", 2, "targets.count = -3: should be a whole number >= 0"),
    ("simulate quick --dt 0", 2, "run.dt = 0.0: should be a number"),
    ("simulate quick --dt nan", 2, "run.dt = nan: should be a number"),
    ("simulate quick --dt soon", 2, "--dt"),
    ("simulate quick --seconds -5", 2, "run.seconds = -5.0: should be a number"),
    ("simulate quick --seconds inf", 2, "run.seconds = inf: should be a number"),
    ("simulate quick --rate 0", 2, "run.rate = 0.0: should be a number"),
    ("simulate quick --team 3Z", 2, "sensor class 'Z' does not exist; known are A"),
    ("simulate quick --team ''", 2, "team.composition = '': should be a team"),
    ("simulate quick --team 3 --triple AAC", 2, "team.triple = 'AAC': should be three different"),
    ("simulate quick --partition hexagon", 2, 'Choose from: "power"'),
    ("simulate quick --capacity much", 2, 'Choose from: "literal"'),
    ("simulate quick --control nowhere", 2, "control.mode = 'nowhere': known are lloyd"),
    ("simulate quick --control no_such_module:Law", 2, "No module named 'no_such_module'"),
    ("simulate quick --kill s3", 2, "--kill s3: should read who@when"),
    ("simulate quick --kill s99@3", 2, "'s99': there is no such process"),
    ("simulate quick --kill s3@300", 2, "at = 300: the run ends before; its last tick is at 29.75 s"),
    ("simulate quick --kill 150%@3", 2, "a share is at most 100%"),
    ("simulate quick --kill 7@3", 2, "only 6 agents qualify"),
    ("simulate quick --loss 1.5", 2, "--loss 1.5: should be a share"),
    ("simulate quick --set limits.speed=1e7", 2, "limits.speed = 10000000.0: should be a number"),
    ("simulate quick --set sensors.A.radius=6e5", 2, "sensors.A.radius = 600000.0: should be a number"),
    ("simulate quick --set filter.gate=26", 2, "filter.gate = 26: should be a number"),
    ("simulate quick --set detection.noise=1e-170", 2, "detection.noise = 1e-170: should be a number"),
    ("simulate quick --set detection.noise=1e9", 2, "detection.noise = 1000000000.0: should be a number"),
    ("simulate quick --set detection.clutter=8000", 2, "detection.clutter = 8000: should be a number"),
    ("simulate quick --set filter.speed=1e9", 2, "filter.speed = 1000000000.0: should be a number"),
    ("simulate quick --set extraction.bin=0.001", 2, "extraction.bin = 0.001: should be a number"),
    ("simulate quick --set filter.prior_density=1e9", 2, "filter.prior_density = 1000000000.0: should be a number"),
    (
        "simulate quick --set filter.prior_density=50",
        2,
        "filter.prior_density = 50.0: a prior of 2343750 particles in 625 m^2; should be at most 21",
    ),
    ("simulate quick --set arena.width=1e9", 2, "arena.width = 1000000000.0, arena.height = 25.0: a prior of"),
    ("simulate quick --set arena.width=1e4 --set arena.height=1e4", 2, "should be at most 3.3e+06 m^2"),
    ("simulate quick --loss nan", 2, "--loss nan: should be a share"),
    ("simulate quick --delay -1", 2, "--delay -1.0: should be a number of seconds"),
    ("simulate quick --set run.sead=1", 2, "run.sead: there is no such field; did you mean seed?"),
    ("simulate quick --set sead=1", 2, "--set sead=1: should read section.key=value"),
    ("simulate quick --set run.seed", 2, "--set run.seed: should read section.key=value"),
    ("simulate quick --set run.seed.x=1 --seed 3", 2, "seed is not a section"),
    ("simulate quick --set pose.memory=2", 2, "pose.memory = 2: has no errors to average; should be 0, or pose.position_noise"),
    ("simulate quick --set pose.time_noise=-1", 2, "pose.time_noise = -1: should be a number >= 0.0"),
    ("simulate quick --set bodies.time_error=99", 2, "bodies.time_error = 99: should be a number <= 10.0"),
    ("simulate quick --run ../up", 2, "run.name = '../up': should be 1 to 64 letters"),
    ("simulate quick --seconds 1 --trace x.txt", 2, "--trace x.txt: should end in .npz, .parquet, .csv"),
    ("simulate quick --seconds 1 --trace no/such/x.csv", 2, "the folder no/such does not exist"),
    ("simulate quick --seconds 1 --record x.txt", 2, "--record x.txt: should be a file that ends in .mcap"),
    ("simulate quick --seconds 1 --record file/x.mcap", 2, "--record file/x.mcap: "),
    ("simulate quick --seconds 1 --trace /dev/full/x.csv", 2, "/dev/full"),
    ("simulate nosuch", 2, "scenario 'nosuch' does not exist; known are anisotropic"),
    ("simulate nosuch.toml", 2, "nosuch.toml: there is no such file"),
    ("simulate ./", 2, "Is a directory"),
    ("simulate empty.toml", 2, "empty.toml: says nothing; `covey init"),
    ("check empty.toml", 2, "empty.toml: says nothing; `covey init"),
    ("simulate syntax.toml", 2, "syntax.toml: not a TOML file"),
    ("simulate binary.toml", 2, "binary.toml: not a TOML file"),
    ("simulate twice.toml", 2, "twice.toml: not a TOML file"),
    ("simulate section.toml", 2, "tagrets: there is no such field; did you mean targets?"),
    ("simulate late.toml", 2, "faults[0].at = 300: the run ends before"),
    ("simulate verb.toml", 2, "faults[0].verb = 'kil': should be one of kill"),
    ("simulate at.toml", 2, "the field at is missing"),
    ("simulate member.toml", 2, "members = 'a b': should be 1 to 64 letters"),
    ("simulate class.toml", 2, "sensor class 'Q' does not exist"),
    ("check open.toml", 2, "leaves this machine without TLS"),
    ("simulate quick --seconds 5 --kill world@2", 2, "a simulation has no process to strike whose name is world"),
    ("check world.toml", 2, "members.world: this name belongs to the world"),
    ("config quick --seed 1.5", 2, "--seed: 1.5 is no whole number"),
    ("ps", 2, "no run is running in"),
    ("ps -a --run hunt", 2, "--run hunt: -a shows all runs"),
    ("watch", 2, "no run is running in"),
    ("watch --page 99999", 2, "no run is running in"),
    ("echo truth", 2, "no run is running in"),
    ("hz truth --seconds x", 2, "--seconds"),
    ("ls --run nix", 2, "--run nix: no run of this name is running"),
    ("record x.mcap", 2, "no run is running in"),
    ("down --run nix", 2, "--run nix: no run of this name is running"),
    ("logs", 2, "there is no run in"),
    ("logs --run nix", 2, "--run nix: there is no such run"),
    ("logs --lines -1", 2, "--lines -1: should be 0 or more"),
    ("kill", 2, "kill: nobody is named"),
    ("kill s1 30%", 2, "s1 30%: should be names, or one number or share"),
    ("kill --random 2 s1", 2, "--random 2: draws agents"),
    ("pause --random 1.5", 2, "1.5 is no whole number"),
    ("resume s1", 2, "no run is running in"),
    ("drop much", 2, "SHARE"),
    ("heal now", 2, "now"),
    ("score nix", 2, "nix"),
    ("score file.mcap", 2, "file.mcap"),
    ("replay nix", 2, "nix"),
    ("export nix --to pdf", 2, 'Choose from: "csv"'),
    ("figures nix", 2, "nix"),
    ("study nix", 2, "nix"),
    ("study efficacy --trials 0", 2, "--trials 0: should be at least 1"),
    ("study efficacy --trials 1.5", 2, "1.5 is no whole number"),
    ("study efficacy --targets few", 2, "--targets few: should be whole numbers"),
    ("study efficacy --faults kill", 2, "--faults kill: an option of the robustness study alone"),
    ("study robustness --methods power", 2, "--methods power: not an option"),
    ("study robustness --faults rain", 2, "--faults rain: should be one or more of kill"),
    ("fuzz --seeds 0", 2, "--seeds 0"),
    ("init mine", 2, "mine: should be a file that ends in .toml"),
    ("init empty.toml", 2, "empty.toml: exists and is left as it is"),
    ("init no/such/x.toml", 2, "no/such/x.toml: No such file or directory"),
    ("completion tcsh", 2, 'Choose from: "bash"'),
    ("keys", 2, "keys: give either names"),
    ("keys s1 --scenario quick", 2, "keys: give either names"),
    ("keys 'a b'", 2, "name 'a b': should be 1 to 64 letters"),
    ("keys ca", 2, "name 'ca': should be"),
    ("keys s1 --days 0", 2, "--days 0: should be a number of days"),
    ("keys s1 --days 1.5", 2, "1.5 is no whole number"),
    ("keys s1 --host 'a b'", 2, "--host a b: should be an IP address or a host name"),
    ("keys s1 --into file", 2, "--into file: File exists"),
    ("keys s1 --into tree/keys", 2, "--into tree/keys: lies in the git work tree"),
]

PLUGGED = [
    ("sensor", "Shape", "Shape.probability of 3 points returned an array of shape (7,)"),
    ("sensor", "Nothing", "Nothing.probability of 3 points returned None"),
    ("sensor", "Nan", "Nan.probability of 3 points returned an array with nan in it"),
    ("sensor", "Complex", "type complex128: should be an array of shape (3,) of finite real numbers"),
    ("sensor", "Above", "returned an array with 1.5 in it: should be from 0 to 1"),
    ("sensor", "Raises", "Raises.probability of 3 points raised KeyError: 'nope'"),
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
    ("sensor", "NoReach", "NoReach.reach = -1.0: should be a number > 0"),
    ("sensor", "Wordy", "Wordy.area = 'large': should be a number > 0"),
    ("sensor", "NoCamera", "NoCamera raised KeyError: 'no camera'"),
    ("sensor", "Says", "Says lacks reach, area, probability, footprint"),
    ("sensor", "Missing", "has no Missing"),
    ("sensor", "Leaves", "Leaves raised SystemExit: 0"),
    ("control", "Leaves", "raised SystemExit: 0"),
    ("motion", "Leaves", "raised SystemExit: 0"),
    ("control", "LaterLeaves", "LaterLeaves.command raised SystemExit: 3"),
    ("control", "Says", "Says.command returned 'forward': should be ((vx, vy), turn_rate)"),
    ("control", "NanLaw", "NanLaw.command returned ((nan, 0.0), 0.0)"),
    ("control", "Flat", "Flat.command returned (1.0, 0.0, 0.5)"),
    ("control", "Breaks", "Breaks.command raised AttributeError"),
    ("control", "LaterLaw", "LaterLaw.command returned 'left'"),
    ("control", "Camera", "the class needs a method command(situation)"),
    ("control", "NoCamera", "raised KeyError: 'no camera'"),
    ("motion", "Still", "Still.move of 2 targets returned array("),
    ("motion", "Lost", "Lost.move of 2 targets, positions: returned an array of shape (1, 2)"),
    ("motion", "Crash", "Crash.move of 2 targets raised ZeroDivisionError: boom"),
    ("motion", "Says", "targets.motion = "),
    ("motion", "NoCamera", "raised KeyError: 'no camera'"),
]

FILES = {
    "empty.toml": b"",
    "syntax.toml": b"[run\n",
    "binary.toml": b"\xff\xfe\x00",
    "twice.toml": b"[run]\nseed = 1\nseed = 2\n",
    "section.toml": b"[tagrets]\ncount = 3\n",
    "late.toml": b"[run]\nseconds = 10.0\n[[faults]]\nat = 300.0\nverb = 'kill'\nwho = '1'\n",
    "verb.toml": b"[[faults]]\nat = 3.0\nverb = 'kil'\nwho = '1'\n",
    "at.toml": b"[[faults]]\nverb = 'kill'\n",
    "member.toml": b"[members]\n'a b' = 'A'\n",
    "class.toml": b"[members]\ns1 = 'Q'\n",
    "open.toml": b"[network]\nlisten = ['tcp/0.0.0.0:0']\n",
    "world.toml": b"[members]\nworld = 'A'\n",
    "file": b"",
    "file.mcap": b"no recording",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of a user's, with wrong files in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COVEY_RUNS", str(tmp_path / "runs"))
    monkeypatch.delenv("COVEY_DEBUG", raising=False)
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name, content in FILES.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "tree" / ".git").mkdir(parents=True)
    return tmp_path


def typed(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    """Exit code and lines of complaint of a command in this process, but for the line of the first one that compiles."""
    code = guarded(lambda: app(words, exit_on_error=False, print_error=False, result_action="return_value") or 0)
    lines = capsys.readouterr().err.splitlines()
    return code, [line for line in lines if not line.startswith("covey: compiling")]


@pytest.mark.parametrize(("line", "code", "part"), TYPED, ids=[row[0] for row in TYPED])
def test_what_is_typed_or_filed_wrongly_is_one_line(
    line: str, code: int, part: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, complaints = typed(shlex.split(line), capsys)
    assert len(complaints) == 1 and complaints[0].startswith("covey: ") and part in complaints[0], complaints
    assert found == code and "Error" not in complaints[0]


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
    words = ["--seconds", "2", "--team", "2X", "--set", f"sensors.X.model={__name__}:Camera"]
    assert typed(["simulate", "quick", *words], capsys)[0] == 0


def test_check_tells_all_that_is_wrong_with_a_file_a_line_each(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "many.toml").write_text("""
        [run]
        seed = -1
        sead = 4
        [targets]
        count = 1.5
        [control]
        mode = "nowhere"
        [network]
        listen = ["tcp/0.0.0.0:0"]
        [members]
        s1 = "A"
        [[faults]]
        at = "soon"
        verb = "kill"
        [[faults]]
        verb = "kil"
        whom = "s1"
    """)
    code, complaints = typed(["check", "many.toml"], capsys)
    typing = ["run.seed = -1", "run.sead", "targets.count = 1.5", "faults.0.at = 'soon'", "faults.1.whom", "the field at is missing"]
    parts = [*typing, "control.mode", "network.listen"]
    assert code == 2 and len(complaints) == len(parts), complaints
    assert all(line.startswith("covey: many.toml: ") for line in complaints)
    assert all(sum(part in line for line in complaints) == 1 for part in parts), complaints


def test_what_only_follows_from_a_mistake_is_not_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "one.toml").write_text("[members]\ns1 = 3\n[[faults]]\nat = 1.0\nverb = 'kill'\nwho = 's1'\n")
    code, complaints = typed(["check", "one.toml"], capsys)
    assert code == 2 and len(complaints) == 1 and "members.s1 = 3: should be a text" in complaints[0]


def test_an_error_of_our_own_is_one_line_that_names_a_file_with_the_details(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: RunOptions, name: str) -> None:
        raise LookupError("deep\ninside")

    monkeypatch.setattr(RunOptions, "scenario", broken)
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    code, complaints = typed(["config", "quick"], capsys)
    assert code == 1 and len(complaints) == 1
    assert complaints[0].startswith("covey: an error of Covey's own: LookupError: deep inside; details are in ")
    assert "in broken" in Path(complaints[0].rpartition(" ")[2]).read_text()
    monkeypatch.setenv("COVEY_DEBUG", "1")
    with pytest.raises(LookupError):
        typed(["config", "quick"], capsys)


def program(*words: str) -> list[str]:
    return [sys.executable, "-P", "-m", "deploy", *words]


def started(command: list[str] | str, folder: Path, **more: Any) -> tuple[int, list[str]]:
    """Exit code and complaints of a program, or of a line of shell."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COVEY_RUNS": str(folder / "runs")}
    shell = isinstance(command, str)
    done = subprocess.run(
        command, cwd=folder, env=environment, shell=shell, stderr=subprocess.PIPE, timeout=100, **{"stdout": subprocess.PIPE, **more}
    )
    return done.returncode, done.stderr.decode().splitlines()


@pytest.mark.parametrize("line", ["help", "config quick", "ps -a", "completion bash", "--version"])
def test_a_standard_output_that_is_full_is_one_line_and_exit_code_1(line: str, folder: Path) -> None:
    with open("/dev/full", "wb") as full:
        code, complaints = started(program(*shlex.split(line)), folder, stdout=full)
    assert (code, complaints) == (1, ["covey: standard output: No space left on device"])


def test_a_reader_who_leaves_is_no_error(folder: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    assert started(program("completion", "bash"), folder, stdout=writer) == (0, [])
    os.close(writer)


def test_closed_standard_files_and_a_folder_that_has_gone_are_no_traceback(folder: Path) -> None:
    shell = " ".join(map(shlex.quote, program("config", "quick")))
    assert started(f"{shell} <&- >&-", folder) == (0, [])
    (folder / "gone").mkdir()
    code, complaints = started(f"cd gone && rmdir ../gone && {shell}", folder)
    assert (code, complaints) == (1, ["covey: the current folder: No such file or directory"])


def test_a_runs_folder_that_cannot_be_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COVEY_RUNS", str(folder / "file" / "runs"))
    for words in (["up", "quick"], ["demo"], ["up", "quick", "--detach"]):
        code, complaints = typed(words, capsys)
        assert code == 2 and len(complaints) == 1 and "Not a directory; COVEY_RUNS names another place" in complaints[0]
    code, complaints = typed(["check", "quick"], capsys)
    assert code == 2 and len(complaints) == 1 and "cannot be written; COVEY_RUNS names another place" in complaints[0]


def namespaced(kind: str, script: str, folder: Path) -> tuple[int, list[str]]:
    """Exit code and complaints of a line of shell in a namespace of its own, which takes what it mounts with it."""
    if shutil.which("unshare") is None or subprocess.run(["unshare", kind, "true"], capture_output=True).returncode:
        pytest.skip("needs the right to make namespaces: root, and unshare")
    return started(["unshare", kind, "sh", "-c", script], folder)


@pytest.mark.parametrize("line", ["up quick --lockstep --seconds 2", "up quick --detach", "demo --no-page", "check quick"])
@pytest.mark.parametrize(("options", "reason"), [("size=8k", "No space left on device"), ("ro", "Read-only file system")])
def test_a_disk_that_is_full_or_may_not_be_written_is_told_before_anything_starts(
    line: str, options: str, reason: str, folder: Path
) -> None:
    (folder / "runs").mkdir()
    fill = "head -c 8192 /dev/zero > runs/fill; " if options.startswith("size") else ""
    script = f"mount -t tmpfs -o {options} none runs && {fill}exec {' '.join(map(shlex.quote, program(*shlex.split(line))))}"
    code, complaints = namespaced("-m", script, folder)
    told = (
        {"No space left on device": "the disk is full", "Read-only file system": "cannot be written"}[reason] if "check" in line else reason
    )
    assert code == 2 and len(complaints) == 1 and told in complaints[0] and "COVEY_RUNS names another place" in complaints[0], complaints


@pytest.mark.parametrize("line", ["up quick --seconds 2", "demo", "check quick"])
def test_a_machine_that_cannot_reach_itself_is_told_before_anything_starts(line: str, folder: Path) -> None:
    code, complaints = namespaced("-n", f"exec {' '.join(map(shlex.quote, program(*shlex.split(line))))}", folder)
    assert code == 2 and len(complaints) == 1, complaints
    assert "127.0.0.1 cannot be reached: Network is unreachable; `ip link set lo up`" in complaints[0]


@pytest.mark.live
@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("up quick --seconds 2 --page PORT", "--page 127.0.0.1:PORT: Address already in use"),
        ("up quick --seconds 2 --page 99999", "--page 99999: should be a port such as 8080, or host:port"),
        ("up quick --seconds 2 --page nowhere:80", "--page nowhere:80: "),
        ("up quick --seconds 2 --set network.listen=[\"tcp/127.0.0.1:PORT\"]", "network.listen = tcp/127.0.0.1:PORT: the port is in use"),
        ("up quick --seconds 2 --keys nowhere", "nowhere/ca.pem': No such file or directory; `covey keys` makes"),
        ("up quick --seconds 2 --record file/x.mcap", "--record file/x.mcap: "),
        ("up quick --seconds 2 --detach --page PORT", "--page 127.0.0.1:PORT: Address already in use"),
    ],
)  # fmt: skip
def test_what_the_machine_refuses_a_swarm_is_one_line(line: str, part: str, folder: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        code, complaints = started(program(*shlex.split(line.replace("PORT", port), posix=False)), folder)
    complaints = [complaint for complaint in complaints if not complaint.startswith("covey: compiling")]
    assert code == 2 and len(complaints) == 1 and part.replace("PORT", port) in complaints[0], complaints


@pytest.mark.live
@pytest.mark.parametrize("line", ["up quick --seconds 2 --lockstep", "simulate quick --seconds 2"])
def test_a_run_whose_output_has_no_room_ends_with_one_line(line: str, folder: Path) -> None:
    with open("/dev/full", "wb") as full:
        code, complaints = started(program(*shlex.split(line)), folder, stdout=full)
    complaints = [complaint for complaint in complaints if complaint.startswith("covey: ") and "compiling" not in complaint]
    assert (code, complaints) == (1, ["covey: standard output: No space left on device"])


def test_there_are_sixty_rows_and_more() -> None:
    assert len(TYPED) + len(PLUGGED) >= 60
