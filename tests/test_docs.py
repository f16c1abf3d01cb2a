"""README and docs/: every line as printed. What a block says is done in a temporary folder, in the order of the page."""

import re
import shlex
from collections.abc import Iterable
from pathlib import Path

import cyclopts
import pytest

from deploy.cli.app import app
from deploy.cli.commands import control, keep, look, run, setup, study  # noqa: F401 -- they add their commands
from deploy.recording.tables import SCHEMAS
from deploy.scoring.result import Result
from deploy.scoring.scores import COLUMNS
from tests import reference
from tests.docs import PAGES, ROOT, Block, Reader, blocks_of, problems

WITH_BLOCKS = [page for page in PAGES if blocks_of(page)]


@pytest.mark.parametrize("page", PAGES)
def test_every_block_of_a_page_says_what_it_is_and_every_mark_is_about_a_line(page: str) -> None:
    assert not [problem for block in blocks_of(page) for problem in problems(block)]
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), start=1):
        assert not line.startswith(("    covey ", "    ./covey ")), (
            f"{page}:{number}: commands stand in a block ```sh, so that they are tried"
        )


LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")


def prose(page: str) -> str:
    """The text of a page without its blocks."""
    return re.sub(r"^```.*?^```", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def anchors(file: Path) -> set[str]:
    """What a link may name in a page after `#`: its headings as a site and a repository show them."""
    headings = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", (*PAGES, "CHANGELOG.md"))
def test_every_link_of_a_page_leads_to_a_file_and_a_heading(page: str) -> None:
    lost = []
    for link in LINK.findall(prose(page)):
        path, _, heading = link.partition("#")
        file = (ROOT / page).parent / path if path else ROOT / page
        if not link.startswith("http") and not (file.exists() and (not heading or heading in anchors(file))):
            lost.append(link)
    assert lost == []


def test_the_index_leads_to_every_page() -> None:
    found = {(ROOT / "docs" / link.partition("#")[0]).resolve() for link in LINK.findall(prose("docs/index.md"))}
    evidence = {(ROOT / "docs/evidence" / link.partition("#")[0]).resolve() for link in LINK.findall(prose("docs/evidence/index.md"))}
    assert [page for page in PAGES if page.startswith("docs/") and (ROOT / page).resolve() not in found | evidence] == ["docs/index.md"]


def test_every_picture_is_shown_on_a_page_and_dated() -> None:
    shown = {((ROOT / page).parent / link).resolve() for page in PAGES for link in LINK.findall(prose(page))}
    dated = (ROOT / "docs/evidence/figures.md").read_text(encoding="utf-8")
    for file in (ROOT / "docs" / "images").rglob("*.*"):
        assert file in shown, f"{file.name} is on no page"
        assert file.name in dated or f"{file.parent.name}/*.png" in dated, f"{file.name} has no command in docs/evidence/figures.md"


def test_the_menu_of_the_site_has_every_page() -> None:
    menu = re.findall(r'"([\w/-]+\.md)"', (ROOT / ".ci" / "zensical.toml").read_text(encoding="utf-8"))
    assert sorted(f"docs/{page}" for page in menu) == sorted(page for page in PAGES if page.startswith("docs/"))


@pytest.mark.parametrize("page", reference.PAGES)
def test_the_pages_made_from_the_code_are_those_of_this_code(page: str) -> None:
    assert (reference.FOLDER / page).read_text(encoding="utf-8") == reference.PAGES[page](), "python -m tests.reference writes them anew"


@pytest.mark.parametrize(
    ("heading", "names"),
    [
        ("The fields of a result", Result.__struct_fields__),
        ("The columns of scores.csv", tuple(COLUMNS)),
        ("The tables of an export", {name for schema in SCHEMAS.values() for name, _ in schema}),
    ],
)
def test_the_tables_of_a_result_name_every_key_once(heading: str, names: Iterable[str]) -> None:
    text = (ROOT / "docs/reference/results.md").read_text(encoding="utf-8").partition(f"## {heading}\n")[2].partition("\n## ")[0]
    firsts = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    assert sorted(name for cell in firsts for name in re.findall(r"`(\w+)`", cell)) == sorted(names)


def test_an_option_of_a_mark_takes_the_place_of_the_one_that_is_printed(tmp_path: Path) -> None:
    block = Block("x.md", 1, "sh", "echo a --seconds 300 --dt 1\n", longer={"echo a": "--seconds 5 --trials 1"})
    assert Reader(tmp_path).line(block, "echo a --seconds 300 --dt 1   # b") == "echo a --seconds 5 --dt 1 --trials 1"


def test_a_mark_that_nothing_matches_is_found() -> None:
    assert problems(Block("x.md", 1, "sh", "./covey demo\n", longer={"./covey up": "--seconds 3"}))
    assert not problems(Block("x.md", 1, "sh", "./covey up quick\n", longer={"./covey up": "--seconds 3"}))


@pytest.mark.parametrize(
    ("text", "says"), [("./covey check nowhere\n", "does not exist"), ("./covey chek quick\n", "chek"), ("false\n", "exit code 1")]
)
def test_a_line_that_does_not_work_is_told_with_its_page(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(AssertionError, match=rf"(?s)x\.md:7: .*{says}"):
        Reader(tmp_path).read(Block("x.md", 7, "sh", text))


SCENARIOS = {
    page: [block for block in blocks_of(page) if block.file or (block.language == "toml" and "" not in block.skipped)] for page in PAGES
}


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if SCENARIOS[page]])
def test_every_scenario_of_a_page_passes_the_check_and_its_classes_are_found(page: str, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    for block in SCENARIOS[page]:
        reader.read(block)
    for block in SCENARIOS[page]:
        if block.file.endswith(".toml"):
            reader.type(block, f"./covey check {block.file}")


def understood(page: str, line: str) -> None:
    """Parse a line of a page if it calls `covey`; raises AssertionError naming the page for words that the command line does not know."""
    command = re.split(r"\s+#|\s*(?:[|<>;]|&&)", line)[0]
    if re.match(r"(\./)?covey (?!test\b)", command):  # `test` is the launcher's own
        try:
            app.parse_args(shlex.split(command)[1:], exit_on_error=False, print_error=False)
        except cyclopts.CycloptsError as error:
            raise AssertionError(f"{page}: {command}: {error}") from None


@pytest.mark.parametrize("page", WITH_BLOCKS)
def test_every_command_of_a_page_is_one_with_its_options(page: str) -> None:
    """Those too that no test runs."""
    for block in blocks_of(page):
        for line in block.text.splitlines() if block.language == "sh" else ():
            understood(page, line)


@pytest.mark.parametrize("line", ["./covey simulat quick", "covey up quick --sed 1   # a swarm", "covey dwon | cat"])
def test_a_line_with_a_word_that_no_command_knows_is_told(line: str) -> None:
    with pytest.raises(AssertionError, match=r"x\.md: "):
        understood("x.md", line)


LONG = {  # each takes more than 8 s of CPU: whole swarms, studies, demos
    *("docs/tutorial/2-own-scenario.md", "docs/tutorial/3-own-sensor.md", "docs/explanation/method.md", "docs/evidence/real-data.md"),
    *(f"docs/how-to/{name}.md" for name in ("bodies", "compare-your-law", "record", "reproduce-the-paper", "robustness-study", "watch")),
    "docs/how-to/many-machines.md",  # typed on three machines in tests/live/test_many_machines.py
    *(f"docs/how-to/own-{name}.md" for name in ("controller", "recording", "scenario", "sensor", "target-motion")),
}


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", [pytest.param(page, marks=[pytest.mark.nightly] * (page in LONG)) for page in WITH_BLOCKS])
def test_every_command_of_a_page_runs_as_printed(page: str, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    try:
        for block in blocks_of(page):
            reader.read(block)
    finally:
        reader.end()
