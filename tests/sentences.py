"""How long the sentences of a text are, in words.

A sentence ends at `.`, `!` or `?` before a blank, and at the end of a paragraph or list item.
Headings, tables, code and pictures are left out.
`python -m tests.sentences FILE...` prints median and 90 % of each file, and its longest sentences.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

END = re.compile(r"(?<=[.!?])(?<!e\.g\.)(?<!i\.e\.)[)\"*]*\s+(?=[\"(*`\[]*[A-Z0-9`])")
SHORT, LONG = 15, 28  # words: the median, and what nine in ten keep to


def of_page(text: str) -> list[str]:
    """The sentences of a page in Markdown."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    return [sentence for part in parts(text) if not re.match(r"#|\||!\[", part) for sentence in split(re.sub(r"\]\([^)]*\)", "]", part))]


def of_docstrings(source: str) -> list[str]:
    """The sentences of all docstrings of a module."""
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    texts = [ast.get_docstring(node) or "" for node in ast.walk(ast.parse(source)) if isinstance(node, kinds)]
    return [sentence for text in texts for part in parts(text) if "---" not in part for sentence in split(part)]


def parts(text: str) -> Iterator[str]:
    """The paragraphs and list items of a text; paragraphs that are indented as a whole are code or a table."""
    for paragraph in re.split(r"\n\s*\n", text):
        if not all(line.startswith("    ") for line in paragraph.splitlines()):
            for part in re.split(r"^\s*(?:[*-]|\d+\.) ", paragraph, flags=re.MULTILINE):
                if part.strip():
                    yield "\n".join(line for line in part.strip().splitlines() if not line.startswith("     "))


def split(paragraph: str) -> list[str]:
    """The sentences of a paragraph."""
    return [sentence for sentence in END.split(" ".join(paragraph.split())) if sentence]


def words(sentence: str) -> int:
    """Words of a sentence: what stands between blanks and holds a letter or a digit. Code between backticks is one word."""
    return len(re.findall(r"\S*\w\S*", re.sub(r"`[^`]*`", "code", sentence)))


def measured(sentences: list[str]) -> tuple[int, int]:
    """The median and the 90 % quantile of the number of words."""
    lengths = sorted(map(words, sentences)) or [0]
    return lengths[len(lengths) // 2], lengths[min(len(lengths) - 1, len(lengths) * 9 // 10)]


def _lines(path: Path) -> Iterator[str]:
    text = path.read_text(encoding="utf-8")
    found = of_docstrings(text) if path.suffix == ".py" else of_page(text)
    yield f"{path}: {len(found)} sentences, median {measured(found)[0]}, 90 % {measured(found)[1]}"
    yield from (f"    {words(sentence)}: {sentence}" for sentence in sorted(found, key=words)[-3:] if words(sentence) > LONG)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(*_lines(Path(name)), sep="\n")
