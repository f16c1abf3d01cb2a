"""`watch`: a map and a table of a running swarm that fit the terminal, and keys that act on the chosen process."""

import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

from rich.console import Console, ConsoleRenderable, Group
from rich.live import Live
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from deploy.cli.display import process_table, swarm_line
from deploy.cli.terminal import keyboard, reads_keys
from deploy.cli.terminal_map import swarm_map
from deploy.live.control import ControlClient
from deploy.storage.run_directory import find_running
from protocol.settings import BadSetting

PERIOD = 0.5  # s between two pictures
PLAIN_PERIOD = 1.0  # s between two lines where there is no terminal
LINES = 6  # of a picture that are neither map nor processes
FIRST_TO_GO = ("inc", "pid", "class", "tick", "targets", "round ms", "mass", "cell %")
LAST = ("name", "state")  # stay in the narrowest terminal
KEYS = "↑ ↓ choose   k kill   p pause or resume   r restart   q quit"
Ask = Callable[[str, str], dict[str, Any]]  # verb, who -> the supervisor's answer; raises BadSetting


def watch(run: str | None) -> int:
    """Show a live picture until the run ends or q is pressed; print plain lines without a terminal."""
    client = ControlClient(find_running(run, supervised=True))
    console = Console(highlight=False, markup=False)
    try:
        if not console.is_terminal:
            while True:
                print(watch_line(client.ask("status")["data"]), flush=True)
                time.sleep(PLAIN_PERIOD)
        show(client.ask, console)
        return 0
    except BadSetting as error:
        console.print(str(error))
        return 0


def watch_line(data: dict[str, Any]) -> str:
    """A swarm in one line, the dead by name and how they ended."""
    rows = data["processes"]
    dead = ", ".join(f"{row['name']} ({row['end']})" for row in rows if row["state"] == "dead" and row["end"])
    paused = ", ".join(row["name"] for row in rows if row["state"] == "paused")
    return swarm_line(data["swarm"]) + (f"  dead: {dead}" if dead else "") + (f"  paused: {paused}" if paused else "")


class WatchScreen:
    """The chosen process, and the effect of the last key."""

    def __init__(self, ask: Ask) -> None:
        self.chosen = ""
        self.note = ""
        self._ask = ask

    def press(self, key: str, rows: list[dict[str, Any]]) -> bool:
        """Do what a key means; whether to go on."""
        names = [row["name"] for row in rows]
        if key in ("up", "down") and names:
            here = names.index(self.chosen) if self.chosen in names else -1 if key == "down" else len(names)
            self.chosen = names[max(0, min(len(names) - 1, here + (1 if key == "down" else -1)))]
        elif key in ("k", "p", "r"):
            self._act(key, next((row for row in rows if row["name"] == self.chosen), None))
        return key != "q"

    def _act(self, key: str, row: dict[str, Any] | None) -> None:
        if row is None:
            self.note = "choose a process with the arrow keys first"
            return
        verb = {"k": "kill", "r": "restart", "p": "resume" if row["state"] == "paused" else "pause"}[key]
        try:
            self.note = self._ask(verb, row["name"])["ok"]
        except BadSetting as error:
            self.note = str(error)

    def picture(self, data: dict[str, Any], console: Console, keys: bool) -> Group:
        """Map, table and keys, as far as they have room."""
        rows = data["processes"]
        shown = self._window(rows, console.height - LINES)
        table = process_table({**data, "processes": shown})
        for row, line in zip(shown, table.rows):
            line.style = "reverse" if row["name"] == self.chosen else line.style
        title, table.title, caption, table.caption = table.title, None, table.caption, None
        fit(table, console)
        lower = [self.note, *str(caption).splitlines()[1:], KEYS] if keys else str(caption).splitlines()
        lines: list[ConsoleRenderable] = [Text(text, no_wrap=True, overflow="ellipsis") for text in (str(title), *lower)]
        area = swarm_map(data["swarm"], rows, console.height - len(rows) - LINES, console.width - 2)
        return Group(area, lines[0], table, *lines[1:])

    def _window(self, rows: list[dict[str, Any]], most: int) -> list[dict[str, Any]]:
        """As many rows as there is room for, the chosen one among them."""
        most = max(1, most)
        here = next((index for index, row in enumerate(rows) if row["name"] == self.chosen), 0)
        first = max(0, min(here - most // 2, len(rows) - most))
        return rows[first : first + most]


def fit(table: Table, console: Console) -> None:
    """Remove columns, the least important first, until the table is no wider than the terminal."""
    unknown = [str(column.header) for column in table.columns if str(column.header) not in (*FIRST_TO_GO, *LAST)]
    for head in (*unknown, *FIRST_TO_GO):
        if Measurement.get(console, console.options.update(max_width=1000), table).maximum <= console.width:
            return
        table.columns[:] = [column for column in table.columns if str(column.header) != head]
    for column in table.columns:
        column.min_width = (
            None if column.header == "state" else Measurement.get(console, console.options, Text("\n".join(map(str, column.cells)))).maximum
        )


def show(ask: Ask, console: Console) -> None:
    """Show a swarm until it ends or q is pressed; raises BadSetting when the supervisor stops answering."""
    board, keys = WatchScreen(ask), reads_keys()
    with Live(console=console, auto_refresh=False) as live, keyboard(console.show_cursor) if keys else nullcontext(_sleep) as pressed:
        go_on = True
        while go_on:
            data = ask("status", "")["data"]
            live.update(board.picture(data, console, keys), refresh=True)
            go_on = all(board.press(key, data["processes"]) for key in pressed(PERIOD))


def _sleep(seconds: float) -> list[str]:
    time.sleep(seconds)
    return []
