"""Sentences of the pages and of the docstrings are short: the median has 15 words at most, nine in ten have 28 at most."""

from pathlib import Path

import pytest

from tests import reference
from tests.docs import PAGES
from tests.sentences import LONG, SHORT, measured, of_docstrings, of_page, words

ROOT = Path(__file__).resolve().parents[1]
WRITTEN = [page for page in PAGES if Path(page).name not in reference.PAGES]  # by hand


@pytest.mark.parametrize("page", WRITTEN)
def test_the_sentences_of_a_page_are_short(page: str) -> None:
    found = of_page((ROOT / page).read_text(encoding="utf-8"))
    median, most = measured(found)
    assert median <= SHORT and most <= LONG, (median, most, sorted(found, key=words)[-3:])


@pytest.mark.parametrize("room", ["protocol", "agents", "world", "deploy"])
def test_the_sentences_of_docstrings_are_short(room: str) -> None:
    found = [sentence for file in (ROOT / room).rglob("*.py") for sentence in of_docstrings(file.read_text(encoding="utf-8"))]
    median, most = measured(found)
    assert len(found) > 50 and median <= SHORT and most <= LONG, (median, most, sorted(found, key=words)[-3:])


def test_sentences_are_split_at_stops_and_list_items_and_without_tables_and_code() -> None:
    text = "# A head\n\nOne two. Three `a b c` four!\nFive\n\n| a | b |\n|---|---|\n\n```sh\nls -l\n```\n\n"
    text += "* six seven\n  eight\n* nine\n\n    code code\n"
    assert of_page(text) == ["One two.", "Three `a b c` four!", "Five", "six seven eight", "nine"]
    assert [words(sentence) for sentence in of_page(text)] == [2, 3, 1, 3, 1]
    assert measured(["a", "a b", "a b c d"]) == (2, 4)
    source = '"""One two. Three."""\ndef f():\n    """Four.\n\n        table\n\n    Five.\n    """\n'
    assert of_docstrings(source) == ["One two.", "Three.", "Four.", "Five."]
