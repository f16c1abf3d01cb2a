"""The keys of messages and of liveliness tokens, and the expressions that nodes subscribe to.

    covey/<run>/hello/<agent>          covey/<run>/gossip/<agent>        covey/<run>/beacon/<column>/<row>/<agent>
    covey/<run>/observation/<agent>    covey/<run>/command/<agent>       covey/<run>/estimate/<agent>
    covey/<run>/pose/<agent>           covey/<run>/truth                 covey/<run>/halt
    covey/<run>/alive/<role>/<name>/<incarnation>   (a liveliness token)

In an expression `*` stands for one part and `**` for any number of parts. <column>/<row> is the tile of the arena to which a
beacon is addressed.
"""

import re
from functools import lru_cache
from sys import intern
from typing import NamedTuple

from protocol.fields import NAME_PATTERN, RESERVED
from protocol.message import Message
from protocol.messages import Beacon, Observation

ROOT = "covey"
RUN_WIDE_KINDS = ("truth", "halt")  # kinds with one key for the whole run
LONGEST_KEY = 256  # characters of a message key: two names, a kind and two numbers
NAME = re.compile(NAME_PATTERN)

INCARNATION = re.compile(r"^(0|[1-9][0-9]{0,18})\Z")
TILE = re.compile(r"^(0|[1-9][0-9]{0,6})\Z")

Tile = tuple[int, int]  # column from the west, row from the south


class Key(NamedTuple):
    """The parts of a message's key; `name` is the agent, empty for the kinds in `RUN_WIDE_KINDS`; `tile` is that of a beacon."""

    run: str
    kind: str
    name: str
    tile: Tile | None = None


class Token(NamedTuple):
    """The participant that a liveliness token stands for."""

    run: str
    role: str
    name: str
    incarnation: int


def order(name: str) -> tuple[int, str]:
    """Sort key of agent names: s2 before s10."""
    return len(name), name


def message_key(run: str, message: Message) -> str:
    """The key under which a message is published."""
    kind = type(message).__struct_config__.tag
    if kind in RUN_WIDE_KINDS:
        return f"{ROOT}/{run}/{kind}"
    if isinstance(message, Beacon):
        return f"{ROOT}/{run}/beacon/{message.column}/{message.row}/{message.sender}"
    name = message.recipient if isinstance(message, Observation) else message.sender
    return f"{ROOT}/{run}/{kind}/{name}"


def all_of(run: str, kind: str) -> str:
    """The expression for every key of one kind."""
    return f"{ROOT}/{run}/{kind}" if kind in RUN_WIDE_KINDS else one_of(run, kind, "*")


def one_of(run: str, kind: str, name: str) -> str:
    """The key of one agent's messages of one kind; for beacons the expression over all tiles."""
    return f"{ROOT}/{run}/beacon/*/*/{name}" if kind == "beacon" else f"{ROOT}/{run}/{kind}/{name}"


def beacons_in(run: str, tile: Tile) -> str:
    """The expression for the beacons that are addressed to a tile."""
    return f"{ROOT}/{run}/beacon/{tile[0]}/{tile[1]}/*"


def token_key(run: str, role: str, name: str, incarnation: int) -> str:
    """The key of a liveliness token."""
    return f"{ROOT}/{run}/alive/{role}/{name}/{incarnation}"


def tokens_of(run: str, role: str, name: str) -> str:
    """The expression for the liveliness tokens of one participant, of any incarnation."""
    return f"{ROOT}/{run}/alive/{role}/{name}/*"


def is_of_tokens(expression: str) -> bool:
    """Whether an expression is about liveliness tokens, not messages."""
    return expression.split("/", 3)[2:3] == ["alive"]


def all_tokens(run: str) -> str:
    """The expression for every liveliness token of a run."""
    return f"{ROOT}/{run}/alive/**"


def parse_message_key(text: str) -> Key | None:
    """The parts of a message key, or None for anything else."""
    return _parse_message_key(text) if len(text) <= LONGEST_KEY else None


@lru_cache(maxsize=1 << 15)  # the same keys return in every round, also with some thousand agents
def _parse_message_key(text: str) -> Key | None:
    parts = text.split("/")
    if len(parts) == 3 and parts[0] == ROOT and parts[2] in RUN_WIDE_KINDS:
        return Key(parts[1], parts[2], "")
    if parts[0] != ROOT or not NAME.match(parts[-1]):
        return None
    if len(parts) == 4 and parts[2] not in ("alive", "beacon"):
        return Key(parts[1], parts[2], intern(parts[3]))
    if len(parts) == 6 and parts[2] == "beacon" and TILE.match(parts[3]) and TILE.match(parts[4]):
        return Key(parts[1], "beacon", intern(parts[5]), (int(parts[3]), int(parts[4])))
    return None


def parse_token(text: str) -> Token | None:
    """The parts of a liveliness token's key, or None for anything else."""
    parts = text.split("/")
    if len(parts) != 6 or parts[0] != ROOT or parts[2] != "alive" or not all(NAME.match(part) for part in parts[1:]):
        return None
    if parts[3] in ("agent", "body") and parts[4] in RESERVED:
        return None
    number = INCARNATION.match(parts[5])
    return Token(parts[1], parts[3], parts[4], int(number[0])) if number and int(number[0]) < 2**63 else None


def matches(expression: str, key: str) -> bool:
    """Whether a key lies in a key expression (`*` one part, `**` any number, none included)."""
    return _match(expression.split("/"), key.split("/"))


def _match(pattern: list[str], parts: list[str]) -> bool:
    if not pattern:
        return not parts
    if pattern[0] == "**":
        return any(_match(pattern[1:], parts[start:]) for start in range(len(parts) + 1))
    return bool(parts) and pattern[0] in ("*", parts[0]) and _match(pattern[1:], parts[1:])
