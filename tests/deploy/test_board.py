"""What `watch` shows on a terminal: it fits, the chosen process stays in sight, and keys ask for what they mean."""

import io
from typing import Any

import pytest
from rich.console import Console

from deploy.cli.process_list import print_processes
from deploy.cli.terminal import KEY, NAMES
from deploy.cli.watch import WatchScreen
from protocol.settings import BadSetting

SWARM = {
    "tick": 12, "time": 3.0, "ospa": 0.5, "gospa": 1.0, "in_view": 2, "has_targets": True, "targets": 3, "hole": 0.0, "overlap": 0.0,
    "arena": (25.0, 25.0), "places": [], "estimates": [],
    "tick_rate": {"ticks_per_s": None, "asked_per_s": None, "skipped": 0, "late": 0, "pace": 1, "slowest": [], "stalled": [], "advice": ""},
}  # fmt: skip


def row(name: str, state: str = "running") -> dict[str, Any]:
    figures = {
        "tick": 12,
        "cell": 0.25,
        "mass": 1.0,
        "targets": 1,
        "round_ms": 2.5,
        "alive": state != "dead",
        "skipped": 0,
        "late": 0,
        "pace": 1,
    }
    end = {"end": "killed by SIGKILL", "ended_at": 0.0} if state == "dead" else {"end": "", "ended_at": None}
    return {"name": name, "class": "A", "state": state, "pid": 4711, "incarnation": 1, **end, **figures}


def status(*rows: dict[str, Any]) -> dict[str, Any]:
    return {"run": "r", "scenario": "quick", "endpoint": "tcp/127.0.0.1:7447", "swarm": SWARM, "processes": list(rows)}


def drawn(board: WatchScreen, data: dict[str, Any], width: int, height: int = 40) -> list[str]:
    """The lines of a picture in a terminal of that size."""
    console = Console(file=io.StringIO(), width=width, height=height)
    console.print(board.picture(data, console, keys=True))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


class Supervisor:
    """Notes what it is asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []

    def __call__(self, verb: str, who: str) -> dict[str, Any]:
        self.asked.append((verb, who))
        if who == "s9":
            raise BadSetting("s9 is not running")
        return {"ok": f"{verb} {who}: done"}


@pytest.mark.parametrize("width", [24, 30, 40, 60, 80, 100, 160])
def test_a_picture_is_never_wider_than_the_terminal_and_name_and_state_stay(width: int) -> None:
    lines = drawn(WatchScreen(Supervisor()), status(row("world"), row("s10"), row("s11", "paused")), width)
    assert max(map(len, lines)) <= width
    shown = "\n".join(lines)
    assert all(word in shown for word in ("name", "state", "s10", "running", "paused"))


def test_the_table_of_ps_has_no_column_that_is_cut_off() -> None:
    console = Console(file=io.StringIO(), width=60)
    print_processes(status(row("world"), row("s10"), row("s11", "paused")), console)
    assert isinstance(console.file, io.StringIO)
    shown = console.file.getvalue()
    assert "…" not in shown and max(map(len, shown.splitlines())) <= 60
    assert all(word in shown for word in ("name", "state", "s10", "running", "paused", "subscribe at tcp/127.0.0.1:7447"))


def test_the_narrower_the_terminal_the_fewer_columns_and_what_matters_least_goes_first() -> None:
    data = status(row("world"), row("s1"))
    heads = [next(line.split() for line in drawn(WatchScreen(Supervisor()), data, width) if "state" in line) for width in (100, 60, 30, 20)]
    assert heads[0] == [
        "name",
        "class",
        "state",
        "pid",
        "inc",
        "tick",
        "cell",
        "%",
        "mass",
        "targets",
        "round",
        "ms",
        "pace",
        "skipped",
        "late",
    ]
    assert [len(head) for head in heads] == sorted((len(head) for head in heads), reverse=True)
    assert "inc" not in heads[1] and "mass" in heads[1] and heads[3] == ["name", "state"]


def test_in_a_low_terminal_the_rows_around_the_chosen_one_are_shown() -> None:
    board = WatchScreen(Supervisor())
    data = status(*(row(f"s{number}") for number in range(1, 49)))
    for _ in range(40):
        board.press("down", data["processes"])
    lines = drawn(board, data, 80, 20)
    assert board.chosen == "s40" and len(lines) < 20
    assert any(" s40 " in line for line in lines) and not any(" s1 " in line for line in lines)


def test_arrows_choose_and_letters_act_on_the_chosen_one() -> None:
    asked = Supervisor()
    board, rows = WatchScreen(asked), [row("world"), row("s1"), row("s2", "paused"), row("s3", "dead"), row("s9")]
    assert board.press("k", rows) and board.note == "choose a process with the arrow keys first" and not asked.asked
    for key in ("down", "down", "k", "p", "down", "p", "down", "r", "x"):
        assert board.press(key, rows)
    assert asked.asked == [("kill", "s1"), ("pause", "s1"), ("resume", "s2"), ("restart", "s3")]
    board.press("down", rows)
    board.press("down", rows)
    assert board.press("k", rows) and board.note == "s9 is not running"
    assert not board.press("q", rows)


def test_the_bytes_of_a_terminal_are_read_as_keys() -> None:
    typed = "\x1b[A\x1bOBk\x1b[1;5Cq"
    assert [NAMES.get(key, key) for key in KEY.findall(typed)] == ["up", "down", "k", "\x1b[1;5C", "q"]
