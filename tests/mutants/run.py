"""Planted defects, one at a time: each must be noticed by fast tests.

    ./covey test --mutants             all of table.toml
    ./covey test --mutants 12 clutter  number 12, and all whose names hold "clutter"

A mutant is planted in a copy of the tree, and the tests that the table names are run there, fast ones only. A failing test kills it. A
test that hangs does not: `LIMIT` is a survivor with a name. Mutants of files that compiled loops are made of run the loops as plain
Python, so that nothing is compiled.
"""

import hashlib
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from agents.compiled.cache import HERE, SOURCES, folder

ROOT = Path(__file__).resolve().parents[2]
TABLE = Path(__file__).parent / "table.toml"
GOLDEN = "tests/golden/test_golden.py::test_some_runs_are_those_of_the_golden_record"
LIMIT = 180.0  # s for the tests of one mutant
ALL_LIMIT = 3600.0  # s for all of them, once, without a mutant
FAILED = 1  # pytest's exit code when a test failed; others mean that nothing was tested


class Edit(NamedTuple):
    """A text that stands in a file once, and what takes its place."""

    file: str
    old: str
    new: str


class Mutant(NamedTuple):
    """A planted defect."""

    number: int
    name: str
    means: str
    edits: tuple[Edit, ...]
    tests: tuple[str, ...]  # of which one must fail

    @property
    def plain(self) -> bool:
        """Whether it changes what compiled loops are made of."""
        made_of = {path.relative_to(ROOT).as_posix() for pattern in SOURCES for path in ROOT.glob(pattern)}
        return any(edit.file in made_of for edit in self.edits)


class Verdict(NamedTuple):
    """What became of a mutant."""

    mutant: Mutant
    what: str  # killed, SURVIVED, TIMEOUT or ERROR
    seconds: float
    text: str  # the test that failed, or what went wrong


def read_table() -> list[Mutant]:
    """All mutants of the table."""
    found = []
    for number, row in enumerate(tomllib.loads(TABLE.read_text())["mutant"], start=1):
        edits = tuple(Edit(edit["file"], edit["old"], edit["new"]) for edit in (row, *row.get("also", ())))
        tests = (*row.get("tests", ()), *(f"{GOLDEN}[{case}]" for case in row.get("golden", ())))
        found.append(Mutant(number, row["name"], row["means"], edits, tests))
    return found


def chosen(mutants: Sequence[Mutant], words: Sequence[str]) -> list[Mutant]:
    """Those that a word names: by number, or by a part of the name; without words all."""
    numbers, parts = {int(word) for word in words if word.isdecimal()}, [word for word in words if not word.isdecimal()]
    return [one for one in mutants if not words or one.number in numbers or any(part in one.name for part in parts)]


def planted(edit: Edit, root: Path = ROOT) -> str:
    """The text of a file with the defect in it; raises ValueError when the old text does not stand there just once."""
    text = (root / edit.file).read_text()
    if text.count(edit.old) != 1:
        raise ValueError(f"{edit.file}: the old text stands there {text.count(edit.old)} times, should be once: {edit.old!r}")
    return text.replace(edit.old, edit.new)


def copy_tree(target: Path) -> None:
    """The files of the tree as they are now, and the compiled loops under the name that numba gives them there."""
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "-z"], cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout
    for name in filter(None, listed.decode().split("\0")):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)  # with the time of its change, by which numba knows it
    compiled = folder() / _numba_name(HERE)
    if compiled.is_dir():
        there = target / ".loops" / "covey" / folder().name / _numba_name(target / HERE.relative_to(ROOT))
        shutil.copytree(compiled, there)


def _numba_name(path: Path) -> str:
    """The folder in which numba keeps what it has compiled of the files in a folder."""
    return f"{path.name}_{hashlib.sha1(str(path).encode()).hexdigest()}"


