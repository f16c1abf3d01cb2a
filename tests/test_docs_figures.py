"""The pages and what they name: every command exists with its options, so does every test, and cheap figures are computed again.

Commands are not run here but for those of the last table of docs/evidence/figures.md; the real command line reads each of them.
"""

import datetime
import functools
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from cyclopts import CycloptsError, MissingArgumentError

from deploy.__main__ import app
from deploy.bench.__main__ import BENCHES
from deploy.cli.options import RunOptions
from deploy.scenario import FOLDER, parse_set
from deploy.studies.bodies import MODELS
from deploy.studies.bodies import plan as plan_of_bodies
from deploy.studies.design import design_fields, design_with, dotted_options
from deploy.studies.trials import check_method
from protocol.settings import BadSetting
from tests import reference
from tests.docs import blocks_of

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FIGURES = ROOT / "docs" / "evidence" / "figures.md"
MEASURED = ("paper.md", "promises.md")  # pages whose figures are dated in docs/evidence/figures.md; tables of the others say it in each row
REVISION = re.compile(r"`([0-9a-f]{7}|[0-9a-f]{12})`")
STANDS_FOR = {"S": "100", "NAME": "efficacy", "RUN": "hunt", "KEY": "truth"}  # words that a reader fills in
SCENARIOS = {file.stem for file in FOLDER.glob("*.toml")}


class Command(NamedTuple):
    """A command of a page, without its program."""

    page: str
    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.page}: covey {' '.join(self.words)}"


def spans(text: str) -> list[str]:
    """What stands between backticks within a paragraph or a cell, and the lines of blocks."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    prose = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    indented = re.findall(r"^ {4}(\S.*)$", prose, re.MULTILINE)
    return [*(line for block in blocks for line in block.splitlines()), *indented, *re.findall(r"`([^`]+)`", prose)]


def words_of(span: str) -> tuple[str, ...] | None:
    """The words of a `covey` command; None for anything else."""
    said = re.split(r"\s+\| |  +|\s#\s", " ".join(span.split("\n")).strip())[0]
    match = re.fullmatch(r"(?:\./)?covey (\S.*)", said)
    return tuple(STANDS_FOR.get(word, word) for word in shlex.split(match[1].partition(" > ")[0])) if match else None


def commands() -> list[Command]:
    """Every `covey` command of every page, once for each page."""
    pages = [page for page in PAGES if page.name not in reference.PAGES]  # those are made from the command line itself
    found = [Command(page.name, words) for page in pages for span in spans(page.read_text()) if (words := words_of(span))]
    return list(dict.fromkeys(found))


COMMANDS = commands()
OWN = [command for command in COMMANDS if command.words[0] != "test"]


def complaint(words: tuple[str, ...]) -> str:
    """What the real command line finds wrong with a command; empty: nothing."""
    try:
        called, bound, _ = app.parse_args(list(words), print_error=False, exit_on_error=False)
    except MissingArgumentError as error:
        return str(error) if len(words) > 1 else ""  # a bare name in a sentence
    except CycloptsError as error:
        return str(error)
    given = bound.arguments
    try:
        if called.__name__ == "study":
            check_study(given)
        elif called.__name__ == "bench" and given.get("what", "all") not in (*BENCHES, "all"):
            return f"no benchmark is called {given['what']}"
        elif isinstance(given.get("options"), RunOptions) and given["options"].data is not None:
            return ""  # files of the reader's own
        elif isinstance(given.get("options"), RunOptions) and given.get("scenario", "convergence") in SCENARIOS:
            given["options"].scenario(given.get("scenario", "convergence"))
    except BadSetting as error:
        return str(error)
    return ""


def check_study(given: dict[str, object]) -> None:
    """Raise BadSetting where the study, its teams, its methods or its settings do not exist."""
    options = [given.get(name) for name in ("triple", "capacity", "dt", "seconds")]
    fixed = {**dotted_options(*options), **dict(map(parse_set, given.get("settings") or []))}  # type: ignore[arg-type]
    chosen = design_fields(*[given.get(name) for name in ("trials", "seed", "teams", "targets", "methods")])  # type: ignore[arg-type]
    if given["name"] == "bodies":
        plan_of_bodies(1, 1, 60.0, chosen.get("methods", tuple(MODELS)), fixed)
    elif given["name"] != "robustness":
        for method in design_with(str(given["name"]), bool(given.get("quick")), chosen, fixed).methods:
            check_method(method)


class Row(NamedTuple):
    """A line of a table."""

    cells: tuple[str, ...]


def table(heading: str) -> list[Row]:
    """The lines of the table under a heading of docs/evidence/figures.md, without its head."""
    section = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", FIGURES.read_text(), re.MULTILINE | re.DOTALL)
    assert section, f"docs/evidence/figures.md has no section {heading!r}"
    lines = [line for line in section[1].splitlines() if line.startswith("|")][2:]
    return [Row(tuple(cell.strip() for cell in line.strip("|").split("|"))) for line in lines]


@pytest.fixture(scope="module")
def modules_of_the_pages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The Python files that the pages tell to write can be imported."""
    folder = tmp_path_factory.mktemp("pages")
    for page in PAGES:
        for block in blocks_of(page.relative_to(ROOT).as_posix()):
            if block.file.endswith(".py"):
                (folder / block.file).write_text(block.text)
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


