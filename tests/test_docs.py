"""README and docs/: every line as printed. What a block says is done in a temporary folder, in the order of the page."""

from pathlib import Path

import pytest

from tests.docs import PAGES, ROOT, Block, Reader, blocks_of, problems

WITH_BLOCKS = [page for page in PAGES if blocks_of(page)]


@pytest.mark.parametrize("page", PAGES)
def test_every_block_of_a_page_says_what_it_is_and_every_mark_is_about_a_line(page: str) -> None:
    assert not [problem for block in blocks_of(page) for problem in problems(block)]
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), start=1):
        assert not line.startswith(("    covey ", "    ./covey ")), (
            f"{page}:{number}: commands stand in a block ```sh, so that they are tried"
        )


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


@pytest.mark.parametrize("page", [page for page in PAGES if SCENARIOS[page]])
def test_every_scenario_of_a_page_passes_the_check_and_its_classes_are_found(page: str, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    for block in SCENARIOS[page]:
        reader.read(block)
    for block in SCENARIOS[page]:
        if block.file.endswith(".toml"):
            reader.type(block, f"./covey check {block.file}")


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", WITH_BLOCKS)
def test_every_command_of_a_page_runs_as_printed(page: str, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    try:
        for block in blocks_of(page):
            reader.read(block)
    finally:
        reader.end()
