"""The table of mutants is in order, its runner tells the killed from the rest, and (nightly) every mutant is killed."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from agents.compiled.cache import loops_on_disk
from tests.golden.test_golden import QUICK
from tests.mutants import run
from tests.mutants.run import GOLDEN, ROOT, Edit, Mutant, chosen, judge, planted, read_table

TABLE = read_table()
LEAST = 200


def slow_tests(file: str) -> set[str]:
    """The tests of a file that are slow whatever their parameters: the runner leaves them out, unless a row names single tests alone."""
    marked = re.findall(r"^@pytest\.mark\.slow\n(?:^[@ \])].*\n)*?^def (test_\w+)", (ROOT / file).read_text(), re.MULTILINE)
    return set(marked)


def test_every_mutant_can_be_planted_and_names_tests_that_exist_and_are_run() -> None:
    for mutant in TABLE:
        assert mutant.tests, f"{mutant.name}: no test"
        assert len({edit.file for edit in mutant.edits}) == len(mutant.edits), (
            f"{mutant.name}: of two edits of one file the last one counts"
        )
        for edit in mutant.edits:
            assert planted(edit) != (ROOT / edit.file).read_text(), f"{mutant.name}: changes nothing"
        are_single = all("::" in test for test in mutant.tests)
        for test in mutant.tests:
            file, _, name = test.partition("::")
            assert (ROOT / file).is_file(), f"{mutant.name}: there is no {file}"
            assert f"def {name.partition('[')[0]}" in (ROOT / file).read_text(), f"{mutant.name}: there is no {test}"
            is_played = not test.startswith(GOLDEN) or test.removeprefix(GOLDEN).strip("[]") in QUICK
            assert is_played, f"{mutant.name}: {test} is no quick case, and is played by no such test"
            all_slow = re.search(r"^pytestmark = .*mark\.slow", (ROOT / file).read_text(), re.MULTILINE)
            assert are_single or not (all_slow or name.partition("[")[0] in slow_tests(file)), f"{mutant.name}: {test} is slow"


def undefined_names(folder: Path, texts: dict[str, str]) -> list[str]:
    """What ruff says of Python texts, by the names of their files: names that nothing defines, and what is no Python at all."""
    for name, text in texts.items():
        (folder / name).write_text(text)
    ruff = [sys.executable, "-m", "ruff", "check", "--isolated", "--no-cache", "--quiet", "--select=F821", "--output-format=concise", "."]
    return subprocess.run(ruff, cwd=folder, capture_output=True, text=True, check=False).stdout.splitlines()


def test_no_mutant_is_a_name_that_nothing_defines(tmp_path: Path) -> None:
    """Any test that comes by it would kill it, whatever it checks."""
    edits = {f"{mutant.number}-{place}.py": (mutant, edit) for mutant in TABLE for place, edit in enumerate(mutant.edits)}
    texts = {name: planted(edit) for name, (_, edit) in edits.items() if edit.file.endswith(".py")}
    assert len(texts) > LEAST
    found = [f"{edits[line.partition(':')[0]][0].name}: {line}" for line in undefined_names(tmp_path, texts)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("wrong", ["def f(x):\n    return y\n", "def f(x:\n    return x\n"])
def test_a_name_that_nothing_defines_and_what_is_no_python_are_found(tmp_path: Path, wrong: str) -> None:
    lines = undefined_names(tmp_path, {"good.py": "import math\n\n\ndef f(x):\n    return math.exp(x)\n", "bad.py": wrong})
    assert lines and all(line.startswith("bad.py:") for line in lines)


def test_mutants_have_names_of_their_own_and_are_many() -> None:
    names = [mutant.name for mutant in TABLE]
    assert len(set(names)) == len(names) >= LEAST


def test_a_copy_has_the_compiled_loops_of_the_tree(tmp_path: Path) -> None:
    """Else each copy compiles them within the time of its first mutant. Other tests may compile loops meanwhile."""
    cut = "import numpy as np; a = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])\n"
    cut += "from agents.compiled.cell_kernels import cut_cells; cut_cells(np.array([0]), a, np.ones(4), a)\n"
    exec(cut)  # the loop that the copy shall find, in a tree that has compiled little so far
    copy, before = tmp_path.resolve() / "copy", loops_on_disk()
    run.copy_tree(copy)
    after = loops_on_disk()
    program = cut + "from agents.compiled.cache import loops_on_disk; print(loops_on_disk(), sum(cut_cells.stats.cache_hits.values()))"
    variables = {**os.environ, "PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(copy / ".loops")}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=copy, env=variables, capture_output=True, text=True, timeout=110, check=False
    )
    assert done.stdout, done.stderr
    loops, hits = map(int, done.stdout.split())
    assert 1 <= before <= loops <= after and hits == 1


def test_a_text_that_has_gone_is_an_error_that_says_so(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("x = 1\nx = 1\n")
    for old, times in (("y = 1", 0), ("x = 1", 2)):
        with pytest.raises(ValueError, match=f"a.py: the old text stands there {times} times"):
            planted(Edit("a.py", old, "z"), tmp_path)


def test_mutants_are_chosen_by_number_or_by_a_part_of_the_name() -> None:
    assert [mutant.number for mutant in chosen(TABLE, ["2", TABLE[0].name])] == [1, 2]
    assert chosen(TABLE, []) == TABLE and chosen(TABLE, ["no such mutant"]) == []


@pytest.mark.parametrize(
    ("test", "what"),
    [
        ("assert double(2) == 4", "killed"),
        ("assert double(0) == 0", "SURVIVED"),
        ("import no_such_module", "killed"),
        ("import time; time.sleep(60)", "TIMEOUT"),
    ],
)
def test_a_mutant_is_killed_by_a_failing_test_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, test: str, what: str) -> None:
    if what == "TIMEOUT":
        monkeypatch.setattr(run, "LIMIT", 2.0)
    (tmp_path / "doubling.py").write_text("def double(x):\n    return 2 * x\n")
    (tmp_path / "test_it.py").write_text(f"from doubling import double\n\ndef test_it():\n    {test}\n")
    (tmp_path / "pyproject.toml").write_text('[tool.pytest.ini_options]\npythonpath = ["."]\nmarkers = ["slow"]\n')
    mutant = Mutant(1, "triple", "it triples", (Edit("doubling.py", "2 * x", "3 * x"),), ("test_it.py",))
    assert judge(mutant, tmp_path).what == what
    assert (tmp_path / "doubling.py").read_text() == "def double(x):\n    return 2 * x\n"


def test_a_test_that_cannot_even_be_read_kills_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("x = 1\n")
    (tmp_path / "test_it.py").write_text("from a import y\n")
    (tmp_path / "pyproject.toml").write_text('[tool.pytest.ini_options]\npythonpath = ["."]\nmarkers = ["slow"]\n')
    assert judge(Mutant(1, "two", "two", (Edit("a.py", "1", "2"),), ("test_it.py",)), tmp_path).what == "ERROR"


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_every_mutant_is_killed() -> None:
    done = subprocess.run([sys.executable, "-m", "tests.mutants.run"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
