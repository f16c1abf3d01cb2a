"""Whatever is wrong with what is typed or with a file: one line on standard error, the exit code, no traceback."""

import shlex
from pathlib import Path

import pytest

from deploy.__main__ import app
from deploy.cli.errors import MOST_REMARKS, guarded
from deploy.cli.options import RunOptions
from tests.deploy.wrong_inputs import folder, typed

__all__ = ["folder"]  # a fixture

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
    ("simulate efficacy --triple XYZ", 2, "efficacy.toml with options: team.triple: sensor class 'X' does not exist; known are A"),
    ("simulate quick --team 3Z --triple ABC", 2, "team.composition: sensor class 'Z' does not exist"),
    ("simulate quick --triple ABC", 2, "--triple ABC: should be left out with team A2,B4: teams 2, 3, 4, 5 alone have it"),
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
    (
        "simulate quick --set filter.prior_density=5",  # each says more than the others take for possible
        2,
        "filter.prior_density = 5.0: a prior of 521 expected targets for each of 6 agents; should be at most 1.4",
    ),
    (
        "check quick --set targets.count=3000 --set team.composition=A2",
        2,
        "targets.count = 3000: 1500 for each of 2 agents; should be at most 300",
    ),
    (
        "check quick --set arena.width=2e4 --set arena.height=2e4 --set filter.prior_particles=1e-5 --set filter.prior_density=1e-8 "
        "--set extraction.bin=30",
        2,
        "filter.vicinity = 3.0: too fine for 4e+08 m^2; should be at least 5.8 m",
    ),
    ("simulate quick --set arena.width=5e5", 2, "arena.width = 500000.0, arena.height = 25.0: a prior of"),
    ("simulate quick --set arena.width=1e4 --set arena.height=1e4", 2, "should be at most 3.3e+06 m^2"),
    ("simulate quick --loss nan", 2, "--loss nan: should be a share"),
    ("simulate quick --delay -1", 2, "--delay -1.0: should be a number of seconds"),
    ("simulate quick --delay 2e6", 2, "--delay 2000000.0: should be a number of seconds from 0 to less than 1e6"),
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
    ("simulate late.toml", 2, "covey: late.toml: faults[0].at"),
    ("simulate nobody.toml", 2, "nobody.toml: faults[0].who is missing: should be a name such as s3"),
    ("simulate body.toml", 2, "faults[0].who = 's1.body': there is no such process; known are s1, s2, world, a number"),
    ("simulate strong.toml", 2, "faults[0].value = 2: should be left out for kill; only drop, "),
    ("check again.toml", 2, "again.toml: faults[0].who = 's1': there is a process of this name"),
    ("check joins.toml", 2, "joins.toml: faults[1].who = 'guest0': there is a process of this name"),
    ("check blank.toml", 2, "blank.toml: faults[0].who = 'a b': should be 1 to 64 letters"),
    ("check newclass.toml", 2, "newclass.toml: faults[0].options.class = 'Q': sensor class 'Q' does not exist"),
    ("check idle.toml", 2, "idle.toml: sensors.X: a wedge needs an angle (degrees) and a radius (m)"),
    ("check mixed.toml", 2, "mixed.toml: sensors.X.angle = 90: only a wedge reads it"),
    ("check wedge.toml", 2, "wedge.toml: sensors.A.parameters = {'far': 1}: a wedge has none"),
    ("check ray.toml", 2, "ray.toml: sensors.A.bearing_noise = 0: should be more than 0 and at most 45 degrees"),
    ("check far.toml", 2, "far.toml: sensors.A.range_noise = 1: should be left out"),
    ("check beam.toml", 2, "beam.toml: sensors.A.radius = 1000: should be at most "),
    ("check suffix.toml", 2, "suffix.toml: sensors.A: 'mine.py:Camera': should be the name of a module, without .py: mine:Camera"),
    ("check dash.toml", 2, "dash.toml: team.composition = '2cam-1': should be a team 1-8"),
    ("simulate quick --data file", 2, "is not read with recorded.kind = 'none'; that should be one of pedestrians, ships, mrclam"),
    ("simulate member.toml", 2, "members = 'a b': should be 1 to 64 letters"),
    ("simulate class.toml", 2, "sensor class 'Q' does not exist"),
    ("check open.toml", 2, "leaves this machine without TLS"),
    ("simulate quick --seconds 5 --kill world@2", 2, "faults[0].who = 'world': a simulation has no such process"),
    ("check world.toml", 2, "members.world: this name belongs to the world"),
    ("check few.toml", 2, "few.toml: faults[1].who = '2': only 1 agent qualifies at 2 s"),
    ("simulate few.toml", 2, "few.toml: faults[1].who = '2': only 1 agent qualifies at 2 s"),
    ("check robot.toml", 2, "robot.toml: bodies.platform = 'no_such_lab:Robot': No module named 'no_such_lab'"),
    ("simulate robot.toml", 2, "covey: robot.toml: bodies.platform = 'no_such_lab:Robot': No module named 'no_such_lab'"),
    ("up robot.toml", 2, "covey: robot.toml: bodies.platform = 'no_such_lab:Robot': No module named 'no_such_lab'"),
    ("check agents.toml", 2, "covey: agents.toml: settings of agents, as a run writes them; a scenario is the run.toml beside it"),
    ("check strangers.toml --team 4A", 2, "covey: strangers.toml: settings of agents, as a run writes them"),
    ("check scalar.toml", 2, "scalar.toml: run = 5: should be a table, got a whole number"),
    ("simulate agents.toml", 2, "covey: agents.toml: settings of agents, as a run writes them"),
    ("up agents.toml --seconds 5", 2, "covey: agents.toml: settings of agents, as a run writes them"),
    ("keys --scenario agents.toml", 2, "covey: agents.toml: settings of agents, as a run writes them"),
    ("record --run agents.toml", 2, "covey: agents.toml: settings of agents, as a run writes them"),  # who has bodies it does not say
    ("check agents.toml --network", 2, "covey: network.seeds is empty: nobody is dialled"),
    ("up quick --keys nokeys", 2, "nokeys/ca.pem': No such file or directory; `covey keys` makes"),
    ("check port.toml", 2, "port.toml: bodies.platform = 'covey.examples.robots:DifferentialDrive': "),
    ("check team.toml", 2, "team.toml: team.composition = '2A': should be left out, or empty, for [members] names other agents"),
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
    ("kill --random -1", 2, "--random -1: should be 1 or more"),
    ("ls --seconds nan", 2, "--seconds nan: should be more than 0"),
    ("hz gossip --seconds -1", 2, "--seconds -1: should be more than 0"),
    ("study convergence --workers 0", 2, "--workers 0: should be 1 or more"),
    ("export file.mcap --to geojson --empty-origin", 2, "--empty-origin"),
    ("pause --random 1.5", 2, "1.5 is no whole number"),
    ("resume s1", 2, "no run is running in"),
    ("drop much", 2, "SHARE"),
    ("heal now s1", 2, "heal: now s1: should be left out; see `covey help heal`"),
    ("score nix", 2, "nix"),
    ("score file.mcap", 2, "file.mcap"),
    ("replay nix", 2, "nix"),
    ("replay nix --no-page", 2, "--no-page: should come with --publish, or nothing is shown"),
    ("export nix --to pdf", 2, 'Choose from: "csv"'),
    ("figures nix", 2, "nix"),
    ("study nix", 2, "nix"),
    ("study heterogeneity --triple ABC", 2, "--triple ABC: should be left out with team 20E+20F: teams 2, 3, 4, 5 alone have it"),
    ("study robustness --teams 10A --triple ABC", 2, "--triple ABC: should be left out with team 10A: teams"),
    ("study bodies --triple ABC", 2, "--triple ABC: should be left out with team A4,B4: teams"),
    ("study efficacy --trials 0", 2, "--trials 0: should be at least 1"),
    ("study efficacy --trials 1.5", 2, "1.5 is no whole number"),
    ("study efficacy --targets few", 2, "--targets few: should be whole numbers"),
    ("study efficacy --faults kill", 2, "--faults kill: an option of the robustness study alone"),
    ("study robustness --methods power", 2, "--methods power: not an option"),
    ("study robustness --faults rain", 2, "--faults rain: should be one or more of kill"),
    ("study robustness --set run.seconds=abc", 2, "run.seconds = 'abc': should be a number, got a text"),
    ("study bodies --set run.seconds=abc", 2, "run.seconds = 'abc': should be a number, got a text"),
    ("check quick --control oracle --bodies own", 2, "bodies.host = 'own': should be 'world' with control.mode = 'oracle'"),
    ("study efficacy --seed -1", 2, "--seed -1: should be a whole number from 0 to "),
    ("study robustness --seed -1", 2, "--seed -1: should be a whole number from 0 to "),
    ("study bodies --methods points --seed -1", 2, "--seed -1: should be a whole number from 0 to "),
    ("fuzz --seeds 0", 2, "--seeds 0"),
    ("fuzz --seeds 2 --first 9223372036854775807", 2, "should be at least one seed, of 0 to 9223372036854775807"),
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


