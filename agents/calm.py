"""A calm round: all peers are as in the last one, and each says what is expected of it. Then their gossips are read together, from the
bytes into one table (`gossip_kernels`), and nothing is made of any single one of them.

Anything else is read, judged and remembered message by message; and what was read together can be had so at any time.
"""

from collections.abc import Callable, Iterator, KeysView, Sequence
from itertools import accumulate
from math import cos, sin
from typing import NamedTuple

import msgspec
import numpy as np

from agents.config import AgentConfig
from agents.words import COLUMNS, COS, EAST, NORTH, RADIUS, REACH, ROW, SIN, Eye, Words, X, Y, learn
from protocol.codec import decode
from protocol.keys import one_of
from protocol.messages import WIRE_VERSION, Gossip

SPOT = [X, Y, REACH, EAST, NORTH, RADIUS]  # the columns of `places`
DIAGRAMS = ("voronoi", "voronoi-cod", "power")
SPANS = 7  # columns of the spans, see `gossip_kernels`
_SLACK = 1.0 + 1e-12  # less than `neighbours` allows: who is not believed here is judged there


def _layout() -> tuple[np.ndarray, np.ndarray]:
    """What stands between the values of a gossip as our encoder writes it, end to end, and where each part ends."""
    word = msgspec.msgpack.encode
    fields = len(Gossip.__struct_encode_fields__) + 1
    tokens = [
        b"\xde" + fields.to_bytes(2, "big") + word("type") + word("gossip") + word("sender"),
        word("wire") + word(WIRE_VERSION) + word("tick"),
        word("pose") + b"\x93",
        word("cod") + b"\x92",
        *map(word, ("power_radius", "unused", "detections", "scanned")),
        word("listening") + word(False) + word("claim_tick"),
        *map(word, ("claim_names", "claim", "view", "weight", "states", "ids", "incarnation")),
    ]
    return np.frombuffer(b"".join(tokens), np.uint8), np.array(list(accumulate(map(len, tokens))))


LAYOUT = _layout()


class Reader(NamedTuple):
    """The compiled functions of `gossip_kernels`."""

    read: Callable[..., bool]
    lay_out: Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray, bool]]


class Expected(NamedTuple):
    """Whose word a calm round waits for, and what may come."""

    name: str
    incarnation: int
    eye: Eye
    capability: float  # D, m^2
    reach: float  # of the sensor, m


class Roll:
    """All of those, in the order of names; `place` is the row that is left free for the agent itself."""

    def __init__(self, config: AgentConfig, reader: Reader, expected: list[Expected], place: int) -> None:
        self.config, self.reader, self.place = config, reader, place
        self.names = tuple([one.name for one in expected])
        self.eyes = {one.name: one.eye for one in expected}
        slots = [*range(place), *range(place + 1, len(expected) + 1)]
        self.rows = {one.name: slot for one, slot in zip(expected, slots)}
        self.speakers = {one_of(config.run.name, "gossip", one.name): one.name for one in expected}  # by key
        self.diagram = DIAGRAMS.index(config.partition.kind)
        spelled = [b""] * (len(expected) + 1)
        incarnations, limits = np.zeros(len(spelled), np.int64), np.zeros((len(spelled), 2))
        template = bytearray(ROW.size * len(spelled))
        for slot, one in zip(slots, expected):
            spelled[slot], incarnations[slot] = one.name.encode(), one.incarnation
            limits[slot] = one.capability * _SLACK, one.reach * _SLACK
            row = (0.0, 0.0, 0.0, 0.0, *one.eye.numbers, one.eye.kind, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, one.eye.salt)
            ROW.pack_into(template, ROW.size * slot, *row)
        self.template = np.frombuffer(template, dtype=float).reshape(-1, COLUMNS)
        self.facts = np.frombuffer(b"".join(spelled), np.uint8), np.array(list(accumulate(map(len, spelled)))), incarnations, limits


