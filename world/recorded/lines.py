"""Lines of a data file as numbers, with the line and the column of everything that is wrong.

Rules. What breaks the form of a file (columns, numbers, order of times) raises BadSetting: nothing after it can be trusted. A line of
the right form that cannot be true is left out and named in `Remarks`. More than `MOST_WRONG` such lines raise BadSetting too.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from protocol.settings import BadSetting

LARGEST_WHOLE = 2**53 - 1  # above it a double cannot tell all whole numbers apart
MOST_WRONG = 0.01  # share of the lines of a file that may be left out; 3 always may


class Line(NamedTuple):
    """One line of a file: where it stands, and its cells."""

    path: Path
    number: int  # from 1
    cells: tuple[str, ...]

    @property
    def place(self) -> str:
        """File and line, as an error names them."""
        return f"{self.path}, line {self.number}"

    def value(self, column: int, name: str) -> float:
        """The finite number in a column; raises BadSetting naming file, line and column."""
        try:
            value = float(self.cells[column])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise BadSetting(f"{self.place}: {name} = {self.cells[column]!r}: should be a finite number")
        return value

    def whole(self, column: int, name: str) -> int:
        """The whole number >= 0 in a column, which may be written as 1.0e+00; raises BadSetting likewise."""
        value = self.value(column, name)
        if value != int(value) or not 0 <= value <= LARGEST_WHOLE:
            raise BadSetting(f"{self.place}: {name} = {self.cells[column]!r}: should be a whole number from 0 to {LARGEST_WHOLE}")
        return int(value)


class Remarks:
    """The lines of a file that were left out because they cannot be true."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._found: list[tuple[int, str]] = []  # number of the line, and what is said of it

    def leave_out(self, line: Line, text: str) -> None:
        """Note that a line is left out, and why."""
        self._found.append((line.number, f"{line.place}: {text}; the line is left out"))

    def check(self, lines: int) -> tuple[str, ...]:
        """The remarks about a file of so many lines, in their order; raises BadSetting when too many of them are wrong."""
        texts = [text for _, text in sorted(self._found)]
        if len(texts) > max(3.0, MOST_WRONG * lines):
            first = texts[0].removesuffix("; the line is left out")
            raise BadSetting(f"{first}; {len(texts)} of {lines} lines like this: should be at most {100 * MOST_WRONG:g} %")
        return tuple(texts)


def text_of(path: Path) -> str:
    """The text of a file; raises BadSetting naming it."""
    try:
        return path.read_text(encoding="utf-8-sig")  # spreadsheets write a mark before the first column
    except OSError as error:
        raise BadSetting(f"recorded.data = {str(path)!r}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise BadSetting(f"{path}: should be text in UTF-8") from None


def csv_lines(path: Path, columns: Sequence[str]) -> list[Line]:
    """The lines of a CSV file with exactly these columns, in any order; the cells stand in the order of `columns`."""
    texts = text_of(path).splitlines()
    head = _unquoted(texts[0]) if texts else []
    unknown, missing = [name for name in head if name not in columns], [name for name in columns if name not in head]
    if unknown or missing or len(head) != len(columns):
        fault = "is unknown" if unknown else "is missing" if missing else "is not there once"
        wrong = f"column {(unknown or missing or head)[0]!r} {fault}"
        raise BadSetting(f"{path}, line 1: {wrong}; should be {', '.join(columns)}")
    places = [head.index(name) for name in columns]
    return _lines(path, texts, 1, _unquoted, places, ", ".join(head))


def _unquoted(text: str) -> list[str]:
    """The cells of a line of CSV, with or without quotes around them; none of ours holds a comma."""
    return [cell.strip().strip('"') for cell in text.split(",")]


def blank_lines(path: Path, columns: Sequence[str]) -> list[Line]:
    """The lines of a file whose columns stand between blanks; a line that begins with # is a comment."""
    return _lines(path, text_of(path).splitlines(), 0, str.split, range(len(columns)), f"{', '.join(columns)} between blanks")


def _lines(path: Path, texts: Sequence[str], head: int, split: Callable[[str], list[str]], places: Sequence[int], names: str) -> list[Line]:
    found = []
    for number, text in enumerate(texts[head:], start=head + 1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        cells = split(text)
        if len(cells) != len(places):
            raise BadSetting(f"{path}, line {number}: {len(cells)} columns; should be {len(places)}: {names}")
        found.append(Line(path, number, tuple([cells[place].strip() for place in places])))
    if not found:
        raise BadSetting(f"{path}: holds no data")
    return found
