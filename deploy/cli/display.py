"""Progress for people: a live panel in a terminal, plain lines elsewhere."""

import contextlib
import os
import select
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from rich.console import Console
from rich.live import Live
from rich.table import Table

from deploy.cli.errors import FAILED, OK, complain, lead_nowhere

if TYPE_CHECKING:  # they bring scipy and shapely, which `ps` has no use for
    from deploy.scoring.result import Result
    from deploy.scoring.scorer import Status

PLAIN_PERIOD = 5.0  # s between two plain lines
LIVE_PERIOD = 0.25  # s between two pictures of the panel
SLOW = 0.95  # of the speed that was asked for: a slower world says its factor
MOST_NAMED = 3  # agents named in a line


class Output(Console):
    """A console that raises BrokenPipeError where the reader has gone; Rich's own ends the process."""

    def on_broken_pipe(self) -> None:
        """Called while the error is handled."""
        raise


class Display:
    """Shows the status of one run while it runs; use as a context. With `to_stderr` standard output stays free for the result.

    What cannot be written at once is left out: neither a pipe that nobody reads nor a terminal that is held (Ctrl-S) may hold up the run.
    An output that fails at the first line ends the command. One that fails later is given up, and the run goes on.
    """

    def __init__(self, title: str = "", to_stderr: bool = False) -> None:
        self._title = title
        self._number = 2 if to_stderr else 1
        self.console = Output(stderr=to_stderr, highlight=False)
        self._has_begun = False  # the first line has been written, or left out
        self._live = Live(console=self.console, auto_refresh=False, transient=True) if self.console.is_terminal else None
        self._period = LIVE_PERIOD if self._live else PLAIN_PERIOD
        self._shown_at = -self._period

    def __enter__(self) -> "Display":
        if self._live:
            self._live.start()
        if self._title:
            self.event(self._title)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Take the panel off the screen; lines may still follow."""
        if self._live:
            self._write(self._live.stop)

    def event(self, text: str) -> None:
        """One line that stays; nothing for an empty text."""
        if not text:
            return
        if self._is_ready():
            self._write(lambda: self.console.print(text, markup=False, soft_wrap=True))
        self._has_begun = True

    def status(self, status: "Status") -> None:
        """The newest figures, in place of the last ones."""
        if time.monotonic() - self._shown_at < self._period or not self._is_ready():
            return
        self._shown_at = time.monotonic()
        if live := self._live:
            self._write(lambda: live.update(status_table(status), refresh=True))
        else:
            self.event(status_line(status))

    def _write(self, write: Callable[[], None]) -> None:
        """Write, or give the output up when it takes no more."""
        try:
            write()
        except BrokenPipeError:
            lead_nowhere(self._number)
            if not self._has_begun:
                raise SystemExit(FAILED) from None
            self.console.quiet = True
        except OSError as error:
            if not self._has_begun:
                raise
            self.console.quiet = True
            if self._number == 1:
                complain(f"standard output: {error.strerror}; the run goes on without its lines", FAILED)

    def _is_ready(self) -> bool:
        """Whether some lines can be written without waiting for a reader."""
        if self.console.quiet:
            return False
        try:
            return bool(select.select([], [self.console.file], [], 0.0)[1])
        except (OSError, ValueError):  # no descriptor, so nothing to wait for
            return True


def status_line(status: "Status") -> str:
    """The figures of a swarm in one line."""
    alive = sum(agent.alive and not agent.paused for agent in status.agents)
    if status.tick < 0:
        return f"starting: {status.waiting or f'{alive} of {len(status.agents)} agents alive'}"
    share = 100.0 * (status.tick + 1) / status.ticks
    paused = sum(agent.paused for agent in status.agents)
    living = f"alive {alive}/{len(status.agents)}" + (f", {paused} paused" if paused else "")
    return f"{share:3.0f} %  {swarm_line(msgspec.to_builtins(status))}  {living}"


def swarm_line(swarm: dict[str, Any]) -> str:
    """Time and scores of a swarm; before its first tick what it waits for."""
    if swarm["tick"] < 0:
        return f"starting: {swarm['waiting']}".removesuffix(": ")
    scores = f"OSPA {swarm['ospa']:5.2f} m  GOSPA {swarm['gospa']:5.1f} m  in view {swarm['in_view']}/{swarm['targets']}"
    if not swarm["has_targets"]:
        scores = "OSPA -  GOSPA -  in view - (targets.count = 0)"
    cells = f"hole {100.0 * swarm['hole']:.2f} %  overlap {100.0 * swarm['overlap']:.2f} %"
    return f"t {swarm['time']:7.2f} s  {scores}  {cells}  {tick_rate_words(swarm['tick_rate'])}".rstrip()


def tick_rate_words(tick_rate: dict[str, Any]) -> str:
    """`7.1 of 8 ticks/s, 3 rounds skipped, 1 late`; zeros are left out."""
    speed = "" if tick_rate["ticks_per_s"] is None else f"{tick_rate['ticks_per_s']:.1f}"
    asked = f" of {tick_rate['asked_per_s']:g}" if speed and tick_rate["asked_per_s"] is not None else ""
    slow = tick_rate["asked_per_s"] is not None and tick_rate["ticks_per_s"] is not None
    factor = tick_rate["ticks_per_s"] / tick_rate["asked_per_s"] if slow else 1.0
    counts = [
        f"{factor:.2f} x the speed asked for" if factor < SLOW else "",
        f"pace {tick_rate['pace']}: {some(tick_rate['slowest'])}" if tick_rate["slowest"] else "",
        f"stalled: {some(tick_rate['stalled'])}" if tick_rate["stalled"] else "",
        f"{tick_rate['skipped']} rounds skipped" if tick_rate["skipped"] else "",
        f"{tick_rate['late']} late" if tick_rate["late"] else "",
    ]
    return ", ".join(filter(None, [f"{speed}{asked} ticks/s" if speed else "", *counts]))


def some(names: list[str]) -> str:
    """The first names of a list, and how many more there are."""
    return ", ".join(names[:MOST_NAMED]) + (f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else "")


def status_table(status: "Status") -> Table:
    """The figures of a swarm, and one row of blocks for its agents."""
    table = Table.grid(padding=(0, 2))
    table.add_row(status_line(status))
    absent = "dim" if status.tick < 0 else "red strike"
    table.add_row(" ".join(f"[{'yellow' if one.paused else 'green' if one.alive else absent}]{one.name}[/]" for one in status.agents))
    if status.tick_rate.advice:
        table.add_row(f"[yellow]{status.tick_rate.advice}[/]")
    return table


def result_table(result: "Result", title: str) -> Table:
    """The result of a run."""
    table = Table(title=title, show_header=False, title_justify="left")
    for what, how_much in result.rows():
        table.add_row(what, how_much)
    return table


def process_table(data: dict[str, Any]) -> Table:
    """Every process of a running swarm."""
    title = f"{data['run']} ({data['scenario']})  {swarm_line(data['swarm'])}"
    caption = "\n".join(filter(None, [f"subscribe at {data['endpoint']}", data["swarm"]["tick_rate"]["advice"]]))
    table = Table(title=title, title_justify="left", box=None, caption=caption, caption_justify="left")
    for head in ("name", "class", "state", "pid", "inc", "tick", "cell %", "mass", "targets", "round ms", "pace", "skipped", "late"):
        table.add_column(head, justify="left" if head in ("name", "class", "state") else "right", no_wrap=True)
    for row in data["processes"]:
        table.add_row(*process_cells(row), style="" if row["state"] == "running" else "red" if row["state"] == "dead" else "yellow")
    return table


def process_cells(row: dict[str, Any]) -> list[str]:
    """The cells of one process; a dead one shows how and when it ended."""
    state = row["state"]
    if state == "dead":
        when = f" at {time.strftime('%H:%M:%S', time.localtime(row['ended_at']))}" if row["ended_at"] else ""
        state = f"dead: {row['end']}{when}" if row["end"] else "not started"
    if row.get("differs") and state != "dead":
        state = f"{row['state']}, refused: other {', '.join(row['differs'])}"
    figures = [""] * 8
    if "tick" in row and row["tick"] >= 0:
        owns = [f"{100.0 * row['cell']:.1f}", f"{row['mass']:.2f}", str(row["targets"])] if row["alive"] else ["", "", ""]
        figures = [str(row["tick"]), *owns, f"{row['round_ms']:.1f}", str(row["pace"]), str(row["skipped"]), str(row["late"])]
    return [row["name"], row["class"], state, str(row["pid"] or ""), str(row["incarnation"]), *figures]


def show_result(result: "Result", path: Path | None, as_json: bool) -> int:
    """Show the result as a table, or as the last line of standard output. The exit code: 1 when there is no room for it.

    A reader who has gone is no error.
    """
    where = f"; kept in {os.path.relpath(path)}" if path else ""
    table = result_table(result, f"{result.scenario}, seed {result.seed}: {result.agents} agents{where}")
    try:
        if not as_json:
            Output(highlight=False, markup=False).print(table)
            return OK
        with contextlib.suppress(OSError):  # the line that follows holds the same
            Output(stderr=True, highlight=False, markup=False).print(table)
        print(result.to_json(), flush=True)
    except OSError as error:
        lead_nowhere()
        return OK if isinstance(error, BrokenPipeError) else complain(f"standard output: {error.strerror}", FAILED)
    return OK
