"""What is compiled and kept on disk is never older than its source."""

import ast
import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from agents.compiled import cache
from agents.compiled.cache import HERE, SOURCES
from protocol.settings import BadSetting

ROOT = HERE.parents[1]
INNER = """
from numba import njit

@njit
def inner(x):
    return x + 1.0
"""
OUTER = """
from agents.compiled.inner_kernels import inner
from agents.compiled.cache import cached

@cached
def outer(x):
    return 2.0 * inner(x)
"""
PROGRAM = """
from agents.compiled.outer_kernels import outer
print(outer(3.0), sum(outer.stats.cache_hits.values()), outer.stats.cache_path)
"""


def environment() -> dict[str, str]:
    """Of a process that reads the sources of the test anew: Python takes bytecode for current if a source changes within a second."""
    return {**{name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}, "PYTHONDONTWRITEBYTECODE": "1"}


def run(place: Path) -> tuple[float, int, Path]:
    """What the outer loop of a small package makes of 3, how often it was on disk, and where that is."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=place, env=environment(), capture_output=True, text=True, timeout=110, check=False
    )
    assert done.returncode == 0, done.stderr
    found, hits, path = done.stdout.split()
    return float(found), int(hits), Path(path)


@pytest.mark.slow
def test_a_loop_is_compiled_anew_when_one_that_it_calls_in_another_file_changes(tmp_path: Path) -> None:
    package = tmp_path / "agents" / "compiled"
    package.mkdir(parents=True)
    (package.parent / "__init__.py").touch()
    shutil.copy(HERE / "cache.py", package)
    (package / "__init__.py").touch()
    (package / "outer_kernels.py").write_text(OUTER)
    source = package / "inner_kernels.py"
    source.write_text(INNER)
    assert run(tmp_path)[:2] == (8.0, 0)
    found, hits, path = run(tmp_path)
    assert (found, hits) == (8.0, 1) and path.is_relative_to(package / "__pycache__")
    source.write_text(INNER.replace("x + 1.0", "x + 2.0"))
    assert run(tmp_path)[:2] == (10.0, 0)
    source.write_text(INNER)
    assert run(tmp_path)[:2] == (8.0, 1)  # as before


@pytest.mark.slow
@pytest.mark.nightly
def test_a_process_that_has_compiled_a_loop_keeps_it_when_no_other_does(tmp_path: Path) -> None:
    package = tmp_path / "agents" / "compiled"
    package.mkdir(parents=True)
    (package.parent / "__init__.py").touch()
    shutil.copy(HERE / "cache.py", package)
    (package / "__init__.py").touch()
    (package / "outer_kernels.py").write_text(OUTER)
    (package / "inner_kernels.py").write_text(INNER)
    place = run(tmp_path)[2].parent
    (package / "inner_kernels.py").write_text(INNER.replace("1.0", "3.0"))
    place = place.with_name(folder_of(tmp_path))
    place.mkdir()
    held = os.open(place, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    try:
        with subprocess.Popen([sys.executable, "-c", PROGRAM], cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, text=True) as other:
            with pytest.raises(subprocess.TimeoutExpired):
                other.wait(5.0)
            assert not list(place.glob("*/*.nb?"))
            os.close(held)
            held = -1
            assert other.communicate(timeout=110)[0].startswith("12.0 0 ")
        assert len(list(place.glob("*/*.nb?"))) == 2
    finally:
        if held >= 0:
            os.close(held)


def folder_of(place: Path) -> str:
    """The name of the folder for the loops of a small package."""
    program = "from agents.compiled.cache import folder; print(folder().name)"
    return subprocess.run(
        [sys.executable, "-c", program], cwd=place, capture_output=True, text=True, timeout=110, check=True
    ).stdout.strip()


def test_where_the_sources_cannot_be_written_loops_lie_in_the_folder_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "HERE", tmp_path / "installed")
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    assert cache._base() == tmp_path / "user" / "covey"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "chosen"))
    assert cache._base() == tmp_path / "chosen" / "covey"
    (tmp_path / "installed").mkdir()
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert cache._base() == tmp_path / "installed" / "__pycache__"


def test_loops_are_complete_when_a_process_that_compiled_all_has_said_so_and_not_when_there_are_enough_or_too_few(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, "folder", lambda: tmp_path)
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    assert not cache.compiled_before(), "nothing is on disk"
    (tmp_path / "agents").mkdir()
    for number in range(cache.number_of_loops()):
        (tmp_path / "agents" / f"loop{number}.nbi").touch()
    assert not cache.compiled_before(), "somebody may still be compiling"
    (tmp_path / "agents" / "loop0.nbi").unlink()
    cache.note_complete()
    assert cache.compiled_before()


def test_another_python_or_another_numba_or_python_without_docstrings_has_loops_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    mine, folders = cache.folder.__wrapped__, []
    assert mine() == cache.folder()
    with monkeypatch.context() as other:
        other.setattr(sys.implementation, "cache_tag", "cpython-399")
        folders.append(mine())
    with monkeypatch.context() as other:
        other.setattr(cache.metadata, "version", lambda package: f"9.9 of {package}")
        folders.append(mine())
    with monkeypatch.context() as other:
        other.setattr(cache, "sys", SimpleNamespace(implementation=sys.implementation, flags=SimpleNamespace(optimize=2)))
        folders.append(mine())
    assert len({cache.folder(), *folders}) == 4


def test_old_loops_are_removed_but_the_newest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "kernels-now")
    for age, name in enumerate(("now", "a", "b", "c", "d", "e")):
        (tmp_path / f"kernels-{name}").mkdir()
        (tmp_path / f"kernels-{name}" / "loop.nbi").touch()
        os.utime(tmp_path / f"kernels-{name}", (1e9 - age, 1e9 - age))
    os.utime(tmp_path / "kernels-now", (1e8, 1e8))
    (tmp_path / "other").mkdir()
    cache.tidy()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kernels-a", "kernels-b", "kernels-c", "kernels-now", "other"]


def test_compiled_loops_are_made_of_nothing_but_what_their_folder_is_named_after() -> None:
    sources = {path for pattern in SOURCES for path in ROOT.glob(pattern)}
    compiled = [path for path in sources if path.match("*kernels.py")]
    assert len(compiled) == len(list((ROOT / "agents").rglob("*kernels.py"))) >= 9
    imported = {HERE / "cache.py"}
    for path in compiled:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] in ("agents", "protocol"):
                place = ROOT / node.module.replace(".", "/")
                files = {place / f"{alias.name}.py" for alias in node.names} if place.is_dir() else {place.with_suffix(".py")}
                assert files <= sources | {HERE / "cache.py"}, f"{path.name} imports {node.module}"
                imported |= files
    assert sources <= imported | {*compiled}, "a source on which no loop depends"


def test_every_loop_with_a_cache_is_kept_there() -> None:
    for path in HERE.glob("*.py"):
        assert "cache=True" not in path.read_text() or path.name == "cache.py"


def test_without_the_compiler_the_loops_run_as_plain_python() -> None:
    """The mutants of `tests/mutants` need it: nothing has to be compiled to see what a planted defect does."""
    program = "from agents.compiled.cell_kernels import cut_cells; print(type(cut_cells).__name__)"
    variables = {**environment(), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, env=variables, capture_output=True, text=True, timeout=110, check=False
    )
    assert done.stdout == "function\n", done.stderr


def test_without_the_compiler_hashes_overflow_without_a_warning() -> None:
    """Each agent wrote warnings of numpy into its log."""
    program = "from agents.compiled.birth_kernels import background; import numpy as np; "
    program += "print(background(2, 2, np.uint64(7), 10.0, 10.0, 1.0, np.zeros((4096, 2)))[0].shape)"
    variables = {**environment(), "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-W", "error::RuntimeWarning", "-c", program]
    done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True, timeout=110, check=False)
    assert done.stdout == "(2, 4)\n", done.stderr


def test_loops_that_cannot_be_kept_are_told_where_and_not_in_the_words_of_numba(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The user of an installation that belongs to another one, without a home that can be written."""

    def njit(**_: object) -> None:
        raise RuntimeError("cannot cache function 'loop': no locator available")

    (tmp_path / "file").touch()
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "file" / "kernels")
    monkeypatch.setattr("numba.njit", njit)
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    with pytest.raises(BadSetting, match=r"file: compiled loops cannot be kept there: Not a directory; NUMBA_CACHE_DIR names another"):
        cache.cached(lambda: None)


def test_a_damaged_file_of_the_cache_is_forgotten_and_its_loop_compiled_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a loss of power leaves it: each agent died of an EOFError."""
    flushed: list[str] = []

    def load(*_: object) -> None:
        raise EOFError("Ran out of input")

    kept = SimpleNamespace(load_overload=load, save_overload=None, flush=lambda: flushed.append("flushed"))
    monkeypatch.setattr(cache, "folder", lambda: tmp_path)
    monkeypatch.setattr("numba.njit", lambda **_: lambda loop: SimpleNamespace(_cache=kept))
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    assert cache.cached(lambda: None)._cache.load_overload("signature", "target") is None
    assert flushed == ["flushed"]
