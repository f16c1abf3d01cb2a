"""The rules for the fields of a message: arrays as raw little-endian bytes, and bounds for every number.

Lengths in m, times in s, angles in rad.
"""

import struct
from operator import lt
from typing import Annotated, NamedTuple

import msgspec
import numpy as np

Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}\Z")]  # of a participant or a sensor class

MAX_DETECTIONS = 8192
MAX_PARTICLES = 8192
MAX_NAMES = 8192
FARTHEST = 1.0e6  # largest coordinate, m
LARGEST_AREA = FARTHEST**2  # m^2
LEAST_RADIUS, LEAST_ANGLE = 1.0e-3, 1.0e-6  # of a sensor, m and rad
LATEST = 1.0e12  # largest world time, s
MAX_SETTINGS, VALUE_SIZE = 65536, 8  # characters of all settings of a Hello; size of a number or boolean
LARGEST_SETTING = 1.0e12

F4, F8, U8 = np.dtype("<f4"), np.dtype("<f8"), np.dtype("<u8")


class Malformed(ValueError):
    """A message breaks a rule; `reason` is one word for the counters, the text names the field."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class Rows(NamedTuple):
    """The layout of an array on the wire: type of its numbers, numbers per row, and largest number of rows."""

    field: str
    number: np.dtype
    columns: int
    most: int

    def count(self, data: bytes) -> int:
        """The number of rows; raises Malformed for a part of a row or too many rows."""
        rows, rest = divmod(len(data), self.number.itemsize * self.columns)
        if rest:
            size = self.number.itemsize * self.columns
            raise Malformed("shape", f"{self.field}: {len(data)} bytes are no whole number of rows of {size} bytes")
        if rows > self.most:
            raise Malformed("size", f"{self.field}: {rows} rows, at most {self.most} are allowed")
        return rows

    def read(self, data: bytes) -> np.ndarray:
        """The rows, read-only: (N, columns), or (N,) if there is one column."""
        flat = np.frombuffer(data, self.number)
        return flat.reshape(self.count(data), self.columns) if self.columns > 1 else flat


def check_number(field: str, value: float, least: float = -FARTHEST, most: float = FARTHEST) -> None:
    """Refuse NaN, infinity and anything outside [least, most]: one bad float would win every comparison downstream."""
    if not least <= value <= most:
        raise Malformed("range", f"{field} = {value}: should be a finite number from {least:g} to {most:g}")


def check_vector(field: str, values: tuple[float, ...]) -> None:
    """Refuse a vector with NaN, infinity or anything beyond `FARTHEST`."""
    for value in values:
        if not -FARTHEST <= value <= FARTHEST:
            raise Malformed("range", f"{field} = {values}: every number should be finite and within +-{FARTHEST:g}")


def surely_valid(pose: tuple[float, float, float], point: tuple[float, float], lengths: tuple[float, ...]) -> bool:
    """Whether one sum of magnitudes proves that all these numbers are in range and no length is negative; see `check_rows`."""
    (x, y, heading), (east, north) = pose, point
    return abs(x) + abs(y) + abs(heading) + abs(east) + abs(north) + sum(lengths) < 0.5 * FARTHEST and min(lengths) >= 0.0


def check_rows(rows: Rows, data: bytes) -> int:
    """Refuse NaN, infinity and anything beyond `FARTHEST`; return the number of rows.

    A sum of squares below half the bound squared proves it for the whole array in one pass: its rounding error is below 1 %, and NaN
    compares false. Only a larger sum needs the check of every number.
    """
    if not data:
        return 0
    count = rows.count(data)
    flat = np.frombuffer(data, rows.number)
    if not np.vdot(flat, flat) < 0.5 * FARTHEST**2 and not bool(np.all(np.abs(flat) <= FARTHEST)):
        raise Malformed("range", f"{rows.field}: every number should be finite and within +-{FARTHEST:g}")
    return count


DETECTIONS, STATES = Rows("detections", F4, 2, MAX_DETECTIONS), Rows("states", F4, 4, MAX_PARTICLES)
CLAIM, CELL = Rows("claim", F8, 3, MAX_NAMES), Rows("cell", F8, 2, MAX_NAMES)
TARGETS, POSES = Rows("targets", F8, 2, MAX_DETECTIONS), Rows("poses", F8, 3, MAX_NAMES)
OBSTACLES = Rows("obstacles", F8, 2, MAX_NAMES)
IDS, TARGET_IDS = Rows("ids", U8, 1, MAX_PARTICLES), Rows("ids", U8, 1, MAX_DETECTIONS)


LABELS, PEAK_LABELS = Rows("labels", U8, 1, MAX_PARTICLES), Rows("labels", U8, 1, MAX_DETECTIONS)
DETAILS = Rows("details", F4, 6, MAX_DETECTIONS)
LARGEST_LABEL = 2**53 - 1
BYTE_VALUES = bytes(range(256))


def pack_labels(labels: np.ndarray) -> tuple[bytes, bytes]:
    """A table of labels (K,) uint64, strictly ascending, and the number in it of each of `labels` (N,): one byte each, or two if K > 256.

    Both are empty if no label is other than 0.
    """
    known = sorted(set(labels.tolist()))
    if not any(known):
        return b"", b""
    table = np.array(known, U8)
    return table.tobytes(), pack(table.searchsorted(labels), "<u1" if len(table) <= 256 else "<u2")


def read_labels(table: bytes, numbers: bytes, count: int) -> np.ndarray:
    """The labels (N,) of `count` particles from the results of `pack_labels`."""
    if not table:
        return np.zeros(count, U8)
    return np.frombuffer(table, U8).take(np.frombuffer(numbers, "<u1" if len(table) <= 8 * 256 else "<u2"))


def are_label_numbers(table: bytes, numbers: bytes, count: int) -> bool:
    """Whether `numbers` has one number for each of `count` particles, and all are smaller than the length of the table."""
    known = len(table) // 8
    if known <= 256:
        return len(numbers) == (count if known else 0) and not numbers.translate(None, BYTE_VALUES[:known])
    return len(numbers) == 2 * count and int(np.frombuffer(numbers, "<u2").max(initial=0)) < known


def surely_valid_labels(table: bytes, numbers: bytes, count: int) -> bool:
    """Whether `check_labels` would refuse nothing."""
    if not table:
        return not numbers
    known = len(table) // 8
    if len(table) % 8 or known > MAX_PARTICLES or not are_label_numbers(table, numbers, count):
        return False
    labels = struct.unpack(f"<{known}Q", table)
    return labels[-1] <= LARGEST_LABEL and all(map(lt, labels, labels[1:]))


def check_labels(table: bytes, numbers: bytes, count: int) -> None:
    """Refuse a table that does not ascend or exceeds its limits, and numbers of labels that are not in it."""
    known = LABELS.count(table)
    if not are_label_numbers(table, numbers, count):
        text = f"label_numbers: should be {count} numbers below {known}, in {1 if known <= 256 else 2} byte(s) each, or none without labels"
        raise Malformed("shape", text)
    labels = np.frombuffer(table, U8)
    if not bool(np.all(labels[1:] > labels[:-1])) or (known and int(labels[-1]) > LARGEST_LABEL):
        raise Malformed("range", f"labels: should be strictly ascending and at most {LARGEST_LABEL}")


def pack(array: np.ndarray, dtype: str) -> bytes:
    """The little-endian bytes of an array, row by row."""
    return np.ascontiguousarray(array, dtype=dtype).tobytes()
