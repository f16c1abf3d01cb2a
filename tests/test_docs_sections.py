"""Figures and their commands: every section of a page of figures names the command or the test that measures them."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FIGURES = next((ROOT / "docs").rglob("figures.md"))
MEASURED = ("paper.md", "performance.md", "promises.md", "robustness.md", "scale.md", "watching.md")
PAGES = [ROOT / "README.md", *sorted(path for path in (ROOT / "docs").rglob("*.md") if path.name in MEASURED)]
FIGURE = re.compile(r"\d\s?(?:ms|us|µs|s|min|h|%|m|MB|GB|kB|MiB|KiB|times|ticks/s|messages)\b|\d %|\d?\.\d")
COMMAND = re.compile(r"covey [a-z]|pytest |python -m |::test_\w+|test_\w+\.py")
UNMEASURED = {
    "Ambiguous": "settings of the paper and readings of them",
    "Errata": "numbers of the paper",
    "Licence": "the version of the licence",
}


def sections(text: str) -> dict[str, str]:
    """The texts of a page by heading of the second level, with all below it; the text before the first heading under an empty name."""
    parts = re.split(r"^## +(.*)$", text, flags=re.MULTILINE)
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2]))}


def without_command(text: str, measured: str) -> list[str]:
    """Headings of sections with a figure but no command, unless `measured`, the table of figures, has a row about the section."""
    found = sections(text).items()
    lacking = [head for head, section in found if head and FIGURE.search(section) and not COMMAND.search(head + section)]
    return [head for head in lacking if head.lower() not in measured.lower() and head not in UNMEASURED]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_section_with_a_figure_names_a_command(page: Path) -> None:
    assert without_command(page.read_text(encoding="utf-8"), FIGURES.read_text(encoding="utf-8")) == []


def test_a_section_without_a_command_is_found() -> None:
    page = "# A page\n\n## Fast\n\nA round takes 0.35 ms (`covey bench round`).\n\n## Slow\n\nIt takes 3 min.\n\n## Words\n\nNo number.\n"
    assert without_command(page, "") == ["Slow"]
    assert without_command(page, "| performance.md | slow | 2026-11-23 |") == []


def test_sections_that_were_not_measured_exist() -> None:
    heads = {head for page in PAGES for head in sections(page.read_text(encoding="utf-8"))}
    assert heads >= UNMEASURED.keys()