class CalmRound:
    """What has been read of one tick so far; a container of the names that have spoken."""

    def __init__(self, roll: Roll, tick: int) -> None:
        self.roll, self.tick = roll, tick
        self._table = roll.template.copy()
        self._spans = np.zeros((len(self._table), SPANS), np.int64)
        self._said: dict[str, bytes] = {}
        self._buffers: list[bytes] = []
        self._size = 0

    def __len__(self) -> int:
        return len(self._said)

    def __iter__(self) -> Iterator[str]:
        return iter([name for name in self.roll.names if name in self._said])

    def drop(self, name: str) -> None:
        """Leave out what somebody has said, after the round."""
        self._said.pop(name, None)

    def names(self) -> KeysView[str]:
        """Who has spoken."""
        return self._said.keys()

    def read(self, keys: Sequence[str], payloads: Sequence[bytes]) -> KeysView[str] | None:
        """Read what has come under these keys; whose it was. None: something in it is out of the ordinary, and nothing has been read."""
        roll = self.roll
        said = dict(zip([roll.speakers.get(key, "") for key in keys], payloads))
        if len(said) < len(keys) or not said.keys() <= roll.rows.keys() or not said.keys().isdisjoint(self._said):
            return None
        data = b"".join(payloads)
        rows, ends = np.array([roll.rows[name] for name in said]), np.array(list(accumulate(map(len, payloads))))
        found = self._table, self._spans
        if not roll.reader.read(np.frombuffer(data, np.uint8), ends, rows, self._size, self.tick, LAYOUT, roll.facts, roll.diagram, found):
            return None
        self._said.update(said)
        self._buffers.append(data)
        self._size += len(data)
        return said.keys()

    def words(self, mine: Gossip) -> Words:
        """All that was said, of everybody, and mine in its place."""
        place, spans, own = self.roll.place, self._spans, (mine.detections_bytes, mine.states_bytes, mine.ids_bytes)
        at, states, ids = list(accumulate(map(len, own[:2]), initial=self._size))
        spans[place] = at, len(own[0]) // 8, states, len(own[2]) // 8, ids, mine.claim_tick, mine.view
        table = self._table.copy()
        headings = table[:, COS].tolist()  # their cosines not in compiled code, whose last digit may be another
        table[:, COS], table[:, SIN] = [cos(heading) for heading in headings], [sin(heading) for heading in headings]
        table[place] = np.frombuffer(mine.memo["row"], dtype=float)
        detections, stated, numbers, agreed = self.roll.reader.lay_out(np.frombuffer(b"".join([*self._buffers, *own]), np.uint8), spans)
        names = (*self.roll.names[:place], mine.sender, *self.roll.names[place:])
        claimed = (mine.claim_tick, mine.view) if agreed else None
        said = dict(self._said)  # whatever is dropped later

        def gossips() -> list[Gossip]:
            others = list(self._spelled_out(said).values())
            return [*others[:place], mine, *others[place:]]

        known = {"detections": detections, "claimed": claimed, "listening": mine.listening}
        words = Words(names, table, gossips, known)
        words.remember(stated, numbers)
        return words

    def spots(self) -> dict[str, bytes]:
        """Rows of `places` of all who have spoken, by name."""
        rows, table = self.roll.rows, self._table[:, SPOT]
        return {name: table[rows[name]].tobytes() for name in self._said}

    def gossips(self) -> dict[str, Gossip]:
        """What was read, one by one, by name and in the order of names."""
        return self._spelled_out(self._said)

    def _spelled_out(self, said: dict[str, bytes]) -> dict[str, Gossip]:
        roll, found = self.roll, {}
        for key, name in roll.speakers.items():
            if name in said:
                gossip = decode(key, said[name])
                assert isinstance(gossip, Gossip)
                learn(gossip, roll.eyes[name].sensor, roll.config)
                gossip.memo["believed"] = gossip.memo["sensor"]
                found[name] = gossip
        return found
