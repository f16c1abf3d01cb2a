"""The rules for the fields of a message: limits of numbers, and arrays as raw little-endian bytes.

Lengths in m, times in s, angles in rad.
"""

from collections.abc import Sequence
from itertools import accumulate
from typing import Annotated, NamedTuple

import msgspec
import numpy as np

from protocol.cached_attribute import cached_attribute

NAME_PATTERN = r"^[A-Za-z0-9_.-]{1,64}\Z"
Name = Annotated[str, msgspec.Meta(pattern=NAME_PATTERN)]  # of a participant or a sensor class
RESERVED = "world", "monitor", "supervisor", "operator"  # names of processes that are no agents

MAX_ROWS = 8192  # of every array and of every list of names that a round reads
MAX_DETECTIONS = MAX_NAMES = MAX_ROWS
LARGEST_NUMBER = 1.0e6  # of a message, but for areas and times: no coordinate in m is larger
LARGEST_AREA = LARGEST_NUMBER**2  # m^2
LARGEST_TIME = 1.0e9  # largest world time, s: that of the longest run; files and dates hold it
MAX_SETTINGS, VALUE_SIZE = 65536, 8  # characters of all settings of a Hello; size of a number or boolean
LARGEST_SETTING = 1.0e12

F4, F8, U8 = np.dtype("<f4"), np.dtype("<f8"), np.dtype("<u8")


class Malformed(ValueError):
    """A message breaks a rule; `reason` is one word for the counters, the text names the field."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class Rows(NamedTuple):
    """The layout of an array on the wire: type of its numbers, numbers per row, and bytes of a row. The types of messages hold limits."""

    field: str
    dtype: np.dtype
    columns: int
    size: int

    def count(self, data: bytes) -> int:
        """The number of rows; raises Malformed for a part of a row."""
        rows, rest = divmod(len(data), self.size)
        if rest:
            raise Malformed("shape", f"{self.field}: {len(data)} bytes are no whole number of rows of {self.size} bytes")
        return rows

    def read(self, data: bytes) -> np.ndarray:
        """The rows, read-only: (N, columns), or (N,) if there is one column."""
        flat = np.frombuffer(data, self.dtype)
        return flat.reshape(self.count(data), self.columns) if self.columns > 1 else flat


def check_rows(rows: Rows, data: bytes) -> int:
    """Refuse NaN, infinity and anything beyond `LARGEST_NUMBER`; return the number of rows.

    A sum of squares below half the bound squared proves it for the whole array in one pass: its rounding error is below 1 %, and NaN
    compares false. Only a larger sum needs the check of every number.
    """
    if not data:
        return 0
    count = rows.count(data)
    flat = np.frombuffer(data, rows.dtype)
    if not np.vdot(flat, flat) < 0.5 * LARGEST_NUMBER**2 and not bool(np.all(np.abs(flat) <= LARGEST_NUMBER)):
        raise Malformed("range", f"{rows.field}: every number should be finite and within +-{LARGEST_NUMBER:g}")
    return count


def rows_of(field: str, number: np.dtype, columns: int) -> Rows:
    """The layout of rows of so many numbers."""
    return Rows(field, number, columns, number.itemsize * columns)


def array_field(field: str, rows: Rows) -> cached_attribute[np.ndarray]:
    """An attribute of a message: the rows that it holds as bytes in a field, read-only."""
    return cached_attribute(lambda message: rows.read(getattr(message, field)))


DETECTIONS, STATES, CLAIM = rows_of("detections", F4, 2), rows_of("states", F4, 4), rows_of("claim", F8, 3)
CELL, TARGETS, POSES, OBSTACLES = rows_of("cell", F8, 2), rows_of("targets", F8, 2), rows_of("poses", F8, 3), rows_of("obstacles", F8, 2)
IDS, LABELS, DETAILS = rows_of("ids", U8, 1), rows_of("labels", U8, 1), rows_of("details", F4, 6)
LARGEST_LABEL = 2**53 - 1
BYTE_VALUES = bytes(range(256))
NO_LABEL = bytes(8)


def pack_labels(labels: np.ndarray) -> tuple[bytes, bytes]:
    """A table of labels (K,) uint64, strictly ascending, and the number in it of each of `labels` (N,): one byte each, or two if K > 256.

    Both are empty if no label is other than 0.
    """
    known = sorted(set(labels.tolist()))
    if not any(known):
        return b"", b""
    table = np.array(known, U8)
    return table.tobytes(), pack(table.searchsorted(labels), "<u1" if len(table) <= 256 else "<u2")


LabelPart = tuple[bytes, bytes, int]  # a result of `pack_labels`, and the number of particles


def check_label_numbers(table: bytes, numbers: bytes, count: int) -> None:
    """Refuse `numbers` unless there is one below the length of the table for each of `count` particles, or none without a table."""
    known = LABELS.count(table)
    if known <= 256:
        fit = len(numbers) == (count if known else 0) and not numbers.translate(None, BYTE_VALUES[:known])
    else:
        fit = len(numbers) == 2 * count and int(np.frombuffer(numbers, "<u2").max(initial=0)) < known
    if not fit:
        text = f"label_numbers: should be {count} numbers below {known}, in {1 if known <= 256 else 2} byte(s) each, or none without labels"
        raise Malformed("shape", text)


def read_labels(parts: Sequence[LabelPart]) -> np.ndarray:
    """The labels (N,) of the particles of several gossips, end to end."""
    tables = [table or NO_LABEL for table, _, _ in parts]
    numbers = [numbers if table else bytes(count) for table, numbers, count in parts]
    if max(map(len, tables), default=0) <= 8 * 256:
        places = np.frombuffer(b"".join(numbers), "u1").astype(np.int64)
    else:
        wide = [np.frombuffer(each, "<u1" if len(table) <= 8 * 256 else "<u2") for each, table in zip(numbers, tables)]
        places = np.concatenate(wide).astype(np.int64)
    starts = np.array([0, *accumulate([len(table) // 8 for table in tables])][:-1], np.int64)
    return np.frombuffer(b"".join(tables), U8).take(places + starts.repeat(np.array([count for _, _, count in parts], np.int64)))


def ascend(parts: Sequence[bytes]) -> bool:
    """Whether the uint64 numbers of each part ascend strictly, each part by itself."""
    numbers = np.frombuffer(b"".join(parts), U8)
    falls = (np.flatnonzero(numbers[1:] <= numbers[:-1]) + 1).tolist()  # allowed only where the next part begins
    return not falls or set(falls).issubset(accumulate([len(part) // 8 for part in parts]))


def are_labels(tables: Sequence[bytes]) -> bool:
    """Whether tables of labels ascend strictly and hold no number beyond `LARGEST_LABEL`."""
    return ascend(tables) and int(np.frombuffer(b"".join(tables), U8).max(initial=0)) <= LARGEST_LABEL


def pack(array: np.ndarray, dtype: str) -> bytes:
    """The little-endian bytes of an array, row by row."""
    return np.ascontiguousarray(array, dtype=dtype).tobytes()