@pytest.mark.usefixtures("modules_of_the_pages")
@pytest.mark.parametrize("command", OWN, ids=str)
def test_every_command_of_the_pages_is_one_of_the_command_line(command: Command) -> None:
    assert complaint(command.words) == "", str(command)


def test_the_pages_hold_commands_of_all_kinds_and_wrong_ones_are_found() -> None:
    assert len(OWN) > 70 and {"study", "bench", "simulate", "up", "kill", "figures"} <= {command.words[0] for command in OWN}
    wrong = ["simulat efficacy", "simulate efficacy --teem 4", "simulate efficacy --set filter.gat=3", "study eficacy", "bench rond"]
    wrong += ["study efficacy --methods pwer", "simulate efficacy --team 9Q", "kill --randm 4"]
    assert [text for text in wrong if not complaint(tuple(text.split()))] == []


def test_every_test_of_the_pages_exists() -> None:
    missing = []
    for page in PAGES:
        text = page.read_text()
        last = ""
        for path, name in re.findall(r"((?:tests/)?(?:\w+/)*test_\w+\.py)?::(test_\w+?)(?![\w.])", text):
            last = path or last
            file = next((file for file in (ROOT / last, ROOT / "tests" / last) if last and file.is_file()), None)
            if file is None or not re.search(rf"^(?:async )?def {name}\(", file.read_text(), re.MULTILINE):
                missing.append(f"{page.name}: {last}::{name}")
        for path in re.findall(r"((?:tests/)?(?:\w+/)*test_\w+\.py)", text):
            if not any(file.is_file() for file in (ROOT / path, ROOT / "tests" / path)):
                missing.append(f"{page.name}: {path}")
    assert missing == []


def test_every_measured_page_is_in_the_table_of_figures_with_a_date_a_revision_and_a_command() -> None:
    rows = table("Measured")
    for page, figure, made, revision, command in [row.cells for row in rows]:
        assert datetime.date.fromisoformat(made) <= datetime.date(2100, 1, 1), figure
        assert REVISION.fullmatch(revision), f"{figure}: {revision} is no revision"
        assert re.search(r"`[^`]+`", command), f"{figure}: no command"
        assert any(name in page for name in (*MEASURED, "README.md")), page
    assert [name for name in MEASURED if not any(name in row.cells[0] for row in rows)] == []


def test_every_row_of_evidence_that_claims_something_names_its_command_and_its_revision() -> None:
    rows, head = [], [""]
    for page in sorted((ROOT / "docs" / "evidence").glob("*.md")):
        for line in page.read_text().splitlines():
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            head = cells if line.startswith("| ") and not head[0] else head if line.startswith("|") else [""]
            if line.startswith("| ") and cells is not head and {"command", "revision"} <= set(head) and head[0].startswith("claim"):
                rows.append((page.name, dict(zip(head, cells))))
    assert len(rows) > 20
    claims = [next(iter(row.values())) for _, row in rows]
    assert [claim for claim in claims if claims.count(claim) > 1 and not claim.startswith("the same")] == []  # no figure twice
    for name, row in rows:
        assert REVISION.fullmatch(row["revision"]), (name, row)
        assert row["command"] and row.get("machine", "-") in ("E", "b", "X", "-"), (name, row)


@cache
@functools.cache
def printed(words: tuple[str, ...]) -> Any:
    """What a command prints as JSON."""
    done = subprocess.run([sys.executable, "-m", "deploy", *words], cwd=ROOT, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
@pytest.mark.parametrize("row", table("Computed again by the tests"), ids=lambda row: row.cells[0])
def test_the_cheap_figures_are_what_their_commands_print(row: Row) -> None:
    """A change of the method moves them: then the page is to be changed with it."""
    words = words_of(row.cells[0].strip("`"))
    assert words is not None
    field, figure = row.cells[1].strip("`"), row.cells[2]
    found = printed(words)
    for part in field.split("."):
        found = found[int(part) if part.isdecimal() else part]
    digits = len(figure.partition(".")[2])
    assert f"{found:.{digits}f}" == figure, f"docs/evidence/figures.md says {field} = {figure}, the command prints {found}"