def run_tests(copy: Path, tests: Sequence[str], *, plain: bool, limit: float) -> tuple[int | None, str]:
    """Exit code and output of pytest in a copy; None: it took too long. The slow tests of whole files are left out."""
    marks = [] if all("::" in test for test in tests) else ["-m", "not slow"]
    command = [sys.executable, "-m", "pytest", "-x", "-n", "0", *marks, "--timeout=0", "--tb=line", "-W", "ignore", *tests]
    environment = {**os.environ, "PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(copy / ".loops")}
    environment |= {"NUMBA_DISABLE_JIT": "1"} if plain else {}
    with subprocess.Popen(
        command, cwd=copy, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    ) as process:
        try:
            output, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.communicate()
            return None, ""
    return process.returncode, output


def judge(mutant: Mutant, copy: Path) -> Verdict:
    """Plant a mutant in a copy, run its tests, and put everything right again."""
    began = time.monotonic()
    try:
        texts = {edit.file: planted(edit, copy) for edit in mutant.edits}
    except ValueError as error:
        return Verdict(mutant, "ERROR", 0.0, str(error))
    before = {file: (copy / file).read_text() for file in texts}
    stats = {file: (copy / file).stat() for file in texts}
    for file, text in texts.items():
        (copy / file).write_text(text)
    try:
        code, output = run_tests(copy, mutant.tests, plain=mutant.plain, limit=LIMIT)
    finally:
        for file, text in before.items():
            (copy / file).write_text(text)
            os.utime(copy / file, ns=(stats[file].st_atime_ns, stats[file].st_mtime_ns))
    seconds = time.monotonic() - began
    if code is None:
        return Verdict(mutant, "TIMEOUT", seconds, f"nothing failed within {LIMIT:g} s")
    failed = [line.removeprefix("FAILED ").split(" - ")[0] for line in output.splitlines() if line.startswith("FAILED ")]
    if code == FAILED and failed:
        return Verdict(mutant, "killed", seconds, failed[0])
    if code == 0:
        return Verdict(mutant, "SURVIVED", seconds, mutant.means)
    return Verdict(mutant, "ERROR", seconds, f"pytest ended with {code}: " + " | ".join(output.strip().splitlines()[-4:]))


@contextmanager
def copies(number: int) -> Iterator[queue.SimpleQueue[Path]]:
    """Copies of the tree, to be taken and given back."""
    with tempfile.TemporaryDirectory(prefix="covey-mutants-") as base:
        ready: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for place in range(number):
            copy = Path(base).resolve() / f"copy{place}"
            copy_tree(copy)
            ready.put(copy)
        yield ready


def sound(mutants: Sequence[Mutant], ready: "queue.SimpleQueue[Path]") -> str:
    """What fails without any mutant; empty: nothing. A mutant could not be told from that."""
    for plain in (False, True):
        tests = list(dict.fromkeys(test for mutant in mutants if mutant.plain == plain for test in mutant.tests))
        if tests:
            copy = ready.get()
            code, output = run_tests(copy, tests, plain=plain, limit=ALL_LIMIT)
            ready.put(copy)
            if code != 0:
                return output or f"the tests took more than {ALL_LIMIT:g} s"
    return ""


def run(mutants: Sequence[Mutant], jobs: int) -> list[Verdict]:
    """Judge mutants side by side, a line for each."""
    verdicts = []
    with copies(jobs) as ready, ThreadPoolExecutor(jobs) as pool:

        def one(mutant: Mutant) -> Verdict:
            copy = ready.get()
            try:
                return judge(mutant, copy)
            finally:
                ready.put(copy)

        if trouble := sound(mutants, ready):
            raise SystemExit(f"{trouble}\nthese tests fail without any mutant")
        for done, future in enumerate(as_completed([pool.submit(one, mutant) for mutant in mutants]), start=1):
            verdict = future.result()
            verdicts.append(verdict)
            number, name = verdict.mutant.number, verdict.mutant.name
            print(f"{done}/{len(mutants)} {verdict.what} {number} {name} ({verdict.seconds:.1f} s): {verdict.text}", flush=True)
    return verdicts


def main(words: Sequence[str]) -> int:
    """The command; the number of mutants that were not killed, 1 at most."""
    mutants = chosen(read_table(), words)
    if not mutants:
        print(f"no mutant is called {' or '.join(words)}; see {TABLE.relative_to(ROOT)}")
        return 2
    began = time.monotonic()
    verdicts = run(mutants, min(len(os.sched_getaffinity(0)), len(mutants)))
    alive = sorted(verdict for verdict in verdicts if verdict.what != "killed")
    for verdict in alive:
        print(f"{verdict.what} {verdict.mutant.number} {verdict.mutant.name}: {verdict.text}")
    print(f"{len(verdicts) - len(alive)} of {len(verdicts)} mutants killed in {(time.monotonic() - began) / 60.0:.1f} min")
    return min(1, len(alive))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
