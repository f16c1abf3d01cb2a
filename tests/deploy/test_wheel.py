"""The wheel: one package, `covey`, that lives beside another's `agents` and does what the checkout does."""

import ast
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

from deploy.wheel import ROOMS, rewritten

ROOT = Path(__file__).resolve().parents[2]
BUILD = "import sys; from setuptools.build_meta import build_wheel; build_wheel(sys.argv[1])"
BUILD_SDIST = "import sys; from setuptools.build_meta import build_sdist; build_sdist(sys.argv[1])"
PARTS = ("pyproject.toml", "README.md", "LICENSE", *ROOMS)
STRANGER = "class Runner: ...\n"  # what the folder `agents` of site-packages holds when openai-agents is installed
WARM = "from covey.agents.compiled.warmup import warm; warm()"
PLAIN = "NUMBA_DISABLE_JIT"  # the loops run as plain Python
BOTH = "import agents, covey, covey.agents.agent; assert agents.Runner; print(covey.__file__)"


def test_imports_of_rooms_go_below_covey_and_nothing_else_changes() -> None:
    source = '"""from agents import x"""\nfrom agents.agent import a\ndef f():\n    é = 1; from protocol import (\n        b,\n    )\n'
    wanted = source.replace("\nfrom agents", "\nfrom covey.agents").replace("; from protocol", "; from covey.protocol")
    assert rewritten(source) == wanted
    assert (
        rewritten("import worldly\nfrom agents_of import x\nfrom . import agents\n")
        == "import worldly\nfrom agents_of import x\nfrom . import agents\n"
    )


@pytest.mark.parametrize("line", ["import agents", "import protocol.codec", "import numpy, world.score"])
def test_an_import_that_would_bind_another_name_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match="line 1: should read `from"):
        rewritten(line + "\n")


@pytest.mark.slow
def test_every_module_can_be_rewritten_line_by_line() -> None:
    for path in (path for room in ROOMS for path in (ROOT / room).rglob("*.py")):
        before = path.read_text(encoding="utf-8")
        after = rewritten(before)
        modules = [node.module or "" for node in ast.walk(ast.parse(after)) if isinstance(node, ast.ImportFrom)]
        assert not [module for module in modules if module.partition(".")[0] in ROOMS], path
        assert after.replace("from covey.", "from ") == before.replace("from covey.", "from "), path


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout, built in a copy of it."""
    copy = tmp_path_factory.mktemp("copy")
    for part in PARTS:
        if (ROOT / part).is_dir():
            shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(ROOT / part, copy / part)
    done = subprocess.run([sys.executable, "-c", BUILD, str(copy)], cwd=copy, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    return next(copy.glob("*.whl"))


@pytest.fixture(scope="module")
def home(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment with the wheel and a stranger's `agents`, and this environment's packages behind them."""
    home = tmp_path_factory.mktemp("home")
    uv, python = shutil.which("uv"), str(home / "bin" / "python")
    install = [uv, "pip", "install", "--python", python] if uv else [sys.executable, "-m", "pip", "--python", python, "install"]
    subprocess.run(
        [uv, "venv", "--clear", "--python", sys.executable, home] if uv else [sys.executable, "-m", "venv", "--without-pip", home],
        check=True,
    )
    subprocess.run([*install, "-q", "--no-deps", "--no-index", str(wheel)], check=True)
    packages = next((home / "lib").glob("python3*")) / "site-packages"
    (packages / "agents").mkdir()
    (packages / "agents" / "__init__.py").write_text(STRANGER)
    (packages / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return home


def run(home: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """A program of the environment, run in a folder of the user's."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "COVEY", "NUMBA")) or name == PLAIN}
    command = [str(home / "bin" / words[0]), *words[1:]]
    return subprocess.run(command, cwd=folder, env=kept, capture_output=True, text=True, timeout=400, check=False)


@pytest.mark.slow
def test_a_wheel_holds_one_package_and_all_its_data(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"covey"}
    assert not any(name.startswith("covey/deploy/interface") for name in names)
    files = [path.relative_to(ROOT).as_posix() for room in ROOMS for path in (ROOT / room).rglob("*") if path.is_file()]
    files = [file for file in files if "__pycache__" not in file and not file.endswith(".mcap")]
    wanted = {f"covey/{file.removeprefix('deploy/interface/covey/')}" for file in files}
    assert wanted <= set(names), "pyproject.toml, tool.setuptools: packages and package-data"


@pytest.mark.slow
def test_a_wheel_that_is_built_from_the_sdist_holds_the_same_files_to_the_byte(wheel: Path, tmp_path: Path) -> None:
    """The sdist is made in the copy that the wheel was built in, and unpacked where nothing else is."""
    done = subprocess.run(
        [sys.executable, "-c", BUILD_SDIST, str(tmp_path)], cwd=wheel.parent, capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stderr
    [archive] = tmp_path.glob("covey-*.tar.gz")
    with tarfile.open(archive) as packed:
        packed.extractall(tmp_path, filter="data")
    source = tmp_path / archive.name.removesuffix(".tar.gz")
    done = subprocess.run(
        [sys.executable, "-c", BUILD, str(tmp_path)], cwd=source, capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stderr
    [again] = tmp_path.glob("*.whl")
    assert contents(again) == contents(wheel)


def contents(wheel: Path) -> dict[str, bytes]:
    """The files of a wheel."""
    with zipfile.ZipFile(wheel) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("plain", ["1", pytest.param("", marks=pytest.mark.nightly)], ids=["plain", "compiled"])
def test_the_installed_program_simulates_what_the_checkout_simulates_and_demonstrates_it(
    plain: str, home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compiling takes longer than all the rest. The checkout's loops are compiled in any case."""
    monkeypatch.delenv(PLAIN, raising=False)
    both = run(home, tmp_path, "python", "-c", BOTH)
    assert Path(both.stdout.strip()).is_relative_to(home), both.stderr
    words = ("simulate", "anisotropic", "--seconds", "1", "--json")
    ours = subprocess.run([sys.executable, ROOT / "covey", *words], cwd=tmp_path, capture_output=True, text=True, timeout=200, check=True)
    monkeypatch.setenv(PLAIN, plain)
    if not plain:
        assert run(home, tmp_path, "python", "-c", WARM).returncode == 0  # compile first, for a demo is shorter than that
    theirs = run(home, tmp_path, "covey", *words)
    assert theirs.returncode == 0, theirs.stderr
    one_line = run(home, tmp_path, "python", "-c", "import covey; print(covey.simulate('quick', seconds=1).ospa.mean())")
    assert float(one_line.stdout) > 0.0, one_line.stderr
    results = [json.loads(done.stdout.splitlines()[-1]) for done in (theirs, ours)]
    assert results[0]["transcript"] == results[1]["transcript"]
    demo = run(home, tmp_path, "covey", "demo", "--no-page", "--team", "A4", "--seconds", "2", "--lockstep", "--json")
    assert demo.returncode == 0, demo.stderr
    assert json.loads(demo.stdout.splitlines()[-1])["rounds"] >= 4 * 5
    detached = run(home, tmp_path, "covey", "up", "quick", "--detach", "--spawn", "exec", "--run", "away")
    assert detached.returncode == 0, detached.stderr
    assert run(home, tmp_path, "covey", "down", "--run", "away").returncode == 0
