"""A small map of a swarm for a terminal: bodies as arrows with their numbers, true targets and estimates as marks."""

import math
from typing import Any

from rich.text import Text

COLUMNS = 72  # of a map, two to the height of a character
ROWS = 26
LEAST_ROWS = 8
ARROWS = "→↗↑↖←↙↓↘"
STYLES = {"running": "bold cyan", "paused": "yellow", "dead": "red"}
Marks = dict[tuple[int, int], tuple[str, str]]  # (row, column) -> character and style


def swarm_map(swarm: dict[str, Any], rows: list[dict[str, Any]], most_lines: int = ROWS, most_columns: int = COLUMNS) -> Text:
    """The map of a status as the supervisor gives it: o a true target, • an estimate, * both, an arrow a body, x a dead one.

    Empty where there is no room for it.
    """
    if most_lines < LEAST_ROWS:
        return Text()
    width, height = swarm["arena"]
    columns = min(COLUMNS, max(8, most_columns), max(8, round(2.0 * min(ROWS, most_lines) * width / height)))
    lines = max(4, min(ROWS, round(columns * height / width / 2.0)))
    marks: Marks = {}
    for place in swarm["places"]:
        _put(marks, _square(place, width, height, columns, lines), "o", "bold")
    for place in swarm["estimates"]:
        square = _square(place, width, height, columns, lines)
        _put(marks, square, "*" if marks.get(square, ("", ""))[0] in ("o", "*") else "•", "yellow")
    for row in rows:
        if row.get("pose"):
            _put_body(marks, row, _square(row["pose"], width, height, columns, lines), columns)
    return _drawn(marks, columns, lines)


def _square(place: list[float], width: float, height: float, columns: int, lines: int) -> tuple[int, int]:
    """(line, column) of a position; a position outside the arena is drawn at the border."""
    column = min(columns - 1, max(0, int(place[0] / width * columns)))
    return min(lines - 1, max(0, lines - 1 - int(place[1] / height * lines))), column


def _put(marks: Marks, square: tuple[int, int], character: str, style: str) -> None:
    marks[square] = character, style


def _put_body(marks: Marks, row: dict[str, Any], square: tuple[int, int], columns: int) -> None:
    """An arrow and, where there is room, the number in the agent's name."""
    style = STYLES.get(row["state"], "")
    turn = round(row["pose"][2] / (math.pi / 4.0)) % 8
    _put(marks, square, "x" if row["state"] == "dead" else ARROWS[turn], style)
    number = "".join(character for character in row["name"] if character.isdecimal())
    squares = [(square[0], square[1] + 1 + place) for place in range(len(number))]
    if all(position_row not in marks and position_row[1] < columns for position_row in squares):
        for position_row, digit in zip(squares, number):
            _put(marks, position_row, digit, style + " dim" if row["state"] == "running" else style)


def _drawn(marks: Marks, columns: int, lines: int) -> Text:
    text = Text("┌" + "─" * columns + "┐\n", style="dim", no_wrap=True)
    for line in range(lines):
        text.append("│")
        for column in range(columns):
            character, style = marks.get((line, column), (" ", ""))
            text.append(character, style=f"not dim {style}" if style and "dim" not in style else style)
        text.append("│\n")
    return text.append("└" + "─" * columns + "┘  o target   • estimate   * both   ↗ agent   x dead")