@pytest.mark.parametrize(("line", "code", "part"), TYPED, ids=[row[0] for row in TYPED])
def test_what_is_typed_or_filed_wrongly_is_one_line(
    line: str, code: int, part: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, complaints = typed(shlex.split(line), capsys)
    assert len(complaints) == 1 and complaints[0].startswith("covey: ") and part in complaints[0], complaints
    assert found == code and "Error" not in complaints[0]


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
    typing = ["run.seed = -1", "run.sead", "targets.count = 1.5", "faults[0].at = 'soon'", "faults[1].whom", "the field at is missing"]
    parts = [*typing, "control.mode", "network.listen"]
    assert code == 2 and len(complaints) == len(parts), complaints
    assert all(line.startswith("covey: many.toml: ") for line in complaints)
    assert all(sum(part in line for line in complaints) == 1 for part in parts), complaints


def test_check_names_all_that_is_left_out_of_a_recording_once(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = guarded(lambda: app(["check", "solent"], exit_on_error=False, print_error=False, result_action="return_value") or 0)
    said = capsys.readouterr()
    assert (code, said.err) == (0, "") and said.out.count("\nleft out   ") > MOST_REMARKS


def test_what_only_follows_from_a_mistake_is_not_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "one.toml").write_text("[members]\ns1 = 3\n[[faults]]\nat = 1.0\nverb = 'kill'\nwho = 's1'\n")
    code, complaints = typed(["check", "one.toml"], capsys)
    assert code == 2 and len(complaints) == 1 and "members.s1 = 3: should be a text" in complaints[0]


def test_a_law_of_the_users_own_is_not_tried_with_a_team_that_is_wrong(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(folder))
    (folder / "own_law.py").write_text("class Law:\n    def command(self, situation):\n        return (0.0, 0.0), 0.0\n")
    (folder / "one.toml").write_text("control.mode = 'own_law:Law'\nteam.composition = '1Q?'\n")
    code, complaints = typed(["check", "one.toml"], capsys)
    assert code == 2 and len(complaints) == 1 and "1Q?" in complaints[0], complaints


def test_an_error_of_our_own_is_one_line_that_names_a_file_with_the_details(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: RunOptions, name: str) -> None:
        raise LookupError("deep\ninside") from ValueError("no letter: \udcff")

    monkeypatch.setattr(RunOptions, "scenario", broken)
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    code, complaints = typed(["config", "quick"], capsys)
    assert code == 1 and len(complaints) == 1
    assert complaints[0].startswith("covey: an error of Covey's own: LookupError: deep inside; details are in ")
    details = Path(complaints[0].rpartition(" ")[2]).read_text(encoding="utf-8")
    assert "in broken" in details and "no letter: \\udcff" in details
    monkeypatch.setenv("COVEY_DEBUG", "1")
    with pytest.raises(LookupError):
        typed(["config", "quick"], capsys)


def test_there_are_a_hundred_rows_and_more() -> None:
    assert len(TYPED) >= 100
