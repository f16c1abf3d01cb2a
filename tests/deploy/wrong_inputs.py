"""A folder of a user's with wrong files in it, and what a command complains about, for the tests of bad input."""

import sys
from pathlib import Path

import pytest

from deploy.__main__ import app
from deploy.cli.errors import guarded
from deploy.scenario import agent_config, resolve, toml_text

AGENTS = toml_text(agent_config(resolve("quick")))
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
    "nobody.toml": b"[[faults]]\nat = 3.0\nverb = 'kill'\n",
    "body.toml": b"[team]\ncomposition = '2A'\n[[faults]]\nat = 3.0\nverb = 'kill'\nwho = 's1.body'\n",
    "strong.toml": b"[[faults]]\nat = 3.0\nverb = 'kill'\nwho = 's1'\nvalue = 2.0\n",
    "again.toml": b"[[faults]]\nat = 3.0\nverb = 'join'\nwho = 's1'\noptions = {class = 'A'}\n",
    "joins.toml": b"[[faults]]\nat = 3.0\nverb = 'join'\noptions = {class = 'A'}\n"
    b"[[faults]]\nat = 4.0\nverb = 'join'\nwho = 'guest0'\noptions = {class = 'A'}\n",
    "blank.toml": b"[[faults]]\nat = 3.0\nverb = 'join'\nwho = 'a b'\noptions = {class = 'A'}\n",
    "newclass.toml": b"[[faults]]\nat = 3.0\nverb = 'join'\noptions = {class = 'Q'}\n",
    "idle.toml": b"[sensors.X]\nangle = 90.0\n",
    "mixed.toml": b"[sensors.X]\nmodel = 'covey.examples.sensors:RangeFalling'\nangle = 90.0\n",
    "wedge.toml": b"[sensors.A]\nparameters = {far = 1}\n",
    "ray.toml": b"[sensors.A]\nmeasures = 'bearing'\n",
    "far.toml": b"[sensors.A]\nmeasures = 'bearing'\nbearing_noise = 2.0\nrange_noise = 1.0\n",
    "beam.toml": b"[sensors.A]\nmeasures = 'bearing'\nbearing_noise = 2.0\nradius = 1000.0\n",
    "suffix.toml": b"[sensors.A]\nmodel = 'mine.py:Camera'\n",
    "dash.toml": b"[sensors.cam-1]\nangle = 90.0\nradius = 5.0\n[team]\ncomposition = '2cam-1'\n",
    "robot.toml": b"[bodies]\nhost = 'own'\nplatform = 'no_such_lab:Robot'\n",
    "port.toml": b"[bodies]\nhost = 'own'\nplatform = 'covey.examples.robots:DifferentialDrive'\nparameters = {port = '/dev/ttyUSB0'}\n",
    "team.toml": b"[team]\ncomposition = '2A'\n[members]\na = 'A'\n",
    "few.toml": b"[team]\ncomposition = '4A'\n[[faults]]\nat = 1.0\nverb = 'kill'\nwho = '3'\n"
    b"[[faults]]\nat = 2.0\nverb = 'kill'\nwho = '2'\n",
    "agents.toml": AGENTS.encode(),
    "scalar.toml": f"run = 5\n{AGENTS[AGENTS.index('[arena]') :]}".encode(),
    "strangers.toml": toml_text(agent_config(resolve("quick", {"timing.interest": "neighbours"}))).encode(),
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
