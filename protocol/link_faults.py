"""Faults of a link: loss, delay, little bandwidth, duplication, reordering and corruption of payloads between two nodes.

A *condition* describes one direction between two nodes. A *channel* is that direction with its own random stream, keyed by the run
seed and the two names. So a fault on one link changes no draw of another link. Every message of a faulty link takes the same number of
draws: a message that is lost at 10 % is lost at 30 % too.
"""

import json
import math
from collections.abc import Callable

import msgspec

from protocol.keys import parse_message_key
from protocol.random_streams import random_key, stream
from protocol.settings import Fraction, NotNegative, Section, convert


class LinkCondition(Section, frozen=True, kw_only=True):
    """The condition of one direction of a link; the default is a clear one."""

    drop: Fraction = 0.0  # share of the messages that are lost
    burst: NotNegative = 0.0  # mean number of messages lost in a row (Gilbert-Elliott); 0: each is lost on its own (Bernoulli)
    delay: NotNegative = 0.0  # s
    jitter: NotNegative = 0.0  # s, uniform on top of the delay; messages may overtake each other
    throttle: NotNegative = 0.0  # kbit/s that the link carries, one message after the other; 0: no limit
    queue: NotNegative = 2.0  # s that a message waits for its turn at most; what would wait longer is lost
    duplicate: Fraction = 0.0  # share of the messages that arrive twice, the copy up to `spread` s later
    reorder: Fraction = 0.0  # share of the messages that are held back by up to `spread` s
    spread: NotNegative = 0.2  # s
    flip: Fraction = 0.0  # share of the messages that are spoilt: one bit is wrong, or eight bytes are all ones, which is no number


DRAWS_AT_ONCE = 8  # messages: numpy takes as long for the draws of one as of so many
CLEAR = LinkCondition()
LOST: list[tuple[float, bytes]] = []


class Channel:
    """One direction of a link."""

    def __init__(self, seed: int, sender: str, receiver: str) -> None:
        self._rng = stream(seed, "link", random_key(sender), random_key(receiver))
        self._draws: list[list[float]] = []  # the draws of the next messages, the last message first
        self._bad = False  # Gilbert-Elliott: every message is lost while the channel is bad
        self._free_at = -math.inf  # s, when a link of little bandwidth has carried all that it was given

    def copies(self, payload: bytes, condition: LinkCondition, now: float) -> list[tuple[float, bytes]]:
        """(delay s, payload) of every copy that arrives of what is sent at `now` s; the very object unless the copy is corrupt."""
        if condition == CLEAR:
            return [(0.0, payload)]
        lost, jitter, twice, later, held, hold, flip, where = self.draw()
        waited = self._carry(len(payload), condition, now)
        if self._loses(lost, condition) or math.isinf(waited):
            return LOST
        delay = waited + condition.delay + jitter * condition.jitter + (hold * condition.spread if held < condition.reorder else 0.0)
        arrived = corrupted(payload, where) if flip < condition.flip and payload else payload
        arrivals = [(delay, arrived)]
        return [*arrivals, (delay + later * condition.spread, arrived)] if twice < condition.duplicate else arrivals

    def _carry(self, size: int, condition: LinkCondition, now: float) -> float:
        """The time in s until a link of little bandwidth has carried `size` bytes; infinite if the queue is full."""
        if not condition.throttle:
            return 0.0
        begin = max(now, self._free_at)
        if begin - now > condition.queue:
            return math.inf
        self._free_at = begin + 0.008 * size / condition.throttle
        return self._free_at - now

    def draw(self) -> list[float]:
        """The eight draws of the next message, each in [0, 1)."""
        if not self._draws:
            self._draws = self._rng.random((DRAWS_AT_ONCE, 8)).tolist()[::-1]
        return self._draws.pop()

    def _loses(self, draw: float, condition: LinkCondition) -> bool:
        """Whether this message is lost; with bursts the channel alternates so that the share `drop` is lost in the long run.

        A share too large for bursts of that length has longer ones.
        """
        if condition.burst <= 1.0 or condition.drop in (0.0, 1.0):
            return draw < condition.drop
        odds = condition.drop / (1.0 - condition.drop)
        recovery = min(1.0 / condition.burst, 1.0 / odds)
        turn = recovery if self._bad else recovery * odds
        self._bad ^= draw < turn
        return self._bad


def corrupted(payload: bytes, where: float) -> bytes:
    """The payload with a fault at the place `where` in [0, 1): one wrong bit, or in every second case eight bytes of ones (a NaN)."""
    place = where * 8 * len(payload)
    bit, blank = int(place), place % 1.0 < 0.5
    changed = bytearray(payload)
    if blank:
        start = max(0, min(bit // 8, len(payload) - 8))
        changed[start : start + 8] = b"\xff" * len(changed[start : start + 8])
    else:
        changed[bit // 8] ^= 1 << (bit % 8)
    return bytes(changed)


class LinkConditions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The links towards one node: the senders that are cut off, and the conditions of the links that are not clear."""

    cut: tuple[str, ...] = ()
    conditions: dict[str, LinkCondition] = {}


class IncomingLinks:
    """The links towards one node, with one channel per sender."""

    def __init__(self, seed: int, receiver: str) -> None:
        self._seed, self._receiver = seed, receiver
        self._faults = LinkConditions()
        self._channels: dict[str, Channel] = {}

    def set(self, conditions: LinkConditions) -> None:
        """Set the conditions of all links towards this node."""
        self._faults = conditions

    def hear(self, sender: str, payload: bytes, now: float) -> list[tuple[float, bytes]]:
        """(delay s, payload) of every copy that arrives of a message that is sent at `now` s."""
        if sender in self._faults.cut:
            return LOST
        condition = self._faults.conditions.get(sender)
        if condition is None:
            return [(0.0, payload)]
        channel = self._channels.get(sender)
        if channel is None:
            channel = self._channels[sender] = Channel(self._seed, sender, self._receiver)
        return channel.copies(payload, condition, now)


class LiveLink:
    """Link faults of one process, on what arrives. Lines of its standard input set them: {"links": {...}} as `LinkConditions`.

    Other lines are ignored.
    """

    def __init__(self, seed: int, receiver: str, complain: Callable[[str], None] = lambda text: None) -> None:
        self._links = IncomingLinks(seed, receiver)
        self._complain = complain

    def on_line(self, line: str) -> None:
        """Take a line of standard input."""
        try:
            data = json.loads(line)
            if isinstance(data, dict) and "links" in data:
                self._links.set(convert(data["links"], LinkConditions, "links"))
        except ValueError as error:
            self._complain(str(error))

    def incoming(self, key: str, payload: bytes, now: float) -> list[tuple[float, bytes]]:
        """(delay s, payload) of every copy of a payload that arrives at this process at `now` s."""
        return self._links.hear(sender_of(key), payload, now)


def sender_of(key: str) -> str:
    """The participant that publishes under a key: the world for the truth and observations, else the name in the key."""
    parts = parse_message_key(key)
    if parts is None:
        return ""
    return "world" if parts.kind in ("truth", "observation") else parts.name


def as_line(conditions: LinkConditions) -> str:
    """The conditions as the line that `LiveLink.on_line` reads."""
    return json.dumps({"links": msgspec.to_builtins(conditions)})
